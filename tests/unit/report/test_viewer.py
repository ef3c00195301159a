"""The 3D viewer in a real browser: a page from disk, no network, real clicks and keys."""

import io
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
import trimesh
from PIL import Image
from playwright.sync_api import Locator, Page, expect, sync_playwright
from tests.patience import patient

from mammometry.base.identity import Identity
from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.landmarks.geodesic import geodesic
from mammometry.report import content
from mammometry.report.documents import html
from mammometry.report.figures.shading import front_frame
from mammometry.report.first_page import first_page
from mammometry.report.models import viewer_scene
from mammometry.report.scene import ViewedSurface, to_json
from mammometry.report.words import describe
from mammometry.settings import Settings

CHROMIUM = shutil.which("chromium")
FLAGS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",  # WebGL without a graphics card
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
]

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: apt-get install chromium")


def furrowed() -> TriangleMesh:
    """A ball with furrows 8 mm deep across it, so that the way along it is clearly not the straight one."""
    ball = synthetic.ball(5)
    depth = 1 - 0.07 * (1 + np.cos(ball.vertices[:, 0] / 6.0)) * np.exp(-((ball.vertices[:, 1] / 40.0) ** 2))
    return TriangleMesh(vertices=ball.vertices * depth[:, None], faces=ball.faces)


FURROWED = furrowed()


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> str:
    ball = synthetic.ball(4)
    measured = [synthetic.measurement("left"), synthetic.measurement("right")]
    changed, everything = describe.settings_facts(Settings())
    scene = viewer_scene(front_frame(synthetic.rig()), synthetic.repaired(ball), synthetic.textured(ball), measured)
    crowded = tuple(
        ("48 ± 15 mm along the skin", np.array([[across - 5.0, 50.0, 0.0], [across + 5.0, 50.0, 0.0]]))
        for across in range(-36, 37, 6)
    )
    shown = replace(scene.models[0], lengths=crowded)
    other = ViewedSurface(name="furrowed", title="Furrowed", mesh=FURROWED, normals=FURROWED.vertex_normals())
    page_content = content.ReportContent(
        identity=Identity(name="Case"),
        created="2024-01-01 00:00 UTC",
        subject=describe.SUBJECTS["torso"],
        world="The board in pose 00.",
        warnings=(),
        breasts=tuple(describe.breast_report(each) for each in measured),
        comparison=(),
        stages=(),
        timings=(),
        changed_settings=changed,
        all_settings=everything,
        versions=describe.versions(),
        scene=to_json(replace(scene, models=(shown, *scene.models[1:], other))),
    )
    page = tmp_path_factory.mktemp("report") / "report.html"
    page.write_text(html.render(page_content, first_page(page_content, {}, None, named=True)), encoding="utf-8")
    return page.as_uri()


@pytest.fixture(scope="module")
def page(address: str) -> Iterator[Page]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = patient(browser.new_page(viewport={"width": 1000, "height": 800}))
        asked: list[str] = []
        wrong: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.goto(address)
        page.wait_for_function("document.getElementById('mm-viewer').dataset.ready !== undefined")
        yield page
        assert wrong == []
        assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []
        browser.close()


@pytest.fixture
def viewer(page: Page) -> Locator:
    page.reload()
    page.wait_for_function("document.getElementById('mm-viewer').dataset.ready === '1'")
    viewer = page.locator("#mm-viewer")
    viewer.scroll_into_view_if_needed()
    return viewer


def press(viewer: Locator, name: str) -> None:
    viewer.get_by_role("button", name=name, exact=True).click()


def picture(canvas: Locator) -> np.ndarray:
    canvas.page.wait_for_timeout(250)  # a frame or two, drawn without a graphics card
    return np.asarray(Image.open(io.BytesIO(canvas.screenshot())).convert("RGB")).astype(int)


