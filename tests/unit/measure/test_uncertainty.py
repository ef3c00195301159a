"""The interval term by term, worked by hand, and the boundary's jitter on a sphere."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from solids import as_surface, ball

from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform
from mammometry.matching.foreground.foreground import Foreground
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.settings import MeasureSettings, ObserverSettings
from mammometry.measure.volume import boundary_jitter
from mammometry.measure.volume.boundary_jitter import boundary_std_cc, displacements_mm, drawn_sigma_mm
from mammometry.measure.volume.sources import WALL_FIT_U95_MM
from mammometry.measure.volume.uncertainty import EarlierErrors, VolumeEvidence, interval
from mammometry.measure.volume.unseen_space import bounds
from mammometry.measure.wall.chest_wall import ChestWall, fit
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.surface.repair.repair import Provenance, RepairedSurface

UNCERTAINTY = "mammometry.measure.volume.uncertainty"


@pytest.fixture(autouse=True)
def plain_terms(monkeypatch: pytest.MonkeyPatch) -> None:
    """Terms that can be computed by hand."""
    for name, value in {"UNSEEN_SLOPE": 0.0, "COMMON_SHARE": 0.0}.items():
        monkeypatch.setattr(f"{UNCERTAINTY}.{name}", value)


def sheet(width_mm: float) -> TriangleMesh:
    """A square of 100 × 100 cells, in the plane."""
    s = np.linspace(0.0, width_mm, 101)
    x, y = np.meshgrid(s, s)
    grid = np.arange(101 * 101).reshape(101, 101)
    a, b, c, d = grid[:-1, :-1].ravel(), grid[:-1, 1:].ravel(), grid[1:, :-1].ravel(), grid[1:, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])
    return TriangleMesh(vertices=np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3), faces=faces.astype(np.int32))


SHEET = sheet(100.0)
WALL_CC = 4.5 * np.sqrt(100 / 170) * 10  # over 100 cm²; on real women, whose bases have 170 cm², 4.5 mm
RIM = np.array([[0.0, 0, 0], [100, 0, 0], [100, 100, 0], [0, 100, 0]])


def wall(kind: str = "cylinder-membrane") -> ChestWall:
    return ChestWall(kind=kind, definition="", mesh=SHEET, skin=SHEET, closed=SHEET)


def skin(provenance: np.ndarray) -> RepairedSurface:
    n = len(SHEET.vertices)
    return RepairedSurface(
        mesh=SHEET,
        provenance=provenance.astype(np.uint8),
        sigma_mm=np.where(provenance == Provenance.MEASURED, 0.5, np.nan).astype(np.float32),
        pair_bits=np.ones(n, dtype=np.int32),
        pair_names=("front",),
        convergence=np.zeros(1),
    )


def test_the_terms_of_a_torso() -> None:
    """100 cm² of base and skin: lower half measured, then a quarter each repaired and invented."""
    y = SHEET.vertices[:, 1]
    origin = np.where(y < 49.6, Provenance.MEASURED, np.where(y < 74.6, Provenance.REPAIRED, Provenance.INVENTED))
    found = interval(
        Boundary(name="left", points_world=RIM, method=""),
        wall(),
        400.0,
        evidence=VolumeEvidence(
            surface=skin(origin), earlier=EarlierErrors(scale_std=0.001, point_std_mm=0.03), boundary_std_cc=8.0
        ),
    )
    patch = np.pi * 9.0
    assert dict(found.terms_cc) == pytest.approx(
        {
            "scale": 1.96 * 3 * 0.001 * 400,
            "calibration": 1.96 * 0.03 / np.sqrt(3) * 10,
            "matching": 1.96 * np.hypot(0.02 * 5000, 0.5 * np.sqrt(5000 * patch)) / 1000,
            "repaired surface": 1.96 * 0.1 * 2500 / 1000,
            "invented surface": 1.96 * 0.4 * 2500 / 1000,
            "boundary": 1.96 * 8,
            "chest wall": WALL_CC,
        },
        rel=0.025,  # vertices on the seams own half a cell
    )
    half = np.sqrt(sum(term**2 for term in found.terms_cc.values()))
    assert found.interval_cc == pytest.approx((400 - half, 400 + half))
    assert "not cover" not in found.note
    wall_mm = WALL_FIT_U95_MM  # of each of two walls that differ by so much
    half = np.sqrt(half**2 - WALL_CC**2 + (wall_mm * 10) ** 2)
    assert found.as_defined_cc == pytest.approx((400 - half, 400 + half))


@pytest.mark.requirement("R-VOL-5")
def test_invented_skin_is_the_less_known_the_farther_it_lies_from_measured_skin(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The upper half is invented: 100 mm wide and up to 50 mm away, 125 cm³ of distance and area."""
    origin = np.where(SHEET.vertices[:, 1] < 50.5, Provenance.MEASURED, Provenance.INVENTED)
    monkeypatch.setattr(f"{UNCERTAINTY}.INVENTED_SIGMA_MM", 0.0)
    monkeypatch.setattr(f"{UNCERTAINTY}.UNSEEN_SLOPE", 0.3)
    boundary = Boundary(name="model", points_world=RIM, method="", sigma_mm=0.05)
    found = interval(boundary, wall("plane"), 400.0, evidence=VolumeEvidence(surface=skin(origin)))
    assert found.terms_cc["invented surface"] == pytest.approx(1.96 * 0.3 * 125, rel=0.02)
    nothing = interval(
        boundary, wall("plane"), 400.0, evidence=VolumeEvidence(surface=skin(np.full(101 * 101, Provenance.INVENTED)))
    )
    assert "invented surface" not in nothing.terms_cc  # how far it is from measured skin cannot be said


