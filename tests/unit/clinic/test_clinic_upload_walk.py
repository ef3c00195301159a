"""Photographs dropped in a real browser: poses go on, folders and ZIPs come in whole, nothing is replaced unasked."""

import os
import shutil
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect, sync_playwright
from tests.clinic_browser import AXE, CHROMIUM_FLAGS, cookies, opened, require_accessible, require_fitting
from tests.clinic_server import served
from tests.unit.clinic.test_clinic_walk import photograph

CHROMIUM = shutil.which("chromium")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: apt-get install chromium"),
    pytest.mark.skipif(not AXE.exists(), reason="no axe-core: the bundles are not built (hatch_build.py)"),
]
CAMERAS = ("front_left", "front_right")


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    """A technician's page of a new calibration."""
    login = cookies(tmp_path / "clinic")["technician"]
    with served(tmp_path / "clinic", "--no-jobs") as (address, _), sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=CHROMIUM_FLAGS)
        page = opened(browser, f"http://{address}", login, width=820)
        page.goto("/rigs/")
        page.get_by_role("link", name="Room 1").first.click()
        page.get_by_role("button", name="New calibration").click()
        expect(page.get_by_label("Pose of the board")).to_have_value("01")
        yield page
        browser.close()
        assert page.wrong == []  # type: ignore[attr-defined]


def pose(folder: Path, number: int) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    return [photograph(folder / f"{name}.jpg", 10 * number + place) for place, name in enumerate(CAMERAS)]


def picture(page: Page, name: str) -> None:
    if "MAMMOMETRY_TEST_PICTURES" in os.environ:  # for somebody who wants to look at the page
        page.screenshot(path=f"{os.environ['MAMMOMETRY_TEST_PICTURES']}/{name}.png", full_page=True)


def test_poses_go_on_and_nothing_is_replaced_unasked(page: Page, tmp_path: Path) -> None:
    number, choose = page.get_by_label("Pose of the board"), page.get_by_label("Choose photographs")
    choose.set_input_files(pose(tmp_path / "one", 1))
    expect(number).to_have_value("02")
    expect(page.get_by_text("2 photographs have arrived.")).to_be_visible()
    expect(page.get_by_text("Add 2 more poses of the board: each camera must see it 3 times")).to_be_visible()
    expect(page.get_by_role("button", name="Calibrate", exact=True)).to_be_disabled()

    number.fill("01")
    choose.set_input_files(pose(tmp_path / "two", 2))
    dialog = page.get_by_role("dialog", name="These photographs are already there")
    expect(dialog).to_be_visible()
    picture(page, "occupied")
    require_accessible(page)
    require_fitting(page)
    dialog.get_by_role("button", name="They are of pose 02").click()
    expect(number).to_have_value("03")

    (tmp_path / "front_left.txt").write_text("no photograph")
    choose.set_input_files([tmp_path / "front_left.txt", *pose(tmp_path / "three", 3)])
    expect(page.get_by_text("front_left.txt:")).to_be_visible()
    expect(page.get_by_text("Sending")).to_be_hidden()
    expect(page.get_by_role("button", name="Calibrate", exact=True)).to_be_enabled()
    picture(page, "poses")
    require_accessible(page)
    require_fitting(page)


def test_a_folder_of_poses_and_a_zip_come_in_whole(page: Page, tmp_path: Path) -> None:
    session = tmp_path / "session"
    for each in (1, 2, 3):
        pose(session / "calibration" / f"{each:02d}", each)
    (session / "session.toml").write_text("format = 1")
    page.get_by_label("Choose a folder of photographs").set_input_files(session)
    for each in (1, 2, 3):
        for camera in ("front left", "front right"):
            name = f"Photograph: Pose {each:02d}, {camera}"
            expect(page.get_by_role("img", name=name)).to_be_visible()
    expect(page.get_by_text("6 photographs have arrived.")).to_be_visible()
    expect(page.get_by_role("button", name="Calibrate", exact=True)).to_be_enabled()
    expect(page.get_by_label("Pose of the board")).to_have_value("04")

    packed = tmp_path / "more.zip"
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for each in (7, 8):
            for path in pose(tmp_path / f"{each}", each):
                archive.write(path, f"more/{each:02d}/{path.name}")
        archive.writestr("__MACOSX/more/07/._front_left.jpg", b"junk")
    page.get_by_label("Choose photographs").set_input_files(packed)
    expect(page.get_by_role("img", name="Photograph: Pose 08, front right")).to_be_visible()
    expect(page.get_by_text("4 photographs have arrived.")).to_be_visible()

    (tmp_path / "bad.zip").write_bytes(b"PK\x05\x06 no ZIP at all")
    page.get_by_label("Choose photographs").set_input_files(tmp_path / "bad.zip")
    expect(page.get_by_text("bad.zip: The ZIP cannot be read.")).to_be_visible()
