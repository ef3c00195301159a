"""A technician's first steps in a real browser: enter a patient, begin a visit, drop photographs, on a phone."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page, expect, sync_playwright
from tests.clinic_browser import AXE, CHROMIUM_FLAGS, cookies, opened, require_accessible, require_fitting
from tests.clinic_server import served

CHROMIUM = shutil.which("chromium")
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: apt-get install chromium"),
    pytest.mark.skipif(not AXE.exists(), reason="no axe-core: the bundles are not built (hatch_build.py)"),
]


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    """A technician's phone, logged in at a clinic that really runs."""
    login = cookies(tmp_path / "clinic")["technician"]
    with served(tmp_path / "clinic") as (address, _), sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=CHROMIUM_FLAGS)
        page = opened(browser, f"http://{address}", login, width=390)
        yield page
        browser.close()
        assert page.wrong == []  # type: ignore[attr-defined]


def photograph(path: Path, seed: int) -> Path:
    """Something sharp enough to be looked at."""
    noise = np.random.default_rng(seed).integers(0, 255, (60, 90, 3), dtype=np.uint8)
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(noise).resize((900, 600), Image.Resampling.NEAREST).save(path, quality=90)
    return path


@pytest.mark.slow
def test_a_visit_is_begun_on_a_phone(page: Page, tmp_path: Path) -> None:
    page.goto("/")
    expect(page.get_by_text("No visits today yet.")).to_be_visible()
    page.get_by_text("Menu", exact=True).click()
    page.get_by_role("link", name="Patients").click()
    expect(page.get_by_text("No patients are entered yet.")).to_be_visible()
    page.get_by_role("main").get_by_role("link", name="New patient", exact=True).click()
    page.get_by_label("Family name").fill("Meier")
    page.get_by_label("Given name").fill("Eva")
    page.get_by_label("Date of birth").fill("1980-02-28")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_text("This field is required.")).to_be_visible()  # the record number
    page.get_by_label("Record number").fill("KIS-1")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_role("heading", name="Meier, Eva")).to_be_visible()
    require_accessible(page)
    page.goto("/visits/new/")
    page.get_by_label("Who is photographed?").press_sequentially("eva meier")
    expect(page.locator("#rows li")).to_have_count(1)
    page.get_by_role("main").get_by_role("link", name="Meier, Eva").click()
    expect(page.get_by_text("born 28 Feb 1980 · record KIS-1")).to_be_visible()
    expect(page.get_by_label("Rig").locator("option:checked")).to_have_text("Room 1")  # there is no other
    page.get_by_role("button", name="Go on to the photographs").click()
    expect(page.get_by_text("Still missing: Front left, Front right.")).to_be_visible()
    expect(page.get_by_role("button", name="Measure")).to_be_disabled()

    # One by the camera's own button, one dropped among all, whose name tells its camera.
    with page.expect_file_chooser() as choosing:
        page.get_by_text("Choose photograph", exact=True).first.click()
    choosing.value.set_files(photograph(tmp_path / "IMG_0001.jpg", 1))
    expect(page.get_by_role("img", name="Photograph: Front left")).to_be_visible()
    page.get_by_label("Choose photographs").set_input_files(photograph(tmp_path / "front_right.jpg", 2))
    expect(page.get_by_role("img", name="Photograph: Front right")).to_be_visible()
    assert len(list((tmp_path / "clinic" / "sessions").glob("*/capture/front_*.jpg"))) == 2
    require_accessible(page)
    require_fitting(page)
    page.get_by_role("button", name="Set aside: the photograph of Front left").click()
    expect(page.get_by_text("Still missing: Front left.")).to_be_visible()
    expect(page.get_by_text("Set aside (1)")).to_be_visible()
