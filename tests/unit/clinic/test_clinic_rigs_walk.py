"""Rigs in a real browser, as every role: described, checked with photographs of today, a poor picture left out."""

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright
from tests.clinic_browser import AXE, CHROMIUM_FLAGS, opened, require_accessible, require_fitting
from tests.clinic_server import served
from tests.unit.clinic.test_clinic_upload_walk import picture
from tests.unit.clinic.test_clinic_walk import photograph

from mammometry.io.session import Session

CHROMIUM = shutil.which("chromium")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: apt-get install chromium"),
    pytest.mark.skipif(not AXE.exists(), reason="no axe-core: the bundles are not built (hatch_build.py)"),
]


class Rigs:
    """A clinic with a calibrated rig, and its browser."""

    def __init__(self, folder: Path, address: str, browser: Browser, logins: dict[str, str]) -> None:
        self.folder, self._address, self._browser, self._logins = folder, address, browser, logins
        self.check = logins["check"]
        """A daily check whose photographs are exchanged."""
        self.visits = [key for key in logins.get("visits", "").split(",") if key]
        """Visits before eight cameras, where the independent renderer's captures are there."""

    def placed(self, visit: str) -> dict[str, bytes]:
        """Camera → the file in its place."""
        folder = self.folder / "sessions" / visit / "capture"
        return {path.stem: path.read_bytes() for path in folder.glob("*") if not path.name.startswith(".")}

    def page(self, role: str, *, width: int = 1000) -> Page:
        """A window of somebody with this role."""
        return opened(self._browser, f"http://{self._address}", self._logins[role], width=width)


@pytest.fixture(scope="module")
def rigs(tmp_path_factory: pytest.TempPathFactory, shared_data: Path) -> Iterator[Rigs]:
    """A clinic whose server computes nothing: what is queued stays."""
    folder = tmp_path_factory.mktemp("rigs") / "clinic"
    captures = shared_data / "rendered"
    words = [sys.executable, "-m", "tests.clinic_rigs", str(folder), *([str(captures)] if captures.is_dir() else [])]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=120, cwd=AXE.parents[1])
    assert done.returncode == 0, done.stderr
    with served(folder, "--no-jobs") as (address, _), sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=CHROMIUM_FLAGS)
        yield Rigs(folder, address, browser, json.loads(done.stdout))
        browser.close()


@pytest.mark.parametrize("role", ["technician", "administrator"])
def test_a_rig_is_described_by_clicks_and_opens_as_a_session(rigs: Rigs, tmp_path: Path, role: str) -> None:
    page = rigs.page(role)
    page.goto("/rigs/")
    page.get_by_role("link", name="New rig").click()
    page.get_by_label("Name", exact=True).fill(f"Room of the {role}")
    for pair in (1, 2):
        page.get_by_label(f"Name of pair {pair}").fill(f"view{pair}")
        page.get_by_label(f"Left camera of pair {pair}").fill(f"view{pair} left")
        page.get_by_label(f"Right camera of pair {pair}").fill(f"view{pair} right")
    expect(page.get_by_label("Name of pair 7")).to_be_hidden()
    page.get_by_role("button", name="More pairs").click()
    expect(page.get_by_label("Name of pair 7")).to_be_visible()
    drawn = page.get_by_role("img", name="The board as it is entered")
    expect(drawn).to_be_visible()
    page.get_by_label("Squares in a row").fill("")
    expect(page.get_by_text("The board is drawn when its sizes are entered.")).to_be_visible()
    page.get_by_label("Squares in a row").fill("11")
    page.get_by_label("Rows").fill("8")
    expect(drawn).to_be_visible()
    page.wait_for_function("document.querySelector('[data-board-picture]').src.includes('columns=11&rows=8')")
    page.wait_for_function("document.querySelector('[data-board-picture]').naturalWidth > 0")
    page.get_by_label("Measured over this many squares").fill("10")
    page.get_by_label("Their length on the print").fill("275.5")
    page.get_by_label("Uncertainty of that length").fill("0.1")
    page.get_by_role("button", name="Save", exact=True).click()
    expect(page.get_by_text("10.2% larger than designed")).to_be_visible()  # eleven squares, counted as ten
    expect(page.get_by_label("Left camera of pair 2")).to_have_value("view2 left")
    page.get_by_label("Their length on the print").fill("250.3")
    page.evaluate("window.scrollTo(0, 0)")  # what is under the sticky head is no target
    picture(page, "rig-form")
    require_accessible(page)
    require_fitting(page)
    page.get_by_role("button", name="Save", exact=True).click()
    expect(page.get_by_text("The rig is saved.")).to_be_visible()
    require_accessible(page)
    with page.expect_download() as download:
        page.get_by_role("link", name="session.toml").click()
    download.value.save_as(tmp_path / "session.toml")
    session = Session.open(tmp_path)
    assert session.cameras == ("view1_left", "view1_right", "view2_left", "view2_right")
    assert session.manifest.target is not None
    assert session.manifest.target["edge_mm"] == pytest.approx(275.33)
    assert page.wrong == []  # type: ignore[attr-defined]


