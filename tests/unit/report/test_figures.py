"""Previews of every stage from synthetic values: they exist, carry captions, and show what the values say."""

import io
import re
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import synthetic
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox
from PIL import Image
from scipy.spatial.transform import Rotation

from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform
from mammometry.measure.shape.symmetry import Symmetry
from mammometry.measure.trunk.body import BodyDirections
from mammometry.report.figures import canvas, shading, stage_results, surface
from mammometry.report.figures.canvas import Caption
from mammometry.report.figures.shading import front_frame, front_of
from mammometry.report.figures.stage_results import CalibrationResult, MatchingResult, SurfaceResult
from mammometry.report.figures.thinning import matched_shares, thinned_ranges
from mammometry.surface.repair.repair import Provenance


@pytest.fixture(scope="module")
def rig():
    return synthetic.rig()


def words_on_words(figure: Figure) -> list[tuple[str, str]]:
    """Pairs of texts whose boxes lie on one another by more than a third of the smaller one's height."""
    drawer = FigureCanvasAgg(figure)
    drawer.draw()
    undrawn = set()  # labels of ticks beyond the axes' limits
    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        low, high = sorted(axis.get_view_interval())
        for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
            if not low - 1e-9 <= tick.get_loc() <= high + 1e-9 or not axis.get_visible() or not axis.axes.axison:
                undrawn |= {tick.label1, tick.label2}
    shown = [
        (text.get_text(), text.get_window_extent(drawer.get_renderer()))
        for text in figure.findobj(Text)
        if text.get_visible() and text.get_text().strip() and text not in undrawn
    ]
    found = []
    for (one, box), (other, beside) in combinations(shown, 2):
        both = Bbox.intersection(box, beside)
        if both is not None and both.width > 1 and both.height > min(box.height, beside.height) / 3:
            found.append((one, other))
    return found


