"""Pages of an administrator and of one's own account in a real browser: accessible, no wider than the window."""

import shutil
from pathlib import Path

import pytest
from playwright.sync_api import expect, sync_playwright
from tests.clinic_browser import AXE, CHROMIUM_FLAGS, cookies, opened, require_accessible, require_fitting
from tests.clinic_server import command, served

CHROMIUM = shutil.which("chromium")
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: apt-get install chromium"),
    pytest.mark.skipif(not AXE.exists(), reason="no axe-core: the bundles are not built (hatch_build.py)"),
]
WIDTHS = (390, 820, 1440)
PAGES = (
    "/", "/people/", "/people/new/", "/audit/", "/audit/1/", "/backups/", "/disk/", "/erase/", "/archives/",
    "/archives/new/", "/settings/", "/help/", "/account/second/", "/account/password/", "/account/logout/",
)  # fmt: skip
WITHOUT_LOGIN = ("/account/login/", "/account/invitation/1-x/", "/account/inactive/", "/account/invitation/done/")


@pytest.mark.slow
def test_an_administrators_pages(tmp_path: Path) -> None:
    login = cookies(tmp_path / "clinic")["administrator"]
    command("backup", str(tmp_path / "clinic"))
    with served(tmp_path / "clinic", "--no-jobs") as (address, _), sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=CHROMIUM_FLAGS)
        for session, paths in ((login, PAGES), ("nobody", WITHOUT_LOGIN)):
            page = opened(browser, f"http://{address}", session, width=WIDTHS[0])
            for path in paths:
                answer = page.goto(path)
                assert answer is not None
                assert answer.ok, path
                require_accessible(page)
                for width in WIDTHS:
                    page.set_viewport_size({"width": width, "height": 900})
                    require_fitting(page)
            assert page.wrong == []  # type: ignore[attr-defined]
        page = opened(browser, f"http://{address}", login, width=WIDTHS[0])
        page.goto("/people/new/")
        page.get_by_label("Name for the login").fill("anna")
        page.get_by_label("Technician").check()
        page.get_by_role("button", name="Enter, and show the link").click()
        link = page.get_by_label("Link").input_value()
        require_accessible(page)
        page.locator(".me summary").click()
        expect(page.get_by_role("link", name="Second factor")).to_be_visible()
        require_accessible(page)
        page.keyboard.press("Escape")
        expect(page.get_by_role("link", name="Second factor")).to_be_hidden()
        page.locator(".me summary").click()
        page.get_by_role("button", name="Log out").click()
        page.goto(link)
        for label in ("New password", "The same again"):
            page.get_by_label(label).fill("three grey herons wade")
        page.get_by_role("button", name="Set the password").click()
        page.get_by_role("main").get_by_role("link", name="Log in").click()
        page.get_by_label("Name").fill("anna")
        page.get_by_label("Password").fill("three grey herons wade")
        page.get_by_role("button", name="Log in").click()
        expect(page.get_by_role("heading", name="Today", exact=True)).to_be_visible()
        expect(page.get_by_text("The first day of this clinic")).to_be_visible()
        page.goto(link)
        expect(page.get_by_text("This link has been used or is older than three days.")).to_be_visible()
        browser.close()
