"""Turning a number of the measurement does what its docstring says; other tests turn the ones not named here."""

from dataclasses import replace

import numpy as np
import pytest
from solids import ball
from test_anthropometry import _breast_with_nipple
from trunks import RADIUS_MM

from mammometry.api.dates import _warnings
from mammometry.base.errors import MeasureError
from mammometry.geometry.transform import Transform
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.boundary.breasts import creased_share
from mammometry.measure.boundary.cast_base import Base
from mammometry.measure.boundary.cast_rim import AdjustedBase
from mammometry.measure.boundary.crease import Crease, follow_crease
from mammometry.measure.boundary.prominence import Prominence
from mammometry.measure.change import Change, TrunkFit, judged
from mammometry.measure.landmarks.nipple import propose_nipple
from mammometry.measure.settings import CompareSettings, LayerSettings
from mammometry.measure.trunk.skin_map import PIXEL_MM, Relief
from mammometry.measure.trunk.thorax import SkinSamples, Trunk, find_trunk, fit_thorax
from mammometry.measure.volume.measurement import layer_before_muscle_mm
from mammometry.measure.volume.sources import AXIS
from mammometry.measure.volume.uncertainty import VolumeEvidence, interval
from mammometry.measure.wall.chest_wall import ChestWall

FRAME = np.eye(3)
TRUNK = Trunk(frame=FRAME, origin=np.zeros(3), half_width_mm=RADIUS_MM)


# --- the base of a cast


def adjusted() -> AdjustedBase:
    """A plane whose height moves by 1 mm for each pixel of one camera's outline and of one stretch."""
    base = Base(origin=np.zeros(3), frame=np.eye(3), curvature_per_mm=0.0)
    moves = np.array([[0.0], [0.0], [1.0]])
    return AdjustedBase(
        base=base,
        weights=np.ones(1),
        residuals_px=np.zeros(1),
        scale_px=0.1,
        extent_mm=60.0,
        covariance=np.zeros((3, 3)),
        per_camera=moves,
        per_stretch=moves,
    )


def test_outlines_that_may_be_off_make_the_base_uncertain(monkeypatch: pytest.MonkeyPatch) -> None:
    angle = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    rim = 60 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    for silhouette_px, local_px in ((0.0, 0.0), (0.3, 0.0), (0.0, 0.4)):
        monkeypatch.setattr("mammometry.measure.boundary.cast_rim.SILHOUETTE_SIGMA_PX", silhouette_px)
        monkeypatch.setattr("mammometry.measure.boundary.cast_rim._LOCAL_SIGMA_PX", local_px)
        assert adjusted().sigma_mm(rim) == pytest.approx(silhouette_px + local_px, abs=1e-12)


# --- the trunk


def skin(theta: np.ndarray, y: np.ndarray, out_mm: np.ndarray | float = 0.0) -> np.ndarray:
    r = RADIUS_MM + out_mm
    return np.stack([r * np.sin(theta), y, r * np.cos(theta)], axis=-1)


def of_a_trunk(points: np.ndarray) -> SkinSamples:
    outwards = points * [1, 0, 1]
    return SkinSamples(points_world=points, normals_world=outwards / np.linalg.norm(outwards, axis=1, keepdims=True))


