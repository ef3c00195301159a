"""The crease around a breast: on reliefs whose edge is known in closed form; all paths against trying them all."""

from itertools import product

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from solids import as_surface
from trunks import LEFT, LENGTH_MM, RADIUS_MM, RIGHT, radius_mm, trunk_mesh

from mammometry.base.errors import MeasureError
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.nearest import closest_on_mesh
from mammometry.measure.boundary.breasts import _check_base, find_breasts
from mammometry.measure.boundary.crease import _own, follow_crease, weigh_paths
from mammometry.measure.trunk.skin_map import PIXEL_MM, Relief, dense_samples
from mammometry.measure.trunk.thorax import Trunk

EVERY_WAY = np.array(list(product(range(4), repeat=5)))
LOW = np.array([-150.0, -150.0])
AXES = np.arange(-150.0, 150.1, PIXEL_MM)


def relief_of(bulge_mm: np.ndarray, known: np.ndarray | None = None, arm: np.ndarray | None = None) -> Relief:
    known = np.ones(bulge_mm.shape, dtype=bool) if known is None else known
    return Relief(low=LOW, bulge_mm=bulge_mm, known=known, arm=np.zeros_like(known) if arm is None else arm)


def cap(reach_mm: float, top_mm: float, stretch: float = 1.0) -> np.ndarray:
    """The smooth cap top (1 − ρ²)² on a flat chest, zero with its slope at its elliptic edge."""
    x, y = np.meshgrid(AXES, AXES)
    return np.asarray(top_mm * np.clip(1 - (x**2 + (y / stretch) ** 2) / reach_mm**2, 0, None) ** 2)


@pytest.mark.parametrize(("reach", "top", "stretch"), [(60.0, 45.0, 1.0), (55.0, 30.0, 1.35), (80.0, 90.0, 1.0)])
def test_the_curve_runs_where_curved_skin_joins_straight_skin(reach: float, top: float, stretch: float) -> None:
    found = follow_crease(relief_of(cap(reach, top, stretch)), np.array([6.0, -4.0]))
    radius = np.hypot(found.flat[:, 0], found.flat[:, 1])
    edge = radius / (np.hypot(found.flat[:, 0], found.flat[:, 1] / stretch) / reach)
    # A pixel; the cap's own curvature falls off inwards, which draws the half value in by a part of the 4 mm.
    assert np.abs(radius - edge).max() < 3.0
    assert np.abs(np.median(radius - edge)) < 2.0
    assert (found.concavity_per_mm > 0.01).all()
    assert found.seen.all()


@pytest.mark.slow
def test_the_curve_moves_as_little_as_the_edge_does() -> None:
    """A sawtooth of half a millimetre was on it where the path was rounded to whole steps."""
    caps = [cap(60.0 + moved_mm, 45.0) for moved_mm in (0.0, 0.1, 0.2, 0.3, 0.4)]
    away = np.array([np.linalg.norm(follow_crease(relief_of(bulge), np.zeros(2)).flat, axis=1) for bulge in caps])
    assert np.abs(np.diff(away, axis=0) - 0.1).max() < 0.1


def test_directions_that_allow_nothing_in_common_still_have_a_path() -> None:
    """Neither way around reached where the other did: 0 / 0, and a lying woman's breast ended in an error of ours."""
    log_weights = np.full((1, 144, 139), -100.0)
    log_weights[:, :72, 5:9] = 0.0
    log_weights[:, 72:, 100:104] = 0.0
    found = weigh_paths(log_weights, 0.2)
    assert 4.0 < found.mean_steps[0, 36] < 9.0
    assert 99.0 < found.mean_steps[0, 108] < 104.0
    assert np.isfinite(found.spread_steps).all()
    assert np.isfinite(found.evidence).all()


def test_a_border_ends_before_an_arm_where_a_muscle_leads_on_to_it() -> None:
    """On a muscular body breast, muscle and arm are one slope; the map is filled behind the arm, and falls there."""
    x, y = np.meshgrid(AXES, AXES)
    along, aside = (x + y) / np.sqrt(2), (x - y) / np.sqrt(2)
    muscle = np.where(along > 0, 34.0 * np.exp(-((aside / 50) ** 2)), 0.0)
    arm = (along > 75) & (np.abs(aside) < 70)
    bulge = np.where(along < 95, np.maximum(cap(75.0, 35.0), muscle), 0.0)
    found = follow_crease(relief_of(bulge, ~arm, arm), np.zeros(2))
    outwards = (found.flat @ [1, 1]) / np.sqrt(2)
    assert 60.0 < outwards.max() < 75.0 + 2 * PIXEL_MM
    over = follow_crease(relief_of(bulge, ~arm), np.zeros(2))
    assert ((over.flat @ [1, 1]) / np.sqrt(2)).max() > 90.0  # as if nothing stood there
    assert found.sigma_mm.max() < over.sigma_mm.max()


