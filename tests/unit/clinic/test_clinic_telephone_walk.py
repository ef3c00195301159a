"""A visit with a telephone in a real browser, from the first click to the report, with rendered photographs."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, expect, sync_playwright
from tests.clinic_browser import AXE, CHROMIUM_FLAGS, cookies, opened, require_accessible, require_fitting
from tests.clinic_server import served
from tests.telephone_pictures import drop, picture, video, write_video

from mammometry.simulate.walk import PHOTOGRAPHS, WalkRecipe, write_walk

CHROMIUM = shutil.which("chromium")
MEASURED_MS = 3_000_000  # two minutes on two quiet cores; it has taken 32 beside ten busy processes
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: apt-get install chromium"),
    pytest.mark.skipif(not AXE.exists(), reason="no axe-core: the bundles are not built (hatch_build.py)"),
]


@pytest.fixture
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=CHROMIUM_FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def walk(tmp_path: Path) -> tuple[list[Path], dict[str, float]]:
    """The photographs of a virtual walk and one of a wall, named by a telephone; the woman's volumes."""
    made = write_walk(tmp_path / "walk", WalkRecipe(seed=0, pictures=20, scale=0.3))
    files = [
        path.rename(path.with_name(f"IMG_41{path.stem}.JPG"))
        for path in sorted((tmp_path / "walk" / PHOTOGRAPHS).glob("*.jpg"))
    ]
    wall = tmp_path / "walk" / "IMG_4199.JPG"
    with Image.open(files[0]) as first:
        Image.new("RGB", first.size, (120, 90, 80)).save(wall)
    return [*files, wall], dict(made.true_volumes_cc)


def started(page: Page) -> None:
    """Enter a patient, and begin a visit with a telephone."""
    page.goto("/patients/new/")
    page.get_by_label("Family name").fill("Meier")
    page.get_by_label("Given name").fill("Eva")
    page.get_by_label("Date of birth").fill("1980-02-28")
    page.get_by_label("Record number").fill("KIS-1")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_role("heading", name="Meier, Eva")).to_be_visible()
    page.goto("/visits/new/")
    page.get_by_label("Who is photographed?").press_sequentially("eva meier")
    page.get_by_role("main").get_by_role("link", name="Meier, Eva").click()
    page.get_by_role("link", name="Photographs by a telephone instead").click()
    require_accessible(page)
    require_fitting(page)
    page.get_by_label("Length of the printed board").fill("264")
    page.get_by_label("Its uncertainty").fill("0.2")
    page.get_by_role("button", name="Go on to the photographs").click()
    expect(page.get_by_role("button", name="Measure")).to_be_disabled()


@pytest.mark.slow
def test_photographs_that_cannot_be_measured_are_named_on_a_phone(browser: Browser, tmp_path: Path) -> None:
    folder = tmp_path / "photos"
    folder.mkdir()
    for number in range(13):
        (folder / f"IMG_{number:04d}.JPG").write_bytes(picture(number))
    (folder / "Eva Meier.JPG").write_bytes(picture(0)[:2000])
    login = cookies(tmp_path / "clinic")["technician"]
    with served(tmp_path / "clinic") as (address, _):
        page = opened(browser, f"http://{address}", login, width=390)
        started(page)
        page.get_by_label("Choose photographs or a video").set_input_files(sorted(folder.iterdir()))
        expect(page.locator("[data-refused] li")).to_have_count(1)
        expect(page.locator(".place.good")).to_have_count(13)
        expect(page.get_by_role("button", name="Measure")).to_be_enabled()
        require_accessible(page)
        require_fitting(page)
        page.locator(".place.bad").get_by_role("button").click()
        expect(page.locator(".place.bad")).to_have_count(0)
        # The board is flat before the camera in all: the telephone's places cannot be found.
        page.get_by_role("button", name="Measure").click()
        expect(page.get_by_role("alert")).to_contain_text("could not be measured", timeout=MEASURED_MS)
        require_accessible(page)
        expect(page.locator(".place.good")).to_have_count(13)
        assert page.wrong == []  # type: ignore[attr-defined]