def test_invented_skin_in_a_pit_may_be_off_by_all_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pit of a pyramid's form, 40 × 40 mm and 30 mm deep: 16 cc. What stands out as far is no pit."""
    monkeypatch.setattr(f"{UNCERTAINTY}.INVENTED_SIGMA_MM", 0.0)
    away = np.abs(SHEET.vertices[:, :2] - 50).max(axis=1)
    origin = np.where(away < 20, Provenance.INVENTED, Provenance.MEASURED)
    boundary = Boundary(name="model", points_world=RIM, method="", sigma_mm=0.05)
    for sign, expected_cc in ((-1, 16.0), (1, 0.0)):
        bent = SHEET.vertices + sign * np.outer(30 * np.clip(1 - away / 20, 0, None), [0.0, 0, 1])
        own = replace(SHEET, vertices=bent)
        surface, closing = replace(skin(origin), mesh=own), replace(wall("plane"), skin=own)
        found = interval(boundary, closing, 400.0, evidence=VolumeEvidence(surface=surface))
        assert found.terms_cc.get("invented surface", 0.0) == pytest.approx(1.96 * expected_cc, rel=0.02)


def test_skin_that_could_not_stand_out_unseen_is_known_better(monkeypatch: pytest.MonkeyPatch) -> None:
    """As before, before a camera that sees the sheet from its edge, whose picture is dark more than 6 mm above it.

    A pixel is a millimetre 1000 mm away: the bound is blurred by that, by the doubt of 1 px, by a step of 50/24 mm.
    """
    origin = np.where(SHEET.vertices[:, 1] < 50.5, Provenance.MEASURED, Provenance.INVENTED)
    monkeypatch.setattr(f"{UNCERTAINTY}.INVENTED_SIGMA_MM", 0.0)
    monkeypatch.setattr(f"{UNCERTAINTY}.UNSEEN_SLOPE", 0.3)
    boundary = Boundary(name="model", points_world=RIM, method="", sigma_mm=0.05)
    beside = Transform(
        rotation=np.array([[0.0, 1, 0], [0, 0, -1], [-1, 0, 0]]), translation_mm=np.array([-50.0, 0, 9e3])
    )
    matrix = np.array([[9e3, 0, 100], [0, 9e3, 50], [0, 0, 1.0]])
    camera = Camera(name="c", size_wh=(200, 100), matrix=matrix, distortion=np.zeros(5), camera_from_world=beside)
    dark = np.ones((100, 200), dtype=np.float32)
    dark[:44] = 0  # rows 50 − 6 and lower numbers are more than 6 mm up
    dark[:, :20] = dark[:, -20:] = dark[-20:] = 0
    seen = Foreground(camera="c", coverage=gaussian_filter(dark, 0.7), contour_level=0.5, everything=False)
    views = bounds({"c": seen}, (), Rig(name="r", cameras={"c": camera}, pair_names={}))
    found = interval(boundary, wall("plane"), 400.0, evidence=VolumeEvidence(surface=skin(origin), views=views))
    assert found.terms_cc["invented surface"] == pytest.approx(1.96 * 0.3 * (43 * 7 + 7 * 7 / 2) / 10, rel=0.2)


