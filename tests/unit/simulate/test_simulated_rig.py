"""The virtual rig is a plausible rig, and the same rig at every scale."""

import math

import numpy as np
import pytest

from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.simulate.rigs.build import DISTANCE_MM, flashes
from mammometry.simulate.rigs.poses import draw_poses
from mammometry.simulate.rigs.rig_file import make_rig
from mammometry.simulate.rigs.targets import sees_target

_BOARD = CharucoTarget(squares=(14, 10), square_mm=25.0, marker_mm=18.0, dictionary="DICT_5X5_250")


@pytest.mark.parametrize("seed", [1, 7, 23])
def test_reference_rig_is_as_described(seed):
    rig = make_rig("reference", 0.25, seed)
    assert list(rig.pair_names) == ["front", "floor", "left", "right"]
    assert len(rig.cameras) == 8
    for pair in rig.pairs:
        convergence_deg = math.degrees(math.acos(pair.left.axis_world @ pair.right.axis_world))
        assert 11.0 < convergence_deg < 21.0
        # The left camera stands on the left: the right one's centre has a positive x in its frame.
        assert pair.left.camera_from_world.apply(pair.right.centre_world)[0] > 100.0
    for camera in rig.cameras.values():
        assert camera.size_wh == (1126, 750)
        assert np.linalg.norm(camera.centre_world) == pytest.approx(DISTANCE_MM, rel=0.06)
        uv = camera.project(np.zeros((1, 3)))[0]
        assert np.abs(uv - 0.5 * np.array(camera.size_wh)).max() < 60.0  # aimed at the middle
        # About 0.1 mm a pixel at full size.
        assert np.linalg.norm(camera.centre_world) / camera.matrix[0, 0] * 0.25 == pytest.approx(0.1, rel=0.1)


@pytest.mark.parametrize("larger", [1.0, 2.0])
def test_scale_changes_the_pixels_and_nothing_else(larger):
    small, full = make_rig("reference", 0.25, 4), make_rig("reference", larger, 4)
    points = np.random.default_rng(0).uniform(-80, 80, (50, 3))
    for name, camera in small.cameras.items():
        assert np.array_equal(camera.centre_world, full.cameras[name].centre_world)
        uv = camera.project(points)
        # Pyramid rule: (u + ½) scales with the image.
        assert (full.cameras[name].project(points) + 0.5) * (0.25 / larger) - 0.5 == pytest.approx(uv, abs=1e-9)


def test_seeded_errors_differ():
    first, again, other = (make_rig("reference", 0.25, seed).cameras["left_left"] for seed in (4, 4, 5))
    assert np.array_equal(first.matrix, again.matrix)
    assert np.array_equal(first.camera_from_world.rotation, again.camera_from_world.rotation)
    assert abs(first.matrix[0, 0] - other.matrix[0, 0]) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 7, 23])
def test_every_camera_sees_the_board_often_and_all_see_the_first(seed):
    rig = make_rig("reference", 0.25, seed)
    poses = draw_poses(rig, _BOARD, 8, seed)
    assert list(poses) == [f"{index:02d}" for index in range(8)]
    seen = {
        pose: {n for n, camera in rig.cameras.items() if sees_target(camera, placed, _BOARD)}
        for pose, placed in poses.items()
    }
    assert len(seen["00"]) >= 7
    for name in rig.cameras:
        assert sum(name in names for names in seen.values()) >= 5
    pairs = list(rig.pairs)
    for a in pairs:
        for b in pairs:  # any two pairs share views
            assert sum({a.left.name, b.left.name} <= names for names in seen.values()) >= 2


@pytest.mark.slow
def test_poses_tilt_and_turn():
    poses = list(draw_poses(make_rig("reference", 0.25, 7), _BOARD, 8, 7).values())
    cosines = [a.rotation[:, 2] @ b.rotation[:, 2] for a in poses for b in poses]
    assert min(cosines) < math.cos(math.radians(25.0))


def test_part_of_a_rig():
    rig = make_rig("reference:floor,front", 0.1, 2)
    assert list(rig.pair_names) == ["floor", "front"]
    assert set(rig.cameras) == {"floor_left", "floor_right", "front_left", "front_right"}


@pytest.mark.parametrize("name", ["referenz", "reference:top"])
def test_unknown_rig_is_refused(name):
    with pytest.raises(ValueError, match="found"):
        make_rig(name, 0.25, 1)


@pytest.mark.parametrize("scale", [0.0, 2.5])
def test_scale_out_of_range_is_refused(scale):
    with pytest.raises(ValueError, match="scale"):
        make_rig("reference", scale, 1)


def test_flashes_light_a_white_surface_to_full_scale():
    lights = flashes(0.9)
    normal = np.array([0.0, -math.sqrt(0.5), math.sqrt(0.5)])
    irradiance = 0.0
    for x, y, z, strength in lights:
        towards = np.array([x, y, z])
        r = np.linalg.norm(towards)
        irradiance += strength * max(0.0, normal @ towards / r) / r**2
    assert irradiance == pytest.approx(0.9)
