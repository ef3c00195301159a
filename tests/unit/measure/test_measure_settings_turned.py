"""Turning a setting of the measurement does what its docstring says; other tests turn the ones not named here."""

from dataclasses import replace

import numpy as np
import pytest
from solids import as_surface, ball, dome, given_surface, rig_around
from test_anthropometry import _breast_with_nipple
from trunks import RADIUS_MM

from mammometry.api.dates import _warnings
from mammometry.base.errors import MeasureError
from mammometry.geometry.transform import Transform
from mammometry.job.graph import Plan
from mammometry.job.inputs import Inputs
from mammometry.job.stages.measure import boundaries
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.boundary.breasts import creased_share
from mammometry.measure.boundary.cast_base import Base, fit_base
from mammometry.measure.boundary.cast_base_adjust import AdjustedBase
from mammometry.measure.boundary.crease import Crease, follow_crease
from mammometry.measure.boundary.standing import Standing
from mammometry.measure.dates.change import Change, judged
from mammometry.measure.dates.trunk_fit import TrunkFit
from mammometry.measure.landmarks.landmarks import Landmark
from mammometry.measure.landmarks.nipples import propose_nipple
from mammometry.measure.settings import (
    BaseRimSettings,
    BreastSettings,
    CompareSettings,
    LayerSettings,
    MeasureSettings,
    NippleSettings,
    ThoraxSettings,
)
from mammometry.measure.shape.anthropometry import find_landmarks
from mammometry.measure.trunk.skin_map import PIXEL_MM, Relief
from mammometry.measure.trunk.thorax import Skin, Trunk, find_trunk, fit_thorax
from mammometry.measure.volume.definitions import layer_before_muscle_mm
from mammometry.measure.volume.uncertainty import AXIS, Evidence, interval
from mammometry.measure.wall.chest_wall import ChestWall
from mammometry.settings import Settings

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


def test_outlines_that_may_be_off_make_the_base_uncertain() -> None:
    angle = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    rim = 60 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    exact = BaseRimSettings(silhouette_sigma_px=0.0, local_sigma_px=0.0)
    assert adjusted().sigma_mm(rim, exact) == pytest.approx(0.0, abs=1e-12)
    assert adjusted().sigma_mm(rim, replace(exact, silhouette_sigma_px=0.3)) == pytest.approx(0.3)
    assert adjusted().sigma_mm(rim, replace(exact, local_sigma_px=0.4)) == pytest.approx(0.4)


@pytest.mark.slow
def test_the_seed_chooses_the_samples_in_which_the_base_is_searched() -> None:
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, 2 * np.pi, 200)
    rim = 60 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1) + rng.normal(0, 0.3, (200, 3))
    cap = rng.uniform(-40, 40, (500, 3)) * [1, 1, 0] + [0, 0, 40.0]

    def origin(seed: int) -> np.ndarray:
        return fit_base(rim, cap, np.array([0.0, 0.0, 1.0]), BaseRimSettings(seed=seed)).cylinder.origin

    assert not np.array_equal(origin(1), origin(2))


# --- the trunk


def skin(theta: np.ndarray, y: np.ndarray, out_mm: np.ndarray | float = 0.0) -> np.ndarray:
    r = RADIUS_MM + out_mm
    return np.stack([r * np.sin(theta), y, r * np.cos(theta)], axis=-1)


def of_a_trunk(points: np.ndarray) -> Skin:
    outwards = points * [1, 0, 1]
    return Skin(points_world=points, normals_world=outwards / np.linalg.norm(outwards, axis=1, keepdims=True))


def test_only_skin_within_the_window_describes_the_trunk() -> None:
    rng = np.random.default_rng(0)
    seen = of_a_trunk(skin(rng.uniform(-1.2, 1.2, 4000), rng.uniform(-130, 130, 4000)))
    points = seen.points_world
    fit_thorax(TRUNK, seen)
    with pytest.raises(MeasureError, match="points of skin around the breasts"):
        fit_thorax(TRUNK, seen.chosen(np.abs(points[:, 1]) > 60), ThoraxSettings(height_window_mm=60.0))
    with pytest.raises(MeasureError, match="points of skin around the breasts"):
        fit_thorax(TRUNK, seen.chosen(np.abs(points[:, 0]) > 80), ThoraxSettings(widest_deg=35.0))