def centre_colour(canvas: Locator) -> np.ndarray:
    drawn = picture(canvas)
    height, width = drawn.shape[:2]
    return drawn[height // 2 + 20 : height // 2 + 40, width // 2 - 10 : width // 2 + 10].reshape(-1, 3).mean(axis=0)


@pytest.mark.slow
def test_photograph_and_layers_are_drawn_in_their_colours(viewer: Locator) -> None:
    colour = viewer.get_by_label("Colour")
    press(viewer, "Boundary")  # off: its line must not lie in the way
    canvas = viewer.locator("canvas")
    assert np.abs(centre_colour(canvas) - (205, 160, 140)).max() < 4  # unlit: the photograph's own colour
    colour.select_option("provenance")
    red, green, blue = centre_colour(canvas)
    assert blue > green > red  # measured is blue
    assert "measured" in viewer.locator(".mm-legend").inner_text()
    colour.select_option("error")
    assert re.search(r"0\.00\s+0\.10 mm", viewer.locator(".mm-legend").inner_text())


def test_a_click_reads_the_surface_and_two_measure_a_distance(viewer: Locator) -> None:
    viewer.get_by_label("Colour").select_option("error")
    box = viewer.locator("canvas").bounding_box()
    assert box is not None
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    viewer.page.mouse.click(*middle)
    readout = viewer.locator(".mm-readout")
    assert readout.inner_text() == "Expected error: 0.10 mm."
    press(viewer, "Measure")
    # The picture spans the ball's 120 mm and its margin in height: a known scale.
    mm_per_px = 1.08 * 2 * synthetic.RADIUS_MM / box["height"]
    step_px = 20.0 / mm_per_px
    viewer.page.mouse.click(middle[0] - step_px, middle[1])
    assert "second" in readout.inner_text()
    viewer.page.mouse.click(middle[0] + step_px, middle[1])
    straight_mm, along_mm = measured_distances(viewer)
    # Half a pixel at either end, 0.2 mm each.
    assert straight_mm == pytest.approx(40.0, abs=0.5)
    assert along_mm == pytest.approx(2 * synthetic.RADIUS_MM * np.arcsin(20.0 / synthetic.RADIUS_MM), abs=0.5)


def measured_distances(viewer: Locator) -> tuple[float, float]:
    """Straight and along the skin, mm, as the readout says once both are known."""
    said = re.compile(r"Straight distance: ([\d.]+) mm; along the skin: ([\d.]+) mm \(at most 0\.5 % too long\)\.")
    readout = viewer.locator(".mm-readout")
    expect(readout).to_have_text(said)
    found = said.fullmatch(readout.inner_text())
    assert found
    return float(found[1]), float(found[2])


@pytest.mark.slow
@pytest.mark.parametrize(("first", "second"), [((-45.0, 5.0), (47.0, -12.0)), ((10.0, 50.0), (-20.0, -48.0))])
def test_the_way_along_the_skin_is_that_of_the_measurement(
    viewer: Locator, first: tuple[float, float], second: tuple[float, float]
) -> None:
    """Two clicks on a furrowed ball, against `measure.geodesic` between the points that the same rays meet."""
    viewer.get_by_label("Show").select_option(label="Furrowed")
    mesh = FURROWED
    canvas = viewer.get_by_role("img", name="Furrowed: three-dimensional view")
    expect(canvas).to_be_visible()  # it takes the former model's place in a frame or two
    box = canvas.bounding_box()
    assert box is not None
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    mm_per_px = 1.08 * float(high[1] - low[1]) / box["height"]  # the canvas is wider than high
    centre = (low + high) / 2
    press(viewer, "Measure")
    met = []
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    for x, y in (first, second):
        viewer.page.mouse.click(
            box["x"] + box["width"] / 2 + (x - centre[0]) / mm_per_px,
            box["y"] + box["height"] / 2 - (y - centre[1]) / mm_per_px,
        )
        hits = solid.ray.intersects_location(np.array([[x, y, 500.0]]), np.array([[0.0, 0.0, -1.0]]))[0]
        met.append(hits[np.argmax(hits[:, 2])])
    straight_mm, along_mm = measured_distances(viewer)
    expected = geodesic(mesh, met[0], met[1]).length_mm
    assert expected > 1.1 * straight_mm
    # Both searches are up to .4 % too long; half a pixel at either end on slopes of up to 45°, and 16-bit positions.
    assert along_mm == pytest.approx(expected, rel=0.005, abs=0.6)
    assert straight_mm == pytest.approx(float(np.linalg.norm(met[1] - met[0])), abs=0.6)


@pytest.mark.slow
def test_keys_turn_the_model_and_a_section_cuts_it(viewer: Locator) -> None:
    canvas = viewer.locator("canvas")
    viewer.get_by_label("Colour").select_option("provenance")
    canvas.focus()
    front = picture(canvas)
    for _ in range(24):  # half a turn: what was invented comes to the front
        canvas.press("ArrowRight")
    behind = picture(canvas)
    assert np.abs(front - behind).max() > 60
    canvas.press("1")
    assert np.abs(picture(canvas) - front).mean() < 1.0
    viewer.get_by_label("Section", exact=False).first.select_option("across")
    cut = picture(canvas)
    width = cut.shape[1]
    ground = front[5, 5]
    empty = np.abs(cut - ground).max(axis=2) < 12
    assert empty[:, : width // 2 - 20].mean() < 0.75  # the left half stays
    assert empty[200:400, width // 2 + 20 :].mean() > 0.9  # beyond the plane there is nothing but lines
    assert "Section at" in viewer.locator(".mm-readout").inner_text()


@pytest.mark.slow
def test_two_pictures_turn_together(viewer: Locator) -> None:
    viewer.get_by_label("Show").select_option(label="Left breast beside the mirrored right one")
    viewer.page.wait_for_function("document.querySelectorAll('#mm-viewer canvas').length === 2")
    first, second = viewer.locator("canvas").all()
    before = picture(second)
    first.focus()
    for _ in range(6):
        first.press("ArrowUp")
    assert np.abs(picture(second) - before).max() > 40
    assert "mirrored" in viewer.locator("figcaption").nth(1).inner_text()


@pytest.mark.slow
def test_a_screenshot_is_saved(viewer: Locator) -> None:
    with viewer.page.expect_download() as download:
        press(viewer, "Screenshot")
    assert download.value.suggested_filename == "whole-photograph.png"
    saved = np.asarray(Image.open(Path(download.value.path())))
    assert saved.shape[2] == 4
    assert np.ptp(saved[..., 3]) == 255  # the model on a clear ground


@pytest.mark.slow
def test_it_fits_a_telephone_and_no_length_covers_another(viewer: Locator) -> None:
    viewer.page.set_viewport_size({"width": 360, "height": 740})
    try:
        # The canvas follows its holder, then lengths are placed in the next frame.
        viewer.page.wait_for_function(
            "canvas => canvas.parentElement.clientWidth <= 360"
            " && canvas.clientWidth === canvas.parentElement.clientWidth",
            arg=viewer.locator("canvas").element_handle(),
        )
        viewer.page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
        boxes = viewer.locator(".mm-lengths text").evaluate_all(
            "all => all.map(words => words.getBBox()).map(box => [box.x, box.y, box.width, box.height])"
        )
        places, sizes = np.hsplit(np.array(boxes), 2)
        assert len(places) == 13
        apart = np.abs(places[:, None] - places) > sizes.max(axis=0) - 0.6  # all have the same words
        assert (apart.any(axis=2) | np.eye(13, dtype=bool)).all()
        sheet = viewer.locator(".mm-lengths").bounding_box()
        assert sheet is not None
        assert (places > -0.6).all()
        assert (places + sizes < [sheet["width"] + 0.6, sheet["height"] + 0.6]).all()
        assert viewer.page.evaluate("document.documentElement.scrollWidth") == 360
        box = viewer.locator("canvas").bounding_box()
        assert box is not None
        assert box["width"] > 300
        assert box["height"] > 300
    finally:
        viewer.page.set_viewport_size({"width": 1000, "height": 800})
