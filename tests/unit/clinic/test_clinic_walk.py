"""A technician's first steps in a real browser: enter a patient, begin a visit, drop photographs, on a phone."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from django.test import Client
from PIL import Image
from playwright.sync_api import Page, expect, sync_playwright
from tests.clinic_browser import AXE, CHROMIUM_FLAGS, cookies_of, require_accessible, require_fitting

from mammometry.clinic.models import Patient, Rig, Upload, Visit
from mammometry.clinic.roles import Role

CHROMIUM = shutil.which("chromium")
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: apt-get install chromium"),
    pytest.mark.skipif(not AXE.exists(), reason="no axe-core: the bundles are not built (hatch_build.py)"),
]
PAIR = {"name": "front", "left": "front_left", "right": "front_right"}
DEFINITION = {
    "rig": {"name": "pair", "pairs": [PAIR]},
    "target": {"kind": "charuco", "squares": [14, 10], "square_mm": 25.0, "marker_mm": 18.0, "dictionary": "DICT_5X5_250"},
}


@pytest.fixture(scope="module", autouse=True)
def _one_thread() -> Iterator[None]:
    """Playwright runs a loop in this thread, in which Django would not speak with the database."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DJANGO_ALLOW_ASYNC_UNSAFE", "1")
        yield


@pytest.fixture
def page(live_server: object, client_of: Callable[..., Client]) -> Iterator[Page]:
    client = client_of(Role.TECHNICIAN)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=CHROMIUM_FLAGS)
        context = browser.new_context(viewport={"width": 360, "height": 740}, base_url=str(live_server))
        context.add_cookies(cookies_of(client, str(live_server)))
        page = context.new_page()
        wrong: list[str] = []
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("console", lambda said: wrong.append(said.text) if "Content Security Policy" in said.text else None)
        yield page
        browser.close()
        assert wrong == []


def photograph(path: Path, seed: int) -> Path:
    """Something sharp enough to be looked at."""
    noise = np.random.default_rng(seed).integers(0, 255, (60, 90, 3), dtype=np.uint8)
    Image.fromarray(noise).resize((900, 600), Image.Resampling.NEAREST).save(path, quality=90)
    return path


@pytest.mark.django_db(transaction=True)
def test_a_visit_is_begun_on_a_phone(page: Page, tmp_path: Path) -> None:
    Rig.objects.create(name="Room 1", definition=DEFINITION)
    page.goto("/")
    expect(page.get_by_text("No visits today yet.")).to_be_visible()
    page.get_by_text("Menu", exact=True).click()
    page.get_by_role("link", name="Patients").click()
    page.get_by_role("link", name="New patient").click()
    page.get_by_label("Family name").fill("Meier")
    page.get_by_label("Given name").fill("Eva")
    page.get_by_label("Date of birth").fill("1980-02-28")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_text("This field is required.")).to_be_visible()  # the record number
    page.get_by_label("Record number").fill("KIS-1")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_role("heading", name="Meier, Eva")).to_be_visible()
    require_accessible(page)
    page.get_by_role("main").get_by_role("link", name="New visit").click()
    page.get_by_label("Rig").select_option(label="Room 1")
    assert page.get_by_label("Patient").input_value() == str(Patient.objects.get().pk)
    page.get_by_role("button", name="Go on to the photographs").click()
    expect(page.get_by_text("Still missing: Front left, Front right.")).to_be_visible()
    expect(page.get_by_role("button", name="Measure")).to_be_disabled()

    # One by the camera's own button, one dropped among all, whose name tells its camera.
    with page.expect_file_chooser() as choosing:
        page.get_by_text("Choose photograph", exact=True).first.click()
    choosing.value.set_files(photograph(tmp_path / "IMG_0001.jpg", 1))
    expect(page.get_by_role("img", name="Photograph: Front left")).to_be_visible(timeout=20_000)
    page.get_by_label("Choose photographs").set_input_files(photograph(tmp_path / "front_right.jpg", 2))
    expect(page.get_by_role("img", name="Photograph: Front right")).to_be_visible(timeout=20_000)
    visit = Visit.objects.get()
    assert {each.camera for each in Upload.objects.filter(visit=visit)} == {"front_left", "front_right"}
    require_accessible(page)
    require_fitting(page)
    page.get_by_role("button", name="Take away the photograph: Front left").click()
    expect(page.get_by_text("Still missing: Front left.")).to_be_visible()