def test_a_rougher_chest_keeps_skin_that_stands_out() -> None:
    """A broad ridge of 8 mm: muscle to a chest that scatters by 4 mm, no chest to one that scatters by 1 mm."""
    rng = np.random.default_rng(0)
    theta, y = rng.uniform(-1.2, 1.2, 8000), rng.uniform(-130, 130, 8000)
    seen = of_a_trunk(skin(theta, y, np.where(np.abs(theta) < 0.25, 8.0, 0.0)))
    ahead = np.zeros((1, 2))
    rough, smooth = (fit_thorax(TRUNK, seen, ThoraxSettings(chest_scale_mm=mm)).radius_mm(ahead) for mm in (4.0, 1.0))
    assert rough[0] > smooth[0] + 1.0


def test_the_trunks_end_is_not_its_side() -> None:
    """Where the cameras look up at the trunk's lower end, half of the skin beside the breasts may be of that end."""
    rng = np.random.default_rng(0)
    side = of_a_trunk(skin(rng.uniform(-1.2, 1.2, 4000), rng.uniform(-60, 130, 4000)))
    end = skin(rng.uniform(-1.2, 1.2, 4000), np.full(4000, -60.0), rng.uniform(-60.0, 0.0, 4000))
    both = Skin(
        points_world=np.concatenate([side.points_world, end]),
        normals_world=np.concatenate([side.normals_world, np.tile([0.0, -1.0, 0.0], (4000, 1))]),
    )
    found = fit_thorax(TRUNK, both)
    assert np.abs(found.bulge_mm(side.points_world)).max() < 0.5


def test_an_axis_that_leans_too_far_is_not_believed() -> None:
    lean = Transform.from_rotation_vector(np.array([np.deg2rad(30.0), 0.0, 0.0]), np.zeros(3))
    theta, y = np.meshgrid(np.linspace(-2.0, 2.0, 200), np.linspace(-130, 130, 60))
    points = skin(theta.ravel(), y.ravel())
    normals = points * [1, 0, 1] / RADIUS_MM
    seen = Skin(points_world=lean.apply(points), normals_world=lean.rotate(normals))
    axes = [find_trunk(seen, FRAME, ThoraxSettings(steepest_lean_deg=deg)).frame[1] for deg in (40.0, 20.0)]
    assert np.allclose(axes[0], lean.rotate(np.array([[0.0, 1.0, 0.0]]))[0], atol=1e-6)
    assert np.allclose(axes[1], [0.0, 1.0, 0.0])


# --- the breasts of a torso

AXES = np.arange(-150.0, 150.1, PIXEL_MM)


def two_caps(top_mm: float) -> Relief:
    x, y = np.meshgrid(AXES, AXES)
    bulge = sum(top_mm * np.clip(1 - ((x - at) ** 2 + y**2) / 55.0**2, 0, None) ** 2 for at in (-70.0, 70.0))
    return Relief(low=np.array([-150.0, -150.0]), bulge_mm=np.asarray(bulge), known=np.ones(x.shape, dtype=bool))


def test_a_breast_must_stand_out() -> None:
    high = Standing(top_mm=20.0, volume_cc=100.0, area_cm2=95.0, creased=1.0)
    assert high.verdict(BreastSettings(fewest_mm=12.0)) == "breast"
    assert high.verdict(BreastSettings(fewest_mm=30.0)) == "none"


