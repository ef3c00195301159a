"""Pages of an administrator and of one's own account in a real browser: accessible, no wider than the window."""

import shutil
import time
from pathlib import Path

import pytest
from allauth.mfa.totp.internal.auth import format_hotp_value, hotp_value
from playwright.sync_api import Page, expect, sync_playwright
from tests.clinic_browser import AXE, CHROMIUM_FLAGS, cookies, opened, require_accessible, require_fitting
from tests.clinic_seed import PASSWORD
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


def enter(page: Page, name: str) -> None:
    """Name and password."""
    page.get_by_label("Name").fill(name)
    page.get_by_label("Password").fill(PASSWORD)
    page.get_by_role("button", name="Log in").click()


def set_up(page: Page) -> None:
    """Set the second factor up by what the page shows."""
    expect(page.get_by_role("heading", name="Set up the second factor")).to_be_visible()
    page.get_by_text("It cannot scan? Type this").click()
    secret = page.locator("details code").inner_text()
    page.get_by_label("Code").fill(format_hotp_value(hotp_value(secret, int(time.time()) // 30)))
    page.get_by_role("button", name="Finish").click()
    expect(page.get_by_role("heading", name="Codes for a lost telephone")).to_be_visible()
    expect(page.get_by_text("The second factor is set up.")).to_be_visible()
    expect(page.get_by_text("The old ones no longer work.")).to_have_count(0)


@pytest.mark.slow
@pytest.mark.requirement("R-SEC-2")
def test_a_lost_telephone(tmp_path: Path) -> None:
    """Each role: the administrator resets the second factor while a browser waits for a code, and one is logged in."""
    administrator = cookies(tmp_path / "clinic")["administrator"]
    file = tmp_path / "clinic" / "clinic.toml"
    with served(tmp_path / "clinic", "--no-jobs") as (address, _), sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=CHROMIUM_FLAGS)
        desk = opened(browser, f"http://{address}", administrator, width=WIDTHS[0])
        for role in ("clinician", "technician", "researcher", "administrator"):
            inside, waiting = (opened(browser, f"http://{address}", "nobody", width=WIDTHS[0]) for _ in range(2))
            inside.goto("/account/second/set-up/")
            enter(inside, f"{role}-1")
            if inside.get_by_role("heading", name="Your password again").count():
                inside.get_by_label("Password").fill(PASSWORD)
                inside.get_by_role("button", name="Go on").click()
            set_up(inside)
            waiting.goto("/")
            enter(waiting, f"{role}-1")
            expect(waiting.get_by_label("Code")).to_be_visible()
            desk.goto("/people/")
            desk.get_by_role("link", name=f"{role.capitalize()} One").click()
            desk.once("dialog", lambda dialog: dialog.accept())
            desk.get_by_role("button", name="Reset the second factor").click()
            expect(desk.get_by_text("sets up a second factor at the next login")).to_be_visible()
            for path in ("/", "/account/login/", "/account/code/", "/people/"):
                waiting.goto(path)
                expect(waiting.get_by_role("heading", name="Log in")).to_be_visible()
            waiting.go_back()
            waiting.goto("/")
            enter(waiting, f"{role}-1")
            expect(waiting.get_by_role("button", name="Log out").or_(waiting.locator(".me summary"))).to_be_visible()
            waiting.goto("/account/second/set-up/")
            if waiting.get_by_role("heading", name="Your password again").count():
                waiting.get_by_label("Password").fill(PASSWORD)
                waiting.get_by_role("button", name="Go on").click()
            set_up(waiting)
            inside.goto("/help/")
            expect(inside.get_by_role("heading", name="Help")).to_be_visible()  # the open session goes on
            for page in (inside, waiting):
                page.context.close()
        browser.close()
    assert 'second_factor = "offered"' in file.read_text()