def test_a_checks_exchanged_photographs_are_put_right_by_clicks(rigs: Rigs) -> None:
    looker = rigs.page("clinician")
    looker.goto(f"/checks/{rigs.check}/")
    expect(looker.get_by_role("heading", name="Daily check")).to_be_visible()
    expect(looker.get_by_role("button", name="Put them right and check again")).to_have_count(0)
    page = rigs.page("administrator")
    page.goto("/rigs/")
    expect(page.get_by_text("No: photographs of the last check are exchanged.")).to_be_visible()
    page.goto(f"/checks/{rigs.check}/")
    for name in ("Front left now", "Front left after the correction"):
        expect(page.get_by_role("img", name=name)).to_be_visible()
    picture(page, "check-exchanged")
    require_accessible(page)
    require_fitting(page)
    (folder,) = (rigs.folder / "rigs").glob(f"*/checks/{rigs.check}")
    before = {path.stem: path.read_bytes() for path in folder.iterdir()}
    page.get_by_role("button", name="Put them right and check again").click()
    expect(page.get_by_role("heading", name="Checking")).to_be_visible()
    after = {path.stem: path.read_bytes() for path in folder.iterdir()}
    assert after == {"front_left": before["front_right"], "front_right": before["front_left"]}
    assert page.wrong == []  # type: ignore[attr-defined]


def test_a_check_takes_new_photographs_alone(rigs: Rigs, tmp_path: Path) -> None:
    page = rigs.page("technician")
    page.goto("/rigs/")
    page.get_by_role("link", name="Room 1").click()
    page.get_by_role("button", name="New calibration").click()
    choose = page.get_by_label("Choose photographs")
    expect(page.get_by_text("How large is the printed board?")).to_be_visible()
    choose.set_input_files(photograph(tmp_path / "front_left.jpg", 71))
    expect(page.get_by_role("img", name="Photograph: Pose 01, front left")).to_be_visible()
    page.goto("/rigs/")
    page.get_by_role("link", name="Room 1").click()
    page.get_by_role("button", name="Daily check").click()
    choose.set_input_files([tmp_path / "front_left.jpg", photograph(tmp_path / "front_right.jpg", 72)])
    said = "front_left.jpg: This photograph is the photograph of front left in pose 01 of the calibration of"
    expect(page.get_by_text(said)).to_be_visible()
    expect(page.get_by_role("img", name="Photograph: Front right")).to_be_visible()
    picture(page, "check-refused")
    require_accessible(page)
    choose.set_input_files(photograph(tmp_path / "new" / "front_left.jpg", 73))
    expect(page.get_by_text("Everything is here.")).to_be_visible()
    expect(page.get_by_role("button", name="Check", exact=True)).to_be_enabled()
    assert page.wrong == []  # type: ignore[attr-defined]