@pytest.fixture(autouse=True)
def no_words_on_words(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every picture that is drawn here is looked at before it is written."""
    written = canvas.PanelSheet.png

    def looked_at(sheet: canvas.PanelSheet, title: str, text: str) -> bytes:
        assert words_on_words(sheet.figure) == [], title
        return written(sheet, title, text)

    monkeypatch.setattr(canvas.PanelSheet, "png", looked_at)


def test_words_on_words_are_seen() -> None:
    sheet = canvas.PanelSheet(1, 1, (200, 100))
    axes = sheet.panel(0, "title")
    axes.text(0.5, 0.5, "one")
    assert words_on_words(sheet.figure) == []
    axes.text(0.52, 0.5, "other")
    assert words_on_words(sheet.figure) == [("one", "other")]


def check(pictures: dict[str, bytes], names: set[str]) -> None:
    assert set(pictures) == names
    for name, png in pictures.items():
        caption = canvas.caption_of(png)
        assert caption.title, name
        assert caption.text.endswith("."), name
        with Image.open(io.BytesIO(png)) as image:
            pixels = np.asarray(image.convert("RGB"))
            assert image.width <= 1600, name
        assert (pixels[[0, -1]] == 255).all(), f"{name}: something is cut off at the upper or lower edge"
        assert (pixels[:, [0, -1]] == 255).all(), f"{name}: something is cut off at the left or right edge"
        assert (pixels != 255).any(axis=2).mean() > 0.01, f"{name}: nothing is drawn"


@pytest.mark.slow
def test_calibration(rig) -> None:
    calibration = synthetic.calibration(rig)
    photographs = {
        (seen.pose, seen.camera): synthetic.photographs(rig)[seen.camera]
        for seen in calibration.observations.detections
    }
    check(
        stage_results.draw(CalibrationResult(rig=rig, calibration=calibration, photographs=photographs)),
        {"rig", "detections", "residuals", "residual-field", "expected-error"},
    )


def test_ready_made_cameras_have_only_their_places(rig) -> None:
    check(stage_results.draw(CalibrationResult(rig=rig)), {"rig"})


@pytest.mark.slow
def test_matching(rig) -> None:
    disparities = synthetic.disparities(rig, d_v_px=0.1)
    shown = MatchingResult.thinned(rig, synthetic.photographs(rig), synthetic.foregrounds(rig), disparities)
    pictures = stage_results.draw(shown)
    check(pictures, {"foreground", "rectified", "disparity", "confidence"})


@pytest.mark.slow
def test_matching_without_silhouettes(rig) -> None:
    foregrounds = synthetic.foregrounds(rig, everything=True)
    shown = MatchingResult.thinned(rig, synthetic.photographs(rig), foregrounds, synthetic.disparities(rig))
    pictures = stage_results.draw(shown)
    check(pictures, {"foreground", "rectified", "disparity", "confidence"})


@pytest.mark.slow
def test_surface(rig) -> None:
    images = synthetic.ranges(rig)
    mesh = synthetic.ball()
    shown = SurfaceResult(
        rig=rig,
        ranges=thinned_ranges(images, synthetic.valid(images)),
        first=synthetic.ball(3),
        repaired=synthetic.repaired(mesh),
        textured=synthetic.textured(mesh),
    )
    pictures = stage_results.draw(shown)
    check(pictures, {"range", "dents", "repair", "provenance", "convergence", "views"})


@pytest.mark.slow
def test_measure(rig) -> None:
    pictures = stage_results.draw(synthetic.measured(rig, [synthetic.measurement()], synthetic.ball()))
    check(pictures, {"overview", "closed-model", "sections-model", "front", "from_left", "from_right"})


@pytest.mark.slow
def test_both_sides_are_drawn_with_the_viewers_colours(rig) -> None:
    left = synthetic.measurement("left")
    away = left.boundary_world - (200.0, 0.0, 0.0)
    mirrored = TriangleMesh(vertices=left.closed.vertices * (-1.0, 1.0, 1.0), faces=left.closed.faces[:, ::-1])
    right = replace(synthetic.measurement("right"), boundary_world=away, closed=mirrored)
    out_mm = np.where(left.closed.vertices[:, 1] > 0, 4.0, -4.0)
    sides = Symmetry(
        plane_point_world=np.zeros(3), plane_normal_world=np.array([1.0, 0.0, 0.0]), plane_sigma_mm=1.0,
        trunk_scatter_mm=1.0, left_from_mirrored=Transform.identity(), shift_mm=np.array([0.0, 3.0, 4.0]), turn_deg=0.0,
        difference_cc=0.0, difference_interval_cc=None,
        ratio=1.0, rms_mirrored_mm=2.0, rms_mm=1.0, left_mm=out_mm, right_mm=-out_mm,
    )  # fmt: skip
    pictures = stage_results.draw(replace(synthetic.measured(rig, [left, right], synthetic.ball()), symmetry=sides))
    assert {"overview", "symmetry"} <= set(pictures)
    caption = canvas.caption_of(pictures["symmetry"])
    assert "±5 mm" in caption.text
    assert caption.text.count("5 mm") > 1
    drawn = np.asarray(Image.open(io.BytesIO(pictures["symmetry"])).convert("RGB")).astype(int)
    height, width = drawn.shape[:2]
    first = drawn[60 : height - 20, 14 : width // 5]
    warm = (first[..., 0] - first[..., 2] > 60).nonzero()[0]
    cold = (first[..., 2] - first[..., 0] > 60).nonzero()[0]
    assert min(len(warm), len(cold)) > 500
    assert abs(warm.mean() - cold.mean()) > 0.2 * height  # fuller above, less below, or upside down as the rig stands


def test_the_scale_is_the_viewers() -> None:
    text = (Path(__file__).parents[3] / "viewer" / "src" / "colours.ts").read_text(encoding="utf-8")
    stops = re.search(r"const DIVERGING = \[(.*?)\]", text)
    assert stops is not None
    assert tuple(re.findall(r"#\w{6}", stops[1])) == canvas.DIVERGING
    scale = canvas.diverging_scale(2.0)
    colours = canvas.coloured(np.array([-2.0, 0.0, 2.0, np.nan]), scale)
    expected = [canvas.rgb(canvas.DIVERGING[k]) for k in (0, 4, -1)] + [canvas.rgb(canvas.DIVERGING_MISSING)]
    np.testing.assert_allclose(colours, expected, atol=0.01)


def test_an_open_surface_has_nothing_measured_to_show(rig) -> None:
    assert stage_results.draw(synthetic.measured(rig, [], synthetic.ball(1))) == {}


def test_all_of_the_silhouette_is_matched_or_half_of_it(rig) -> None:
    found = synthetic.disparities(rig)
    seen = synthetic.foregrounds(rig)
    assert matched_shares(rig, seen, found) == {"one": 1.0, "two": 1.0}
    upper = np.zeros(found["one"].valid.shape, dtype=bool)
    upper[: upper.shape[0] // 2] = True
    halved = {name: replace(each, valid=each.valid & upper) for name, each in found.items()}
    assert matched_shares(rig, seen, halved)["one"] == pytest.approx(0.5, abs=0.02)
    unknown = rig.pair_names["one"][0]
    seen = {**seen, unknown: replace(seen[unknown], everything=True)}
    assert matched_shares(rig, seen, found) == {"two": 1.0}  # of what has no silhouette, nothing is a share


def test_provenance_shares_of_a_ball_are_those_of_its_zones() -> None:
    """Archimedes: a zone's area goes with its height; ½ measured, ⅛ repaired, ⅛ bridged, ¼ invented."""
    shares = surface.provenance_shares(synthetic.repaired(synthetic.ball(5)))
    assert shares[Provenance.MEASURED] == pytest.approx(0.5, abs=0.01)
    assert shares[Provenance.REPAIRED] == pytest.approx(0.125, abs=0.01)
    assert shares[Provenance.BRIDGED] == pytest.approx(0.125, abs=0.01)
    assert sum(shares.values()) == pytest.approx(1.0)


def test_the_wall_is_told_from_the_skin() -> None:
    measured = synthetic.measurement()
    wall = shading.wall_faces(measured)
    normals = measured.closed.face_vectors()
    assert (normals[wall, 2] > 0).all()  # away from the cameras
    np.testing.assert_allclose(np.linalg.norm(normals[wall], axis=1).sum(), 100 * measured.base_area_cm2)


def test_the_front_view_is_the_bodys_own_where_it_is_known() -> None:
    cameras = synthetic.rig()
    turned = Rotation.from_euler("xyz", (5, -8, 20), degrees=True).as_matrix()
    body = BodyDirections(frame=turned, point_world=np.zeros(3), plane_sigma_mm=0.2, scatter_mm=0.5)
    np.testing.assert_array_equal(front_of(cameras, body), turned)
    np.testing.assert_array_equal(front_of(cameras, None), front_frame(cameras))
    upside_down = front_frame(cameras, mounting=dict.fromkeys(cameras.cameras, "upside-down"))
    np.testing.assert_allclose(upside_down, front_frame(cameras) * [[-1], [-1], [1]], atol=1e-12)


def test_captions_survive_in_the_file_and_strangers_have_none() -> None:
    pixels = np.zeros((4, 5, 3), dtype=np.uint8)
    caption = Caption(title="σ ≤ 1 µm", text="ü – “quoted”.")
    assert canvas.caption_of(canvas.encode(pixels, caption)) == caption
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG")
    assert canvas.caption_of(buffer.getvalue()) == Caption(title="", text="")


@pytest.mark.parametrize(
    ("length", "round_one"), [(0.0134, 0.01), (0.02, 0.02), (9.99, 5.0), (50.0, 50.0), (199.0, 100.0)]
)
def test_round_lengths(length: float, round_one: float) -> None:
    assert canvas.round_length(length) == pytest.approx(round_one)


@pytest.mark.parametrize("count", range(1, 14))
def test_grids_hold_their_panels_with_the_fewest_rows(count: int) -> None:
    columns, rows = canvas.grid(count)
    assert columns <= 4
    assert columns * rows >= count
    assert rows == -(-count // 4)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_small_copies_keep_the_mean_and_the_proportion(dtype: type) -> None:
    from mammometry.base.photograph import Photograph

    top = np.iinfo(dtype).max
    pixels = np.random.default_rng(0).integers(0, top, (120, 180), dtype=dtype)
    small = canvas.reduced(Photograph(name="grey", pixels=pixels), 45)
    assert small.shape == (30, 45, 3)
    assert small.mean() / 255 == pytest.approx(pixels.mean() / top, abs=0.005)