@pytest.mark.requirement("R-KEEP-10")
@pytest.mark.slow
def test_a_walk_is_dropped_measured_and_reported(
    browser: Browser, walk: tuple[list[Path], dict[str, float]], tmp_path: Path
) -> None:
    files, true_cc = walk
    logins = cookies(tmp_path / "clinic")
    with served(tmp_path / "clinic") as (address, _):
        page = opened(browser, f"http://{address}", logins["technician"], width=1200)
        started(page)
        drop(page, files)
        expect(page.locator(".place.good")).to_have_count(len(files) - 1)
        expect(page.locator(".place.care")).to_have_count(1)
        require_accessible(page)
        require_fitting(page)
        page.get_by_role("button", name="Measure").click()
        expect(page.get_by_role("heading", name="Left breast")).to_be_visible(timeout=MEASURED_MS)
        page.locator("#mm-viewer[data-ready]:not([data-ready='0'])").wait_for()
        page.get_by_text("Photographs: ").click()
        expect(page.get_by_text("IMG_4199.JPG")).to_be_visible()
        require_accessible(page)
        require_fitting(page)
        visit = page.url
        assert page.wrong == []  # type: ignore[attr-defined]
        (folder,) = (tmp_path / "clinic" / "sessions").iterdir()
        assert not list((tmp_path / "clinic" / "uploads").iterdir())
        kept = [path for path in folder.rglob("*") if path.is_file()]
        assert not [path for path in kept if b"IMG_41" in path.read_bytes() or b"Meier" in path.read_bytes()]
        assert "edge" not in (folder / "session.toml").read_text()
        assert json.loads((folder / "walk.json").read_text())["scale_std"] == pytest.approx(0.2 / 264, rel=1e-3)

        clinician = opened(browser, f"http://{address}", logins["clinician"], width=1200)
        clinician.goto(visit)
        for side, volume_cc in true_cc.items():
            card = clinician.locator(f"[aria-labelledby='h-{side}']")
            low, high = (float(word) for word in card.locator(".number").inner_text().replace("cc", "").split(" to "))
            assert low < volume_cc < high
        report = clinician.request.get(f"{visit}report/")
        assert report.ok
        assert "Meier" in report.text()
        assert clinician.request.get(f"{visit}report.pdf").body().startswith(b"%PDF")
        clinician.get_by_role("link", name="Confirm boundaries").click()
        expect(clinician.get_by_role("button", name="Looks right")).to_be_visible()
        assert clinician.wrong == []  # type: ignore[attr-defined]
        for role in ("researcher", "administrator"):
            other = opened(browser, f"http://{address}", logins[role], width=1200)
            answer = other.goto(visit)
            assert answer is not None
            assert answer.status == 403


@pytest.mark.requirement("R-PHOTO-4")
@pytest.mark.slow
def test_a_video_is_dropped_measured_and_reported(
    browser: Browser, walk: tuple[list[Path], dict[str, float]], tmp_path: Path
) -> None:
    (*files, wall), true_cc = walk
    frames = [
        frame for file in files for frame in 4 * [cv2.imread(str(file))]
    ]  # 0.5 s each, of which 0.25 s are searched
    film = write_video(tmp_path / "IMG_0042.MOV", frames, 8.0, "png ")
    small, cut = tmp_path / "IMG_0043.MP4", tmp_path / "IMG_0044.MOV"
    small.write_bytes(video())
    cut.write_bytes(video()[: len(video()) // 2])
    logins = cookies(tmp_path / "clinic")
    with served(tmp_path / "clinic") as (address, _):
        page = opened(browser, f"http://{address}", logins["technician"], width=1200)
        started(page)
        for wrong, name in (([small, wall], "1 photograph"), ([small, cut], "2 videos"), ([cut], cut.name)):
            drop(page, wrong)
            expect(page.locator("[data-refused] li")).to_have_count(1)
            expect(page.locator("[data-refused]")).to_contain_text(name)
        page.locator(".place.bad").get_by_role("button").click()
        expect(page.locator(".place.bad")).to_have_count(0)
        slow = page.context.new_cdp_session(page)
        slow.send("Network.enable")
        line = {"offline": False, "latency": 0, "downloadThroughput": -1, "uploadThroughput": 10_000_000}
        slow.send("Network.emulateNetworkConditions", line)
        page.get_by_label("Choose photographs or a video").set_input_files(film)
        expect(page.get_by_role("progressbar", name="IMG_0042.MOV on its way")).to_be_visible()
        slow.send("Network.emulateNetworkConditions", {**line, "uploadThroughput": -1})
        expect(page.locator(".place.good")).to_have_count(1, timeout=60_000)
        require_accessible(page)
        require_fitting(page)
        page.get_by_role("button", name="Measure").click()
        expect(page.get_by_role("heading", name="Left breast")).to_be_visible(timeout=MEASURED_MS)
        page.get_by_text("Frames of the video: ").click()
        require_accessible(page)
        require_fitting(page)
        assert page.wrong == []  # type: ignore[attr-defined]
        (folder,) = (tmp_path / "clinic" / "sessions").iterdir()
        assert not list((tmp_path / "clinic" / "uploads").iterdir())
        assert not [path for path in folder.rglob("*") if path.suffix in (".mp4", ".mov")]
        assert json.loads((folder / "walk.json").read_text())["times"]
        for side, volume_cc in true_cc.items():
            card = page.locator(f"[aria-labelledby='h-{side}']")
            low, high = (float(word) for word in card.locator(".number").inner_text().replace("cc", "").split(" to "))
            assert low < volume_cc < high
        assert page.request.get(f"{page.url}report/").ok
