"""A technician fires the rig's cameras in a real browser, on a phone, and goes on to the job."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from playwright.sync_api import expect, sync_playwright
from tests.clinic_browser import AXE, CHROMIUM_FLAGS, cookies, opened, require_accessible, require_fitting
from tests.clinic_server import served
from tests.unit.capture.virtual_capture import make_pictures, rig_file

CHROMIUM = shutil.which("chromium")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: apt-get install chromium"),
    pytest.mark.skipif(not AXE.exists(), reason="no axe-core: the bundles are not built (hatch_build.py)"),
]
WAIT_MS = 60_000


def test_a_visit_is_photographed_by_one_button(tmp_path: Path) -> None:
    folder, place = tmp_path / "clinic", tmp_path / "cameras"
    login = cookies(folder)["technician"]
    make_pictures(place / "calibrated")
    rig_file(place)
    words = [sys.executable, "-m", "tests.clinic_filled", str(folder), "cameras", str(place)]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=AXE.parents[1])
    assert done.returncode == 0, done.stderr
    visit = json.loads(done.stdout)["visit"]
    with served(folder, "--no-jobs") as (address, _), sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=CHROMIUM_FLAGS)
        page = opened(browser, f"http://{address}", login, width=360)
        page.goto(f"/visits/{visit}/")
        page.get_by_role("link", name="Photograph with Room 2").click()
        expect(page.get_by_text("The subject is complete in every view.")).to_be_visible(timeout=WAIT_MS)
        assert page.locator("figure").count() == 8
        require_accessible(page)
        require_fitting(page)
        if "MAMMOMETRY_TEST_PICTURES" in os.environ:  # for somebody who wants to look at the page
            page.screenshot(path=f"{os.environ['MAMMOMETRY_TEST_PICTURES']}/capture-live.png")
        page.get_by_role("button", name="Fire").click()
        expect(page.get_by_text("The pictures may be measured.")).to_be_visible(timeout=WAIT_MS)
        expect(page.get_by_text("All camera names agree with the calibration.")).to_be_visible()
        require_accessible(page)
        require_fitting(page)
        if "MAMMOMETRY_TEST_PICTURES" in os.environ:
            page.screenshot(path=f"{os.environ['MAMMOMETRY_TEST_PICTURES']}/capture-fired.png")
        page.get_by_role("button", name="Measure").click()
        expect(page.get_by_role("heading", name="Being measured")).to_be_visible(timeout=WAIT_MS)
        browser.close()
        assert page.wrong == []  # type: ignore[attr-defined]