def test_a_poor_picture_is_left_out_by_clicks(rigs: Rigs) -> None:
    looker = rigs.page("clinician")
    looker.goto("/rigs/")
    looker.get_by_role("link", name="Room 1").click()
    looker.get_by_role("link", name="Check the photographs that differ").click()
    expect(looker.get_by_role("img", name="Photograph: pose 02, Front left")).to_be_visible()
    expect(looker.get_by_role("checkbox")).to_have_count(0)
    assert rigs.page("researcher").goto("/rigs/").status == 403  # type: ignore[union-attr]

    page = rigs.page("technician")
    page.goto("/rigs/")
    page.get_by_role("link", name="Room 1").click()
    page.get_by_role("link", name="Check the photographs that differ").click()
    expect(page.get_by_text("Pose 02: 9 of 88 points of front_left were left out as outliers.")).to_be_visible()
    page.get_by_role("button", name="Calibrate again without the ticked ones").click()
    expect(page.get_by_text("Tick a photograph of this calibration.")).to_be_visible()
    page.get_by_label("Leave it out: pose 02, Front left").check()
    picture(page, "doubts")
    require_accessible(page)
    require_fitting(page)
    page.get_by_role("button", name="Calibrate again without the ticked ones").click()
    expect(page.get_by_text("The present calibration stays in use until then.")).to_be_visible()
    expect(page.get_by_role("heading", name="Calibrating")).to_be_visible()
    made = page.url.rstrip("/").rsplit("/", 1)[1]
    folders = {path.parent.name for path in (rigs.folder / "rigs").glob("*/calibrations/*/set-aside")}
    assert folders == {made}
    assert page.wrong == []  # type: ignore[attr-defined]


@pytest.fixture
def taken(rigs: Rigs, shared_data: Path) -> dict[str, Path]:
    """Camera → its photograph of a torso."""
    if not rigs.visits:
        pytest.skip("no shared data: ../shared/data/rendered")
    return {path.stem: path for path in sorted((shared_data / "rendered/torso/capture").glob("*.jpg"))}


def test_exchanged_photographs_are_put_right_by_clicks(rigs: Rigs, taken: dict[str, Path], tmp_path: Path) -> None:
    page = rigs.page("technician")
    page.goto(f"/visits/{rigs.visits[0]}/")
    exchanged = {"front_left": "right_left", "right_left": "front_left"}
    files = [shutil.copy(path, tmp_path / f"{exchanged.get(camera, camera)}.jpg") for camera, path in taken.items()]
    page.get_by_label("Choose photographs").set_input_files(files)
    expect(page.get_by_role("button", name="Put them right")).to_be_visible()
    expect(page.get_by_text("photographs that seem to be exchanged")).to_be_visible()
    for name in ("Front left now", "Front left after the correction", "Right left now"):
        expect(page.get_by_role("img", name=name)).to_be_visible()
    expect(page.get_by_role("button", name="Measure", exact=True)).to_be_disabled()
    picture(page, "exchanged")
    require_accessible(page)
    require_fitting(page)
    page.get_by_role("button", name="Put them right").click()
    expect(page.get_by_role("button", name="Put them right")).to_be_hidden()
    expect(page.get_by_role("button", name="Measure", exact=True)).to_be_enabled()
    placed = rigs.placed(rigs.visits[0])
    assert placed == {camera: path.read_bytes() for camera, path in taken.items()}
    # A choice is changed by hand, and found again.
    page.get_by_label("Another camera took it: the photograph of Floor left").select_option("left_left")
    expect(page.get_by_role("button", name="Put them right")).to_be_visible()
    page.get_by_role("button", name="Put them right").click()
    expect(page.get_by_role("button", name="Measure", exact=True)).to_be_enabled()
    assert page.wrong == []  # type: ignore[attr-defined]


def test_unnamed_photographs_are_put_where_the_calibration_says(
    rigs: Rigs, taken: dict[str, Path], tmp_path: Path
) -> None:
    page = rigs.page("clinician")
    page.goto(f"/visits/{rigs.visits[1]}/")
    files = [
        shutil.copy(path, tmp_path / f"IMG_{number:04d}.JPG")
        for number, (_, path) in enumerate(reversed(taken.items()), start=1)
    ]
    page.get_by_label("Choose photographs").set_input_files(files)
    expect(page.get_by_text("IMG_0001.JPG")).to_be_visible()
    expect(page.get_by_role("button", name="Put all in their places")).to_be_visible()
    expect(page.get_by_text("By the calibration: Front left.")).to_be_visible()
    picture(page, "unnamed")
    require_accessible(page)
    require_fitting(page)
    page.get_by_role("button", name="It is of Front left").click()
    expect(page.get_by_role("img", name="Photograph: Front left")).to_be_visible()
    page.get_by_role("button", name="Put all in their places").click()
    expect(page.get_by_role("button", name="Measure", exact=True)).to_be_enabled()
    placed = rigs.placed(rigs.visits[1])
    assert placed == {camera: path.read_bytes() for camera, path in taken.items()}
    assert page.wrong == []  # type: ignore[attr-defined]