def test_an_arm_before_skin_that_is_seen_again_ends_no_border() -> None:
    """A large breast's own flank may pass for the arm that it touches; the trunk behind shows that it goes on."""
    x, y = np.meshgrid(AXES, AXES)
    flank = (x > 40) & (x < 58) & (y > -30)
    found = follow_crease(relief_of(cap(80.0, 70.0), ~flank, flank), np.zeros(2))
    assert np.abs(np.linalg.norm(found.flat, axis=1) - 80.0).max() < 6.0  # three pixels; 40 off without it


def test_a_step_is_followed_as_a_fold_is() -> None:
    """A breast that hangs over its fold is a step of the innermost layer there."""
    bulge = np.where(AXES[:, None] > -40, cap(70.0, 60.0), 0.0)
    found = follow_crease(relief_of(bulge), np.zeros(2))
    below = (np.abs(found.flat[:, 0]) < 35) & (found.flat[:, 1] < 0)
    # Smoothed over 4 mm, the step's concavity is deepest 4 mm outside it, half as deep 8 mm outside. That is taken off.
    assert np.all(found.flat[below, 1] < -38)
    assert np.all(found.flat[below, 1] > -43)


@pytest.mark.parametrize("slope", [0.6, 1.5])
def test_a_crease_is_followed_where_it_is(slope: float) -> None:
    """A cone on a flat chest: smoothed over 4 mm its concavity is half as deep 4.7 mm outside."""
    x, y = np.meshgrid(AXES, AXES)
    found = follow_crease(relief_of(np.clip(60.0 - np.hypot(x, y), 0, None) * slope), np.zeros(2))
    assert np.abs(np.linalg.norm(found.flat, axis=1) - 60).max() < 2.0


def test_skin_beyond_the_trunks_end_is_no_place_for_an_edge() -> None:
    """30 mm below the breast the trunk ends: a fall of 60 mm, whose foot is a deeper crease than the breast's."""
    bulge = np.where(AXES[:, None] < -90, -60.0, cap(60.0, 45.0))
    found = follow_crease(relief_of(bulge), np.zeros(2))
    assert np.abs(np.linalg.norm(found.flat, axis=1) - 60).max() < 5


def test_where_nothing_is_seen_the_neighbours_decide() -> None:
    x, y = np.meshgrid(AXES, AXES)
    hidden = (np.abs(np.arctan2(y, x)) < 0.5) & (np.hypot(x, y) > 30)
    bulge = np.where(hidden, gaussian_filter(cap(60.0, 45.0), 8), cap(60.0, 45.0))
    found = follow_crease(relief_of(bulge, ~hidden), np.zeros(2))
    assert not found.seen.all()
    assert np.abs(np.linalg.norm(found.flat, axis=1) - 60).max() < 8


@pytest.mark.parametrize(
    ("fall", "rise", "expected"),
    [(0.0, 50.0, 1 / 51), (50.0, 0.0, 1.0), (40.0, 40.0, 1.0), (10.0, 43.0, 0.25), (0.0, 0.5, 1 / 1.5)],
)
def test_a_crease_is_the_breasts_own_as_far_as_skin_falls_to_it(fall: float, rise: float, expected: float) -> None:
    """A valley 8 mm from where both its sides end: the smaller fall, with 1 mm of grace, over the greater rise."""
    profile = np.concatenate(
        [np.full(12, fall), np.linspace(fall, 0, 9), np.linspace(0, rise, 9)[1:], np.full(12, rise)]
    )
    assert _own(profile[None])[0, 20] == pytest.approx(expected)


@pytest.mark.parametrize("gap_mm", [20.0, 30.0])
def test_the_foot_of_a_cliff_beyond_the_breast_is_not_its_edge(gap_mm: float) -> None:
    """Below the trunk's seen end only the breasts hang: the relief jumps up by all their height, a deeper crease."""
    bulge = np.where(AXES[:, None] < -60 - gap_mm, 90.0, cap(60.0, 45.0))
    found = follow_crease(relief_of(bulge), np.zeros(2))
    assert np.abs(np.linalg.norm(found.flat, axis=1) - 60).max() < 5


def test_a_neighbouring_ridge_is_not_taken_for_the_edge() -> None:
    """An arm that rises beyond the breast has a crease of its own, deeper than the breast's."""
    x, _ = np.meshgrid(AXES, AXES)
    arm = np.clip(x - 85, 0, None) * 1.5
    found = follow_crease(relief_of(cap(60.0, 30.0) + arm), np.zeros(2))
    assert np.linalg.norm(found.flat, axis=1).max() < 70