def test_what_is_low_needs_more_of_a_crease() -> None:
    """18 mm lie half-way between 12 and 24 mm: the share asked for is the mean of .4 and .9."""
    settings = BreastSettings(fewest_mm=12.0, plain_mm=24.0, least_creased=0.4, low_creased=0.9, chest_mm=6.0)
    low = Standing(top_mm=18.0, volume_cc=100.0, area_cm2=95.0, creased=0.66)
    assert low.verdict(settings) == "breast"
    assert low.verdict(replace(settings, plain_mm=40.0)) == "unclear"
    assert low.verdict(replace(settings, low_creased=1.0)) == "unclear"
    assert low.verdict(replace(settings, chest_mm=11.0)) == "unclear"
    assert low.verdict(replace(settings, chest_mm=11.0), astray_mm=200.0) == "none"


def test_a_boundary_lies_within_a_breasts_reach() -> None:
    middle = np.array([70.0, 0.0])
    for reach_mm in (140.0, 35.0):
        found = follow_crease(two_caps(40.0), middle, BreastSettings(reach_mm=reach_mm))
        farthest_mm = np.linalg.norm(found.flat - middle, axis=1).max()
        assert (farthest_mm > 45.0) == (reach_mm > 45.0)


def test_too_little_of_a_crease_is_no_boundary() -> None:
    half = Crease(
        flat=np.zeros((144, 2)), concavity_per_mm=np.repeat([0.0, 0.1], 72), seen=np.ones(144, dtype=bool),
        sigma_mm=np.zeros(144),
    )  # fmt: skip
    assert creased_share(half, "left", BreastSettings(least_creased=0.5)) == 0.5
    with pytest.raises(MeasureError, match="a crease around 50 % of it, expected one around at least 60 %"):
        creased_share(half, "left", BreastSettings(least_creased=0.6))


# --- landmarks


@pytest.mark.parametrize(
    ("tip_mm", "red", "sigma", "probability"),
    [
        (5.0, 0.15, "tip_sigma_mm", "areola_tip_probability"),
        (0.0, 0.15, "areola_sigma_mm", "areola_probability"),
        (5.0, 0.0, "apex_tip_sigma_mm", "tip_probability"),
        (0.0, 0.0, "apex_sigma_mm", "apex_probability"),
    ],
)
def test_each_way_to_find_a_nipple_has_its_own_uncertainty(
    tip_mm: float, red: float, sigma: str, probability: str
) -> None:
    mesh, colours, boundary, _ = _breast_with_nipple(tip_mm, red)
    turned = replace(NippleSettings(), **{sigma: 7.25, probability: 0.75})
    found = propose_nipple("nipple_left", mesh, colours, boundary, turned)
    assert found is not None
    assert (found.sigma_mm, found.probability) == (7.25, 0.75)


@pytest.mark.parametrize(
    ("settings", "how"),
    [
        (NippleSettings(), "and the tip within"),
        (NippleSettings(areola_contrast=1.0), "no areola"),
        (NippleSettings(tip_mm=20.0), "no tip stands out"),
        (NippleSettings(margin_mm=64.0), None),
    ],
)
def test_what_counts_as_areola_and_tip(settings: NippleSettings, how: str | None) -> None:
    mesh, colours, boundary, _ = _breast_with_nipple(5.0, 0.15)
    found = propose_nipple("nipple_left", mesh, colours, boundary, settings)
    assert (found is None) if how is None else (found is not None and how in found.method)


def test_a_picked_landmark_is_known_as_well_as_the_settings_say() -> None:
    mesh = ball(50.0, 3)
    (found,) = find_landmarks(
        mesh,
        np.zeros((len(mesh.vertices), 3), dtype=np.uint8),
        (),
        {"sternal_notch": mesh.vertices[:1]},
        None,
        MeasureSettings(picked_sigma_mm=1.25),
    )
    assert isinstance(found, Landmark)
    assert found.sigma_mm == 1.25


# --- the interval


