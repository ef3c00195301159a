"""Cables that are exchanged while a rig is calibrated, found on the board's points as any camera model gives them."""

from itertools import combinations

import numpy as np
import pytest

from mammometry.calibration.detection.detect import Detection
from mammometry.calibration.judge.camera_names import check_board_names
from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.simulate.rigs.build import REFERENCE, build_rig
from mammometry.simulate.rigs.poses import draw_poses
from mammometry.simulate.rigs.targets import sees_target, visible_points

BOARD = CharucoTarget(squares=(14, 10), square_mm=25.0, marker_mm=18.0, dictionary="DICT_5X5_250")
NOISE_PX = 0.5  # ten times a detected corner's


@pytest.fixture(scope="module")
def rig():
    return build_rig(REFERENCE, 0.2, 3)


@pytest.fixture(scope="module")
def poses(rig):
    return list(draw_poses(rig, BOARD, 2, 1).values())


@pytest.fixture(scope="module", params=range(2))
def seen(rig, poses, request):
    """What each camera that sees the board has of it, in one pose."""
    placed = poses[request.param]
    rng = np.random.default_rng(request.param)
    found = {}
    for name, camera in rig.cameras.items():
        if not sees_target(camera, placed, BOARD):
            continue
        ids = np.flatnonzero(visible_points(camera, placed, BOARD))
        uv = camera.project(placed.apply(BOARD.points_target[ids])) + rng.normal(0, NOISE_PX, (len(ids), 2))
        found[name] = Detection(
            camera=name, pose="00", ids=ids, uv=uv, covariance_px2=np.tile(np.eye(2) * NOISE_PX**2, (len(ids), 1, 1))
        )
    assert len(found) > 2
    return found


def exchanged(seen, one, other):
    renamed = {one: other, other: one}
    return {renamed.get(name, name): each for name, each in seen.items()}


def test_right_names_are_left_alone(rig, seen):
    assert check_board_names(rig, seen) is None


@pytest.mark.slow
@pytest.mark.requirement("R-FIRE-4")
def test_any_two_cameras_of_which_one_sees_the_board_are_named(rig, seen):
    for pair in list(combinations(rig.cameras, 2))[::5]:
        if set(pair) & set(seen):
            assert set(check_board_names(rig, exchanged(seen, *pair)) or ()) == set(pair), pair


def test_a_camera_that_was_turned_is_no_exchange(rig, seen):
    """What no exchange explains, the calibration judges."""
    name = next(iter(seen))
    moved = Detection(
        camera=name, pose="00", ids=seen[name].ids, uv=seen[name].uv + 60, covariance_px2=seen[name].covariance_px2
    )
    assert check_board_names(rig, {**seen, name: moved}) is None
