"""The base of a cast, found among outliers and adjusted to silhouettes."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mammometry.base.errors import MeasureError
from mammometry.measure.boundary.cast_base import Base, base_through, fit_base, frame_towards, sectors_held

TILTED = Rotation.from_rotvec([0.25, -0.15, 0.6]).as_matrix()
PLACE = np.array([30.0, -20.0, 500.0])


def a_base(curvature_per_mm: float) -> Base:
    return Base(origin=PLACE, frame=TILTED, curvature_per_mm=curvature_per_mm)


def rim_on(base: Base, n: int = 720) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    radius = 60 + 8 * np.cos(2 * angle + 0.3)
    return base.lift(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1))


def cast_over(base: Base, rng: np.random.Generator) -> np.ndarray:
    """Points of a dome over the base."""
    flat = rng.uniform(-60, 60, (4000, 2))
    flat = flat[np.linalg.norm(flat, axis=1) < 58]
    return base.lift(flat) + base.frame[2] * (50 * np.sqrt(1 - (np.linalg.norm(flat, axis=1) / 60) ** 2))[:, None]


def with_limbs(rim: np.ndarray, base: Base, share: float, noise_mm: float, rng: np.random.Generator) -> np.ndarray:
    """The rim with noise; whole stretches of it raised by 3 to 35 mm, as where an occluding limb was seen instead."""
    seen = np.concatenate([rim, rim])
    seen = seen + rng.normal(0, noise_mm, seen.shape)
    angle = np.arange(len(seen)) % len(rim) / len(rim)
    limb = np.concatenate([(angle[: len(rim)] + 0.1) % 1 < share, (angle[len(rim) :] + 0.6) % 1 < share])
    raised = base.frame[2] * rng.uniform(3, 35, (len(seen), 1))
    return np.where(limb[:, None], seen * 1.0 + raised, seen)


def test_height_is_the_distance_from_a_plane_and_from_a_cylinder() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-80, 80, (500, 3)) + PLACE
    flat, bent = a_base(0.0), a_base(1 / 230)
    s, _, w = ((points - flat.origin) @ TILTED.T).T
    assert np.allclose(flat.height(points), w, atol=1e-11)
    assert np.allclose(bent.height(points), np.hypot(s, w + 230) - 230, atol=1e-9)


@pytest.mark.parametrize("curvature_per_mm", [0.0, 1e-9, 1 / 230, 1 / 61])
def test_unrolling_keeps_lengths_and_has_an_inverse(curvature_per_mm: float) -> None:
    base = a_base(curvature_per_mm)
    flat = np.random.default_rng(1).uniform(-60, 60, (300, 2))
    lifted = base.lift(flat)
    assert np.abs(base.height(lifted)).max() < 1e-9
    assert np.allclose(base.flatten(lifted), flat, atol=1e-6)
    along = base.lift(np.stack([np.linspace(-50, 50, 2001), np.full(2001, 7.0)], axis=1))
    assert np.linalg.norm(np.diff(along, axis=0), axis=1).sum() == pytest.approx(100.0, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.15, 0.4])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_tilted_plane_is_found_among_limbs(share: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    base = a_base(0.0)
    rim = rim_on(base)
    found = fit_base(with_limbs(rim, base, share, 0.15, rng), cast_over(base, rng), TILTED[2] + [0.2, 0.1, 0.0])
    heights = found.plane.height(rim)
    assert abs(heights.mean()) < 0.05  # .05 mm over 120 cm² are .6 cc
    assert heights.std() < 0.15


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.15, 0.35])
@pytest.mark.parametrize("radius_mm", [150.0, 230.0])
def test_a_curved_base_is_found_among_limbs(share: float, radius_mm: float) -> None:
    rng = np.random.default_rng(5)
    base = a_base(1 / radius_mm)
    rim = rim_on(base)
    found = fit_base(with_limbs(rim, base, share, 0.15, rng), cast_over(base, rng), TILTED[2])
    assert abs(found.cylinder.height(rim).mean()) < 0.1
    assert found.cylinder.height(rim).std() < 0.25
    assert 1 / found.cylinder.curvature_per_mm == pytest.approx(radius_mm, rel=0.1)
    assert found.plane_cost > 1.3 * found.cylinder_cost


@pytest.mark.slow
def test_the_same_photographs_give_the_same_base() -> None:
    rng = np.random.default_rng(3)
    base = a_base(1 / 230)
    seen, cast = with_limbs(rim_on(base), base, 0.3, 0.2, rng), cast_over(base, rng)
    one, two = (fit_base(seen, cast, TILTED[2]) for _ in range(2))
    assert np.array_equal(one.cylinder.origin, two.cylinder.origin)


def test_too_few_candidates_are_no_rim() -> None:
    base = a_base(0.0)
    rng = np.random.default_rng(0)
    with pytest.raises(MeasureError, match=r"model: .*\b10 .*36 of 72"):
        fit_base(rim_on(base)[:10], cast_over(base, rng), TILTED[2])


def test_candidates_on_one_line_are_no_rim() -> None:
    rng = np.random.default_rng(0)
    line = np.linspace(0, 50, 100)[:, None] * [1.0, 0, 0] + PLACE
    with pytest.raises(MeasureError, match=r"model: .*line"):
        fit_base(line, cast_over(a_base(0.0), rng), TILTED[2])


@pytest.mark.slow
@pytest.mark.parametrize("curvature_per_mm", [0.0, 1 / 230, 1 / 100])
def test_a_curve_on_a_base_gives_that_base_again(curvature_per_mm: float) -> None:
    base = a_base(curvature_per_mm)
    again = base_through(rim_on(base), TILTED[2])
    assert again.is_plane == (curvature_per_mm == 0)
    probe = np.random.default_rng(2).uniform(-50, 50, (200, 3)) + base.origin
    assert np.abs(again.height(probe) - base.height(probe)).max() < 1e-3
    assert np.abs(again.height(rim_on(base))).max() < 1e-6


@pytest.mark.slow
def test_a_kind_can_be_demanded() -> None:
    rim = rim_on(a_base(1 / 230))
    assert base_through(rim, TILTED[2], kind="plane").is_plane
    assert not base_through(rim, TILTED[2], kind="convex-cylinder").is_plane


def test_sectors_are_counted_around_the_casts_middle() -> None:
    """A third of a rim lies in a third of the directions, though its own middle has it all around."""
    base = a_base(0.0)
    rim = rim_on(base)
    assert sectors_held(rim, PLACE, base) == 72
    assert sectors_held(rim[:240], PLACE, base) in (24, 25)  # where the directions begin is arbitrary
    assert sectors_held(rim[:0], PLACE, base) == 0


def test_frames_are_right_handed() -> None:
    for direction in np.random.default_rng(0).normal(size=(20, 3)):
        frame = frame_towards(direction)
        assert np.allclose(frame @ frame.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(frame) == pytest.approx(1.0)
        assert frame[2] @ direction == pytest.approx(np.linalg.norm(direction))