@pytest.mark.parametrize("stiffness", [0.05, 0.6])
def test_paths_are_weighed_as_all_of_them_are_together(stiffness: float) -> None:
    """Against all 4⁵ closed ways. Two turns know nearly where a path that closes lies."""
    tables = np.random.default_rng(4).uniform(-2, 2, (2, 5, 4))
    tables[0, 2] += np.array([0.0, 8.0, 0.0, 0.0])  # sharp
    moves = np.diff(np.concatenate([EVERY_WAY, EVERY_WAY[:, :1]], axis=1), axis=1)
    found = weigh_paths(tables, stiffness)
    for number, table in enumerate(tables):
        log = table[np.arange(5), EVERY_WAY].sum(axis=1) - stiffness * (moves**2).sum(axis=1)
        share = np.exp(log) / np.exp(log).sum()
        spread = np.sqrt(np.maximum(share @ EVERY_WAY**2 - (share @ EVERY_WAY) ** 2, 0))
        np.testing.assert_allclose(found.mean_steps[number], share @ EVERY_WAY, atol=0.08)
        np.testing.assert_allclose(found.spread_steps[number], spread, atol=0.08)
        assert found.evidence[number] == pytest.approx(np.log(np.exp(log).sum()), abs=0.1)
    assert np.argmin(found.spread_steps[0]) == 2


@pytest.mark.slow
def test_a_border_moves_little_where_the_skin_changes_little() -> None:
    """Noise of 1 mm, a millimetre wide: about what two scans of one body differ by."""
    rng = np.random.default_rng(2)
    skin = cap(60.0, 30.0, 1.2)
    curves = [
        follow_crease(relief_of(skin + gaussian_filter(rng.normal(0, 2, skin.shape), 1)), np.zeros(2)) for _ in "ab"
    ]
    apart = np.linalg.norm(curves[0].flat - curves[1].flat, axis=1)
    assert apart.mean() < np.mean(curves[0].sigma_mm)


def test_where_nothing_shows_the_border_it_runs_as_real_womens_do_and_says_that_it_is_unsure() -> None:
    """A breast whose upper pole runs out with the slope of the chest above it: no place of it is an edge."""
    x, y = np.meshgrid(AXES, AXES)
    below = np.clip(40.0 - 0.3 * np.maximum(y, 0.0), 5.0, None)
    pole = np.where(np.abs(x) < 60, below * np.clip(1 - (x / 60.0) ** 2, 0, None) ** 2, 0.0)
    bulge = np.where(y > -60, np.where(y > 0, pole, cap(60.0, 40.0)), 0.0)
    found = follow_crease(relief_of(bulge), np.zeros(2), base_mm=125.0)
    assert found.flat[:, 1].max() < 125  # real women's: .67 of the root of 156 cm² above the middle, 84 mm
    assert found.flat[:, 1].min() == pytest.approx(-60, abs=4)
    top, bottom = np.argmax(found.flat[:, 1]), np.argmin(found.flat[:, 1])
    assert found.sigma_mm[top] > 1.5 * found.sigma_mm[bottom]


