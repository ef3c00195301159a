"""The board under a subject: told from a body, with gaps in the depths, and by pairs that hardly see it."""

import numpy as np
import pytest
from ball_scene import rig
from numpy.typing import NDArray

from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform
from mammometry.matching.support import NearDepths, find_supports, parted, reciprocal_depth

CAMERA = rig().cameras["one_left"]
V, U = np.mgrid[:240, :320].astype(float)
TILTED = 1 / (1 / 800 + 1e-7 * (U - 160) + 1.5e-7 * (V - 120))


def seen(
    depth_mm: NDArray[np.float64],
    near: NDArray[np.bool_] | None = None,
    camera: Camera = CAMERA,
    textured: NDArray[np.bool_] | None = None,
) -> NearDepths:
    whole = np.ones(depth_mm.shape, dtype=bool)
    return NearDepths(
        camera=camera,
        depth_mm=depth_mm.astype(np.float32),
        near=whole if near is None else near,
        textured=whole if textured is None else textured,
    )


def hill(height_mm: float = 60.0) -> NDArray[np.float64]:
    """The tilted board with a hill before it."""
    made: NDArray[np.float64] = TILTED - height_mm * np.exp(-((np.hypot(U - 160, V - 120) / 50) ** 2))
    return made


def test_a_board_is_told_from_a_body() -> None:
    """A plane with a hill before it is a board; a ball, of which the best plane leaves most behind, is none."""
    (plane,) = find_supports([seen(hill())])
    assert plane is not None
    a, b, c = reciprocal_depth(plane, CAMERA)
    # The hill's foot, lower than 1.2 % of the depth, pulls at the plane.
    assert np.abs((a * U + b * V + c) * TILTED - 1).max() < 0.004
    away = np.hypot(U - 160, V - 120)
    depth = 800 - np.sqrt(np.where(away < 110, 110**2 - away**2, 0))
    assert find_supports([seen(depth, away < 110)]) == [None]
    assert find_supports([seen(TILTED)]) == [None]  # nothing stands before it


def test_random_matches_before_a_plane_make_it_no_support() -> None:
    """A plate before a dark background, which matches by chance at some places in front of the plate."""
    plate = (np.abs(U - 160) < 80) & (np.abs(V - 120) < 90)
    chance = (V > 220) & (U < 160)
    depth = np.where(chance, 0.9 * TILTED, TILTED)
    depth[~plate & ~chance] = np.nan
    (plane,) = find_supports([seen(depth, plate | chance)])
    assert plane is not None  # all of it would be a subject on a board
    assert find_supports([seen(depth, plate | chance, textured=plate)]) == [None]


@pytest.mark.requirement("R-MASK-1")
def test_gaps_in_the_depths_are_not_behind_the_board() -> None:
    """A tenth of what is near has no depth, as in a weakly textured picture: the hill takes less."""
    depth = hill()
    depth[np.random.default_rng(1).random(depth.shape) < 0.1] = np.nan
    (plane,) = find_supports([seen(depth)])
    assert plane is not None
    standing, lying = parted(
        depth.astype(np.float32), np.ones(depth.shape, dtype=bool), reciprocal_depth(plane, CAMERA)
    )
    assert standing[120, 160] or np.isnan(depth[120, 160])
    assert lying.sum() > 0.7 * depth.size


@pytest.mark.requirement("R-MASK-1")
def test_a_board_that_one_pair_sees_clearly_is_the_support_of_all() -> None:
    """From the side the hill fills most of what is near, and no plane holds half of it."""
    turn = Transform.from_rotation_vector(np.array([0.0, 0.9, 0.0]), np.array([620.0, 0.0, 300.0]))
    side = Camera(
        name="side",
        size_wh=CAMERA.size_wh,
        matrix=CAMERA.matrix,
        distortion=CAMERA.distortion,
        camera_from_world=turn @ CAMERA.camera_from_world,
    )
    alone = np.hypot(U - 160, V - 120) < 60
    body = 800 - np.sqrt(np.where(alone, 200**2 - (2 * np.hypot(U - 160, V - 120)) ** 2, 0))
    assert find_supports([seen(body, alone, side)]) == [None]
    front, shared = find_supports([seen(hill()), seen(body, alone, side)])
    assert front is not None
    assert shared is not None
    assert np.array_equal(front, shared)


@pytest.mark.slow
@pytest.mark.requirement("R-MASK-1")
def test_one_pair_that_mistakes_a_repeating_pattern_is_outvoted() -> None:
    """A part of the board, larger than the small hill, is matched a square too far behind it."""
    small = TILTED - 60 * np.exp(-((np.hypot(U - 160, V - 120) / 20) ** 2))
    mistaken = np.where((U > 220) & (U < 300) & (V > 140) & (V < 220), 1.03 * small, small)
    alone = find_supports([seen(mistaken)])
    assert alone == [None]
    assert all(plane is not None for plane in find_supports([seen(small), seen(small), seen(mistaken)]))


def test_a_plane_is_the_same_in_every_picture() -> None:
    """Points of a world plane have the reciprocal depths that both cameras of a pair are given."""
    plane = np.array([0.2, -0.1, 1.0, 40.0])
    rng = np.random.default_rng(4)
    points = rng.uniform(-50, 50, (20, 3))
    points[:, 2] = plane[3] - points[:, :2] @ plane[:2]
    for camera in rig().cameras.values():
        a, b, c = reciprocal_depth(plane, camera)
        u, v = camera.project(points).T
        assert a * u + b * v + c == pytest.approx(1 / camera.camera_from_world.apply(points)[:, 2], rel=1e-9)
