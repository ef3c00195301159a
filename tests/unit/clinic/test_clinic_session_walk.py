"""The session ends while somebody works, in a real browser: the password is asked for and nothing is lost."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect, sync_playwright
from tests.clinic_browser import AXE, CHROMIUM_FLAGS, cookies, opened, require_accessible, require_fitting
from tests.clinic_seed import PASSWORD
from tests.clinic_server import served
from tests.unit.clinic.test_clinic_walk import photograph

CHROMIUM = shutil.which("chromium")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: apt-get install chromium"),
    pytest.mark.skipif(not AXE.exists(), reason="no axe-core: the bundles are not built (hatch_build.py)"),
]


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    """A technician's page of a visit without photographs."""
    login = cookies(tmp_path / "clinic")["technician"]
    with served(tmp_path / "clinic", "--no-jobs") as (address, _), sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=CHROMIUM_FLAGS)
        page = opened(browser, f"http://{address}", login, width=390)
        page.goto("/patients/new/")
        for label, text in {"Family name": "Meier", "Given name": "Eva", "Record number": "KIS-1"}.items():
            page.get_by_label(label).fill(text)
        page.get_by_label("Date of birth").fill("1980-02-28")
        page.get_by_role("button", name="Save").click()
        page.get_by_role("main").get_by_role("link", name="New visit", exact=True).click()
        page.get_by_label("Rig").select_option(label="Room 1")
        page.get_by_role("button", name="Go on to the photographs").click()
        expect(page.get_by_text("Still missing: Front left, Front right.")).to_be_visible()
        yield page
        browser.close()
        assert page.wrong == []  # type: ignore[attr-defined]


def end_session(page: Page) -> None:
    """As `security.Expiry` does: the session's cookie counts no more."""
    page.context.clear_cookies(name="clinic-session")


def test_a_photograph_waits_for_the_password(page: Page, tmp_path: Path) -> None:
    end_session(page)
    page.get_by_label("Choose photographs").set_input_files(photograph(tmp_path / "front_left.jpg", 1))
    dialog = page.get_by_role("dialog", name="Log in again, technician-1")
    expect(dialog).to_be_visible()
    require_accessible(page)
    require_fitting(page)
    if "MAMMOMETRY_TEST_PICTURES" in os.environ:  # for somebody who wants to look at the page
        page.screenshot(path=f"{os.environ['MAMMOMETRY_TEST_PICTURES']}/session-ended.png")
    expect(page.get_by_text("All photographs are here.")).to_be_hidden()
    dialog.get_by_label("Password").fill("wrong")
    dialog.get_by_role("button", name="Log in").click()
    expect(dialog.get_by_text("Wrong password.")).to_be_visible()
    dialog.get_by_label("Password").fill(PASSWORD)
    dialog.get_by_role("button", name="Log in").click()
    expect(page.get_by_role("img", name="Photograph: Front left")).to_be_visible()
    expect(dialog).to_be_hidden()
    # The login made a new token; the page goes on with it.
    page.get_by_label("Choose photographs").set_input_files(photograph(tmp_path / "front_right.jpg", 2))
    expect(page.get_by_text("Everything is here.")).to_be_visible()


def test_who_logs_in_in_another_tab_goes_on_here(page: Page, tmp_path: Path) -> None:
    end_session(page)
    page.get_by_label("Choose photographs").set_input_files(photograph(tmp_path / "front_left.jpg", 1))
    dialog = page.get_by_role("dialog")
    with page.context.expect_page() as opening:
        dialog.get_by_role("link", name="Log in in another tab").click()
    other = opening.value
    other.get_by_label("Name").fill("technician-1")
    other.get_by_label("Password").fill(PASSWORD)
    other.get_by_role("button", name="Log in").click()
    expect(other.get_by_role("heading", name="Today", exact=True)).to_be_visible()
    page.evaluate("window.dispatchEvent(new Event('focus'))")  # no window manager tells a headless tab
    expect(page.get_by_role("img", name="Photograph: Front left")).to_be_visible()


def test_who_does_not_log_in_is_told_what_was_not_sent(page: Page, tmp_path: Path) -> None:
    end_session(page)
    page.get_by_label("Choose photographs").set_input_files(photograph(tmp_path / "front_left.jpg", 1))
    page.get_by_role("button", name="Not now").click()
    page.get_by_role("button", name="Not now").click()  # the page asks for its state, too
    expect(page.get_by_text("front_left.jpg: Log in first.")).to_be_visible()
    expect(page.get_by_text("All photographs are here.")).to_be_hidden()