def test_a_share_of_the_expected_error_is_common_to_all_measured_skin(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(f"{UNCERTAINTY}.COMMON_SHARE", 0.4)
    monkeypatch.setattr(f"{UNCERTAINTY}.MATCHING_REACH_MM", 1e-3)
    settings = MeasureSettings(surface_sigma_mm=0.0)
    boundary = Boundary(name="model", points_world=RIM, method="", sigma_mm=0.05)
    seen = skin(np.full(len(SHEET.vertices), Provenance.MEASURED))
    found = interval(boundary, wall("plane"), 400.0, settings, VolumeEvidence(surface=seen))
    assert found.terms_cc["matching"] == pytest.approx(1.96 * 0.4 * 0.5 * 10, rel=0.01)


def test_what_is_not_known_is_said() -> None:
    boundary = Boundary(name="model", points_world=RIM, method="", sigma_mm=0.05)
    found = interval(boundary, wall("plane"), 400.0)
    assert set(found.terms_cc) == {"matching", "base"}
    assert found.terms_cc["base"] == pytest.approx(1.96 * 0.05 * 10)
    assert "board" in found.note
    assert found.as_defined_cc is None  # a cast ends at its base
    unknown = interval(Boundary(name="model", points_world=RIM, method=""), wall("plane"), 400.0)
    assert unknown.interval_cc is None


@pytest.mark.requirement("R-VOL-7")
def test_a_flat_wall_of_a_torso_is_told_to_be_biased() -> None:
    found = interval(Boundary(name="left", points_world=RIM, method=""), wall("plane"), 400.0)
    assert "large" in found.note


def test_a_measured_wall_is_known_better(monkeypatch: pytest.MonkeyPatch) -> None:
    found = interval(Boundary(name="left", points_world=RIM, method=""), wall("measured"), 400.0)
    assert found.terms_cc["chest wall"] == pytest.approx(10.0)
    assert found.as_defined_cc == found.interval_cc


def test_the_jitter_is_as_great_everywhere() -> None:
    modes = displacements_mm(np.full(90, 3.0))
    assert len(modes) == 7
    assert np.allclose((modes**2).sum(axis=0), 9.0)
    assert np.allclose(modes @ modes.T, np.diag(np.diag(modes @ modes.T)), atol=1e-9)


def alike(sigma_mm: float) -> ObserverSettings:
    return ObserverSettings(medial_mm=sigma_mm, lower_mm=sigma_mm, upper_mm=sigma_mm, lateral_mm=sigma_mm)


@pytest.mark.parametrize(("name", "sign"), [("left", 1), ("right", -1)])
def test_a_curve_is_least_sure_towards_the_armpit(name: str, sign: int) -> None:
    observers = ObserverSettings(medial_mm=2.0, lower_mm=1.0, upper_mm=3.0, lateral_mm=4.0)
    t = 2 * np.pi * np.arange(360) / 360
    edge = 60 * np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)
    boundary = Boundary(name=name, points_world=edge, method="")  # type: ignore[arg-type]
    sigma = drawn_sigma_mm(boundary, np.eye(3), observers)
    assert sigma[[0, 90, 180, 270]] == pytest.approx([4, 3, 2, 1] if sign > 0 else [2, 3, 4, 1])
    assert np.sqrt(np.mean(sigma**2)) == pytest.approx(observers.mean_mm)
    halfway = np.hypot(*((4.0, 3.0) if sign > 0 else (2.0, 3.0))) / np.sqrt(2)
    assert sigma[45] == pytest.approx(halfway)
    turned = replace(boundary, points_world=edge[:, [2, 0, 1]])  # another frame of the world: x of the body is y
    assert drawn_sigma_mm(turned, np.roll(np.eye(3), 1, axis=1), observers) == pytest.approx(sigma)
    assert drawn_sigma_mm(boundary, None, observers) == pytest.approx(np.full(360, observers.mean_mm))