@pytest.mark.slow
def test_a_border_that_runs_over_the_breast_says_how_far_the_breast_goes_on() -> None:
    """It may end no further than 25 mm from the top, and falls to a third of its height 52 mm from it."""
    whole = follow_crease(relief_of(cap(80.0, 90.0)), np.zeros(2))
    cut = follow_crease(relief_of(cap(80.0, 90.0)), np.zeros(2), between_mm=(-np.inf, 25.0))
    assert whole.sigma_mm.max() < 8
    assert cut.sigma_mm[0] > 15
    assert cut.sigma_mm[len(cut.sigma_mm) // 2] < 8
    touching = np.maximum(cap(80.0, 90.0), np.roll(cap(80.0, 90.0), 60, axis=1))  # 120 mm beside it: a valley between
    valley = follow_crease(relief_of(touching), np.zeros(2), between_mm=(-np.inf, 62.0))
    assert valley.sigma_mm[0] < 8


@pytest.mark.slow
def test_a_border_beside_the_end_of_the_trunk_may_lie_beyond_it() -> None:
    """A breast reaches 110 mm aside. 74 mm are known, and closing turned the last 12 mm back behind the trunk."""
    x, _ = np.meshgrid(AXES, AXES)
    breast = cap(110.0, 30.0)
    ended = follow_crease(relief_of(np.where(x > 62, breast - 4 * (x - 62), breast), x < 74), np.zeros(2), base_mm=95.0)
    assert ended.flat[0, 0] < 74
    assert ended.flat[0, 0] + 2 * ended.sigma_mm[0] > 110
    assert ended.sigma_mm[len(ended.sigma_mm) // 2] < 12
    slit = follow_crease(relief_of(cap(80.0, 45.0), (x < 82) | (x > 94)), np.zeros(2))
    assert slit.sigma_mm[0] < 12  # the trunk is seen again behind it


def test_a_border_stays_on_its_own_side() -> None:
    found = follow_crease(relief_of(cap(60.0, 45.0)), np.array([5.0, 0.0]), between_mm=(-40.0, np.inf))
    assert found.flat[:, 0].min() > -45


def test_samples_lie_on_the_faces_and_close_together() -> None:
    corners = np.array([[0.0, 0, 0], [30, 0, 0], [0, 20, 5], [31, 22, 0]])
    mesh = TriangleMesh(vertices=corners, faces=np.array([[0, 1, 2], [1, 3, 2]], dtype=np.int32))
    points = dense_samples(mesh)
    assert closest_on_mesh(points, mesh).distances_mm.max() < 1e-9
    somewhere = np.random.default_rng(0).dirichlet(np.ones(3), 500)
    inside = np.concatenate([somewhere @ corners[[0, 1, 2]], somewhere @ corners[[1, 3, 2]]])
    away = np.linalg.norm(inside[:, None] - points[None], axis=2).min(axis=1)
    assert away.max() < 1.5


@pytest.mark.slow
def test_a_mound_without_a_crease_is_refused() -> None:
    """A Gaussian hill turns into the chest nowhere more than 2 h e⁻² / σ² = 0.003 per mm."""
    mesh = trunk_mesh(4.0)
    x, y, z = mesh.vertices.T
    theta, r = np.arctan2(x, z), np.hypot(x, z)
    hills = sum(
        14 * np.exp(-((RADIUS_MM * (theta - angle)) ** 2 + (y - height) ** 2) / (2 * 36.0**2))
        for angle, height, _, _ in (LEFT, RIGHT)
    )
    side = (np.abs(y) < LENGTH_MM / 2 - 1e-9) & (r > 1)
    scale = np.where(side, (RADIUS_MM + hills) / np.where(side, radius_mm(theta, y), 1), 1)
    gentle = np.stack([x * scale, y, z * scale], axis=1)
    surface = as_surface(TriangleMesh(vertices=gentle, faces=mesh.faces), gentle[:, 2] > -40)
    with pytest.raises(MeasureError, match=r"breast: .*\d+ %.*mammometry edit"):
        find_breasts(surface, np.eye(3))


@pytest.mark.slow
def test_a_frame_that_looks_aside_is_turned_straight() -> None:
    """The boundaries are the same, whichever way ahead was said to be."""
    mesh = trunk_mesh(4.0)
    surface = as_surface(mesh, mesh.vertices[:, 2] > -0.35 * RADIUS_MM)
    straight = find_breasts(surface, np.eye(3))
    turn = Trunk(frame=np.eye(3), origin=np.zeros(3), half_width_mm=125.0).facing(np.deg2rad(12.0))
    assert np.allclose(turn @ turn.T, np.eye(3))
    assert turn[2, 0] == pytest.approx(np.sin(np.deg2rad(12.0)))
    aside = find_breasts(surface, turn)
    for name in ("left", "right"):
        one, other = getattr(straight, name).points_world, getattr(aside, name).points_world
        away = np.linalg.norm(one[:, None] - other[None], axis=2).min(axis=1)
        assert away.max() < 4.0
        assert getattr(aside, name).creased > 0.9
        assert getattr(aside, name).folded < 0.1  # a cap has no fold


@pytest.mark.parametrize(
    ("across_mm", "up_mm", "folds", "refused"),
    [
        (100, 100, 0, False),
        (110, 110, 0, True),
        (60, 128, 0, False),
        (60, 133, 0, True),
        (148, 70, 0, True),
        (70, 70, 8, True),
    ],
)
def test_a_base_that_no_breast_has_is_refused(across_mm: float, up_mm: float, folds: int, refused: bool) -> None:
    """Half axes of an ellipse: 314, 380, 241 cm² and 256, 266 and 140 mm high; 296 mm wide; ragged."""
    turn = np.linspace(0, 2 * np.pi, 144, endpoint=False)
    ragged = 1 + (0.25 * np.cos(folds * turn) if folds else 0.0)
    flat = np.stack([across_mm * np.cos(turn), up_mm * np.sin(turn)], axis=1) * np.reshape(ragged, (-1, 1))
    trunk = Trunk(frame=np.eye(3), origin=np.zeros(3), half_width_mm=150.0)
    if refused:
        with pytest.raises(MeasureError, match=r"breast: .*350 cm², .*50 %"):
            _check_base(flat, "left", trunk)
    else:
        _check_base(flat, "left", trunk)