def test_only_skin_within_the_window_describes_the_trunk(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    seen = of_a_trunk(skin(rng.uniform(-1.2, 1.2, 4000), rng.uniform(-130, 130, 4000)))
    points = seen.points_world
    fit_thorax(TRUNK, seen)
    for name, limit, coordinate, beyond_mm in (("HEIGHT_WINDOW_MM", 60.0, 1, 60), ("WIDEST_DEG", 35.0, 0, 80)):
        with monkeypatch.context() as turned:
            turned.setattr(f"mammometry.measure.trunk.thorax.{name}", limit)
            with pytest.raises(MeasureError, match=r"^torso: .*\b0 .*points"):
                fit_thorax(TRUNK, seen.chosen(np.abs(points[:, coordinate]) > beyond_mm))


def test_a_rougher_chest_keeps_skin_that_stands_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """A broad ridge of 8 mm: muscle to a chest that scatters by 4 mm, no chest to one that scatters by 1 mm."""
    rng = np.random.default_rng(0)
    theta, y = rng.uniform(-1.2, 1.2, 8000), rng.uniform(-130, 130, 8000)
    seen = of_a_trunk(skin(theta, y, np.where(np.abs(theta) < 0.25, 8.0, 0.0)))
    ahead = np.zeros((1, 2))
    rough = fit_thorax(TRUNK, seen).radius_mm(ahead)
    monkeypatch.setattr("mammometry.measure.trunk.thorax.CHEST_SCALE_MM", 1.0)
    assert rough[0] > fit_thorax(TRUNK, seen).radius_mm(ahead)[0] + 1.0


def test_the_trunks_end_is_not_its_side() -> None:
    """Where the cameras look up at the trunk's lower end, half of the skin beside the breasts may be of that end."""
    rng = np.random.default_rng(0)
    side = of_a_trunk(skin(rng.uniform(-1.2, 1.2, 4000), rng.uniform(-60, 130, 4000)))
    end = skin(rng.uniform(-1.2, 1.2, 4000), np.full(4000, -60.0), rng.uniform(-60.0, 0.0, 4000))
    both = SkinSamples(
        points_world=np.concatenate([side.points_world, end]),
        normals_world=np.concatenate([side.normals_world, np.tile([0.0, -1.0, 0.0], (4000, 1))]),
    )
    found = fit_thorax(TRUNK, both)
    assert np.abs(found.bulge_mm(side.points_world)).max() < 0.5


def test_an_axis_that_leans_too_far_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    lean = Transform.from_rotation_vector(np.array([np.deg2rad(30.0), 0.0, 0.0]), np.zeros(3))
    theta, y = np.meshgrid(np.linspace(-2.0, 2.0, 200), np.linspace(-130, 130, 60))
    points = skin(theta.ravel(), y.ravel())
    normals = points * [1, 0, 1] / RADIUS_MM
    seen = SkinSamples(points_world=lean.apply(points), normals_world=lean.rotate(normals))
    assert np.allclose(find_trunk(seen, FRAME).frame[1], lean.rotate(np.array([[0.0, 1.0, 0.0]]))[0], atol=1e-6)
    monkeypatch.setattr("mammometry.measure.trunk.thorax._STEEPEST_LEAN_DEG", 20.0)
    assert np.allclose(find_trunk(seen, FRAME).frame[1], [0.0, 1.0, 0.0])


# --- the breasts of a torso

AXES = np.arange(-150.0, 150.1, PIXEL_MM)


def two_caps(top_mm: float) -> Relief:
    x, y = np.meshgrid(AXES, AXES)
    bulge = sum(top_mm * np.clip(1 - ((x - at) ** 2 + y**2) / 55.0**2, 0, None) ** 2 for at in (-70.0, 70.0))
    return Relief(
        low=np.array([-150.0, -150.0]),
        bulge_mm=np.asarray(bulge),
        known=np.ones(x.shape, dtype=bool),
        arm=np.zeros(x.shape, dtype=bool),
    )


def test_a_breast_must_stand_out() -> None:
    for top_mm, verdict in ((20.0, "breast"), (7.0, "none")):
        assert Prominence(top_mm=top_mm, volume_cc=100.0, area_cm2=95.0, creased=1.0).verdict() == verdict


def test_what_is_low_needs_more_of_a_crease() -> None:
    """16 mm lie half-way between 8 and 24 mm: the share asked for is the mean of .4 and .9."""
    low = Prominence(top_mm=16.0, volume_cc=100.0, area_cm2=95.0, creased=0.66)
    assert low.verdict() == "breast"
    assert replace(low, creased=0.64).verdict() == "unclear"
    flat = replace(low, volume_cc=50.0)  # on average 5.3 mm high: the chest's own form
    assert flat.verdict() == "unclear"
    assert flat.verdict(offset_mm=200.0) == "none"


def test_a_boundary_lies_within_a_breasts_reach(monkeypatch: pytest.MonkeyPatch) -> None:
    middle = np.array([70.0, 0.0])
    for reach_mm in (140.0, 35.0):
        monkeypatch.setattr("mammometry.measure.boundary.crease.FARTHEST_BORDER_MM", reach_mm)
        found = follow_crease(two_caps(40.0), middle)
        farthest_mm = np.linalg.norm(found.flat - middle, axis=1).max()
        assert (farthest_mm > 45.0) == (reach_mm > 45.0)


def test_too_little_of_a_crease_is_no_boundary() -> None:
    half = Crease(
        flat=np.zeros((144, 2)), concavity_per_mm=np.repeat([0.0, 0.1], 72), seen=np.ones(144, dtype=bool),
        sigma_mm=np.zeros(144),
    )  # fmt: skip
    assert creased_share(half, "left") == 0.5
    third = replace(half, concavity_per_mm=np.repeat([0.0, 0.1], [96, 48]))
    with pytest.raises(MeasureError, match=r"breast: .*33 %.*40 %"):
        creased_share(third, "left")


# --- landmarks


@pytest.mark.parametrize(
    ("tip_mm", "red", "sigma_mm", "probability"), [(5.0, 0.15, 2.5, 0.98), (0.0, 0.15, 4.0, 0.9), (5.0, 0.0, 4.0, 0.6)]
)
def test_each_way_to_find_a_nipple_has_its_own_uncertainty(
    tip_mm: float, red: float, sigma_mm: float, probability: float
) -> None:
    mesh, colours, boundary, _ = _breast_with_nipple(tip_mm, red)
    found = propose_nipple("nipple_left", mesh, colours, boundary)
    assert found is not None
    assert (found.sigma_mm, found.probability) == (sigma_mm, probability)


@pytest.mark.parametrize(
    ("name", "limit", "how"),
    [
        ("_LEAST_TIP_MM", 1.2, "and the tip within"),
        ("_AREOLA_CONTRAST", 1.0, "no areola"),
        ("_LEAST_TIP_MM", 20.0, "no tip stands out"),
        ("_MARGIN_MM", 64.0, None),
    ],
)
def test_what_counts_as_areola_and_tip(
    name: str, limit: float, how: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(f"mammometry.measure.landmarks.nipple.{name}", limit)
    mesh, colours, boundary, _ = _breast_with_nipple(5.0, 0.15)
    found = propose_nipple("nipple_left", mesh, colours, boundary)
    assert (found is None) if how is None else (found is not None and how in found.method)


# --- the interval


def test_a_measured_wall_is_known_as_well_as_is_stated() -> None:
    mesh = ball(50.0, 3)
    boundary = Boundary(name="left", points_world=mesh.vertices[:4], method="")
    wall = ChestWall(kind="measured", definition="", mesh=mesh, skin=mesh, closed=mesh)
    found = interval(boundary, wall, 400.0)
    assert found.terms_cc["chest wall"] == pytest.approx(1.0 * mesh.area_mm2() / 1000)


def test_an_assumed_axis_is_known_as_well_as_is_stated() -> None:
    mesh = ball(50.0, 3)
    boundary = Boundary(name="left", points_world=mesh.vertices[:4], method="")
    wall = ChestWall(kind="cylinder-membrane", definition="", mesh=mesh, skin=mesh, closed=mesh)
    found = interval(boundary, wall, 400.0, evidence=VolumeEvidence(axis_assumed=True))
    assert found.terms_cc[AXIS] == pytest.approx(10.0)


def test_thicknesses_are_taken_as_is_stated() -> None:
    """Two of four quadrants, each 2 mm over real women's mean: the layer is 17.5 + 2 mm, and what it exceeds by."""
    two = LayerSettings(right_lateral_mm=26.0, right_upper_mm=20.0)
    three = LayerSettings(right_lateral_mm=26.0, right_upper_mm=20.0, right_medial_mm=14.0)
    assert layer_before_muscle_mm("right", two) == pytest.approx((20.1, 34.0**0.5, 2))
    assert layer_before_muscle_mm("right", three) == pytest.approx((20.1, 27.25**0.5, 3))
    assert layer_before_muscle_mm("right", replace(two, right_upper_mm=0.0)) == (17.8, 12.0, 0)


# --- two dates


def a_fit(within_mm: float, turned_deg: float = 0.0) -> TrunkFit:
    return TrunkFit(
        before_from_after=Transform.identity(), scatter_mm=0.2, within_mm=within_mm, weakest_mm=0.1,
        turned_deg=turned_deg,
    )  # fmt: skip


def test_limits_of_two_dates() -> None:
    settings = CompareSettings(doubt_mm=2.0, refuse_mm=5.0)
    assert judged(a_fit(0.7, 3.9), settings) == ("same pose", False)
    assert judged(a_fit(0.9, 3.9), settings) == ("across poses", False)
    assert judged(a_fit(0.7, 4.1), settings) == ("across poses", False)
    assert judged(a_fit(2.1), settings) == ("across poses", True)
    with pytest.raises(MeasureError, match=r"dates: .*5\.1 mm.*\b5 mm"):
        judged(a_fit(5.1), settings)


def test_a_trunk_that_leans_otherwise_is_warned_of() -> None:
    change = Change(
        fit=a_fit(0.5, 16.0), doubtful=False, pairing="across poses", breasts=(), lengths=(),
        after_mm=np.zeros(0),
    )  # fmt: skip
    assert list(_warnings(replace(change, fit=a_fit(0.5, 14.0)))) == []
    (warning,) = _warnings(change)
    assert (warning.code, warning.values) == ("trunks-lean-differently", {"turned_deg": 16.0})