def test_published_distances_of_two_ratings_follow_from_the_regions() -> None:
    """Two ratings with σ across and along lie √π σ apart on average: 3.5 to 6.7 mm (doi 10.1007/s00238-018-1431-2)."""
    rng = np.random.default_rng(5)
    observers = MeasureSettings().observers
    for sigma, published in ((observers.medial_mm, 3.5), (observers.lateral_mm, 6.7)):
        apart = np.linalg.norm(rng.normal(0, sigma, (20_000, 2)) - rng.normal(0, sigma, (20_000, 2)), axis=1)
        assert apart.mean() == pytest.approx(published, rel=0.02)  # sigmas are given to a tenth of a millimetre


@pytest.mark.slow
def test_a_caps_volume_changes_with_its_width_alone() -> None:
    """A spherical cap of 60° that is shifted or made oblong keeps its volume to first order.

    Wider by half σ, it is the cap of a greater angle: V = π h² (3R − h) / 3.
    """
    radius, sigma = 50.0, 6.0
    t = 2 * np.pi * np.arange(120) / 120
    ring, height = radius * np.sin(np.pi / 3), radius * np.cos(np.pi / 3)
    edge = np.stack([ring * np.cos(t), ring * np.sin(t), np.full(120, height)], axis=1)
    surface = as_surface(ball(radius, 6))
    boundary = Boundary(name="left", points_world=edge, method="")
    settings = MeasureSettings(observers=alike(sigma))
    breast = OpenBreast(boundary=boundary, surface=surface, settings=settings)
    found = boundary_std_cc(breast, fit(breast, "plane"))

    def cap(angle: float) -> float:
        h = radius * (1 - np.cos(angle))
        return np.pi * h**2 * (3 * radius - h) / 3000

    wider, narrower = (cap(np.arctan2(ring + step, height)) for step in (sigma / 2, -sigma / 2))
    # The curve follows edges of 1.1 mm; the cap's second derivative adds 1 %.
    assert found == pytest.approx((wider - narrower) / 2, rel=0.1)


@pytest.mark.slow
def test_a_boundary_on_unseen_skin_jitters_with_the_distance_from_measured_skin() -> None:
    """Skin within 10 mm of the curve was repaired: by half of that the curve may lie beside itself, all around it."""
    t = 2 * np.pi * np.arange(120) / 120
    edge = np.stack([43.3 * np.cos(t), 43.3 * np.sin(t), np.full(120, 25.0)], axis=1)
    boundary = Boundary(name="left", points_world=edge, method="")
    seen = as_surface(ball(50.0, 6))
    near = np.linalg.norm(seen.mesh.vertices[:, None] - edge, axis=2).min(axis=1) < 10
    unseen = replace(seen, provenance=np.where(near, Provenance.REPAIRED, seen.provenance).astype(np.uint8))
    settings = MeasureSettings(observers=alike(3.0))
    breast = OpenBreast(boundary=boundary, surface=seen, settings=settings)
    wall = fit(breast, "plane")
    found = boundary_std_cc(replace(breast, surface=unseen), wall)
    wider = replace(settings, observers=alike(float(np.hypot(3.0, 5.0))))
    assert found == pytest.approx(boundary_std_cc(replace(breast, settings=wider), wall), rel=0.15)  # edges of 1.1 mm


def test_a_displacement_that_cannot_be_followed_is_taken_smaller_or_to_the_other_side(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """So the interval does not jump where one of seven redrawn curves meets an edge of the skin."""
    t = 2 * np.pi * np.arange(120) / 120
    edge = np.stack([43.3 * np.cos(t), 43.3 * np.sin(t), np.full(120, 25.0)], axis=1)
    boundary = Boundary(name="left", points_world=edge, method="")
    breast = OpenBreast(
        boundary=boundary, surface=as_surface(ball(50.0, 4)), settings=MeasureSettings(observers=alike(4.0))
    )
    wall = fit(breast, "plane")
    volume_cc = wall.closed.volume_mm3() / 1000
    found = []
    for farthest_mm in (np.inf, 1.5, 0.5):
        monkeypatch.setattr(
            boundary_jitter,
            "_redrawn_cc",
            lambda *given, most=farthest_mm: None if given[-1][0] > most else volume_cc + given[-1] @ np.arange(120),
        )
        found.append(boundary_std_cc(breast, wall))
    assert found[1:] == pytest.approx(found[:1] * 2)
    monkeypatch.setattr(boundary_jitter, "_redrawn_cc", lambda *_: None)
    assert boundary_std_cc(breast, wall) is None