def test_a_drawn_rim_is_known_as_well_as_the_settings_say() -> None:
    mesh, rig = dome(), rig_around()
    rim = mesh.vertices[1 + 59 * 240 : 1 + 60 * 240]
    inputs = Inputs(
        rig_name="test",
        pair_names=rig.pair_names,
        subject_kind="model",
        photographs={},
        target=None,
        calibration_photographs={},
        boundaries={"model": rim},
        digests=dict.fromkeys(("subject", "boundaries", "landmarks"), "1"),
    )

    settings = Settings().overridden(["measure.drawn_rim_sigma_mm=0.75"])
    plan = Plan(inputs, settings, None, stages=("measure",), given=given_surface(as_surface(mesh), rig))
    assert [boundary.sigma_mm for boundary in plan[boundaries]()] == [0.75]


def test_a_measured_wall_is_known_as_well_as_the_settings_say() -> None:
    mesh = ball(50.0, 3)
    boundary = Boundary(name="left", points_world=mesh.vertices[:4], method="")
    wall = ChestWall(kind="measured", definition="", mesh=mesh, skin=mesh, closed=mesh)
    found = interval(boundary, wall, 400.0, MeasureSettings(wall_measured_u95_mm=2.5))
    assert found.terms_cc["chest wall"] == pytest.approx(2.5 * mesh.area_mm2() / 1000)


def test_an_assumed_axis_is_known_as_well_as_the_settings_say() -> None:
    mesh = ball(50.0, 3)
    boundary = Boundary(name="left", points_world=mesh.vertices[:4], method="")
    wall = ChestWall(kind="cylinder-membrane", definition="", mesh=mesh, skin=mesh, closed=mesh)
    found = interval(boundary, wall, 400.0, MeasureSettings(axis_u95_share=0.05), Evidence(axis_assumed=True))
    assert found.terms_cc[AXIS] == pytest.approx(20.0)


def test_thicknesses_are_taken_as_the_settings_say() -> None:
    """Two of four quadrants, each 2 mm over real women's mean: the layer is 17.5 + 2 mm, and what it exceeds by."""
    two = LayerSettings(
        right_lateral_mm=26.0, right_upper_mm=20.0, over_layer_mm=0.5, measured_u95_mm=4.0, missing_u95_mm=3.0
    )
    assert layer_before_muscle_mm("right", two) == pytest.approx((20.0, 5.0, 2))
    assert layer_before_muscle_mm("right", replace(two, right_medial_mm=14.0)) == pytest.approx((20.0, 18.25**0.5, 3))
    assert layer_before_muscle_mm("right", replace(two, fewest=3, mean_mm=17.0, u95_mm=11.0)) == (17.0, 11.0, 0)


# --- two dates


def a_fit(within_mm: float, turned_deg: float = 0.0) -> TrunkFit:
    return TrunkFit(
        before_from_after=Transform.identity(), scatter_mm=0.2, within_mm=within_mm, weakest_mm=0.1,
        turned_deg=turned_deg,
    )  # fmt: skip


def test_limits_of_two_dates() -> None:
    settings = CompareSettings(doubt_mm=2.0, refuse_mm=5.0, same_pose_mm=1.0, same_pose_deg=6.0)
    assert judged(a_fit(0.9, 5.9), settings) == ("same pose", False)
    assert judged(a_fit(1.1, 5.9), settings) == ("across poses", False)
    assert judged(a_fit(0.9, 6.1), settings) == ("across poses", False)
    assert judged(a_fit(2.1), settings) == ("across poses", True)
    with pytest.raises(MeasureError, match=r"more than 5\.1 mm apart, expected one body, within 5 mm"):
        judged(a_fit(5.1), settings)


def test_a_trunk_that_leans_otherwise_is_warned_of() -> None:
    change = Change(
        fit=a_fit(0.5, 9.0), doubtful=False, pairing="across poses", breasts=(), lengths=(),
        after_mm=np.zeros(0),
    )  # fmt: skip
    assert _warnings(change, Settings().overridden(["compare.doubt_deg=10"])) == []
    (warning,) = _warnings(change, Settings().overridden(["compare.doubt_deg=8"]))
    assert "leaned differently by 9°" in warning
