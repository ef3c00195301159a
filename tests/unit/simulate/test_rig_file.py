"""A rig from a file: built as described, refused by the name of the file, the camera and the key."""

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from mammometry.base.errors import SessionError
from mammometry.simulate.rigs.build import build_rig, flashes
from mammometry.simulate.rigs.poses import draw_poses
from mammometry.simulate.rigs.rig_file import find_plan, make_rig, read_rig_plan
from mammometry.simulate.rigs.targets import BOARD, sees_target

EXACT = """
format = 1
name = "exact"
[lens]
size = [800, 600]
focal_px = 1400
distortion = [-0.1, 0.2, 0.001, -0.001, 0.05]
[[pairs]]
name = "front"
towards = [0, 0, 2]
along = [1, 0, 0]
distance_mm = 700
baseline_mm = 200
[[cameras]]
name = "a"
position_mm = [-100, -700, 0]
principal_point_px = [410.0, 290.0]
[[cameras]]
name = "b"
position_mm = [100, -700, 0]
target_mm = [5, 0, 0]
size = [600, 800]
[[pairs]]
name = "below"
left = "a"
right = "b"
[errors]
position_mm = 0
aim_mm = 0
roll_deg = 0
focal = 0
aspect = 0
principal_point = 0
distortion = [0, 0, 0, 0]
"""


@pytest.fixture
def exact(tmp_path: Path) -> Path:
    path = tmp_path / "exact.toml"
    path.write_text(EXACT)
    return path


def test_without_errors_the_rig_is_the_plan(exact):
    rig = make_rig(str(exact), 1.0, 5)
    assert list(rig.pair_names) == ["front", "below"]
    assert set(rig.cameras) == {"a", "b", "front_left", "front_right"}
    left, right = rig.pair("front").left, rig.pair("front").right
    assert np.linalg.norm(left.centre_world - right.centre_world) == pytest.approx(200.0)
    assert np.linalg.norm(left.centre_world) == pytest.approx(700.0)
    assert left.centre_world[2] == pytest.approx(math.sqrt(700.0**2 - 100.0**2))
    assert left.distortion.tolist() == [-0.1, 0.2, 0.001, -0.001, 0.05]
    assert left.axis_world == pytest.approx(-left.centre_world / 700.0)
    a, b = rig.cameras["a"], rig.cameras["b"]
    assert a.centre_world == pytest.approx([-100.0, -700.0, 0.0])
    assert a.matrix[:2, 2].tolist() == [410.0, 290.0]
    assert b.size_wh == (600, 800)
    assert b.axis_world == pytest.approx(np.array([-95.0, 700.0, 0.0]) / math.hypot(95.0, 700.0))
    half = make_rig(f"{exact}:below", 0.5, 5)
    assert list(half.pair_names) == ["below"]
    point = np.array([[10.0, 20.0, 30.0]])
    assert (a.project(point) + 0.5) / 2 - 0.5 == pytest.approx(half.cameras["a"].project(point))


@pytest.mark.slow
def test_the_example_is_a_rig_that_can_be_calibrated(repository):
    plan, _ = find_plan(str(repository / "examples" / "rig.toml"))
    rig = build_rig(plan, 0.25, 3)
    assert set(rig.pair_names) == {"front", "floor", "side"}
    poses = draw_poses(rig, BOARD, 8, 3)
    for camera in rig.cameras.values():
        assert sum(sees_target(camera, pose, BOARD) for pose in poses.values()) >= 3
    lights = flashes(1.0, plan)
    assert lights.shape == (3, 4)
    assert lights[2, 3] / lights[0, 3] == pytest.approx(0.8)


@pytest.mark.slow
def test_errors_are_drawn_as_wide_as_told(tmp_path, exact):
    path = tmp_path / "loose.toml"
    path.write_text(EXACT.replace("position_mm = 0\n", "position_mm = 3\n").replace("focal = 0\n", "focal = 0.02\n"))
    cameras = [make_rig(str(path), 0.1, seed).cameras["a"] for seed in range(200)]
    offset = np.array([camera.centre_world for camera in cameras]) - [-100.0, -700.0, 0.0]
    # 600 and 200 draws: a standard deviation is known to 3 % and 5 %.
    assert offset.std() == pytest.approx(3.0, rel=0.1)
    assert np.std([camera.matrix[0, 0] for camera in cameras]) == pytest.approx(0.02 * 140.0, rel=0.2)


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("format = 1", "format = 2", "format"),
        ("focal_px = 1400", "focal_px = -3", r"lens\.focal_px"),
        ("focal_px = 1400\n", "", "focal_px"),
        ("size = [800, 600]", "size = [800]", r"lens\.size"),
        ("baseline_mm = 200", "", r"pairs\[0\] \(front\).*baseline_mm"),
        ("baseline_mm = 200", "baseline_mm = 1500", "front.*twice the distance"),
        ("baseline_mm = 200", "baseline_mm = 200\nzoom = 3", r"pairs\[0\] \(front\)\.zoom.*not known"),
        ("towards = [0, 0, 2]\n", "", "front"),
        ("towards = [0, 0, 2]", "towards = [0, 0, 0]", "no length"),
        ("along = [1, 0, 0]", "along = [0, 0, 1]", "no length"),
        ("along = [1, 0, 0]", "along = [nan, 0, 0]", "along"),
        ('left = "a"', 'left = "c"', "'c'"),
        ('left = "a"\nright = "b"', 'left = "b"\nright = "a"', "pair below.*to the left"),
        ('left = "a"', 'left = "b"', "twice"),
        ('name = "b"', 'name = "a"', "two called 'a'"),
        ('name = "b"', 'name = "b b"', r"cameras\[1\] \(b b\)\.name"),
        ("focal = 0\n", "focal = -0.1\n", r"errors\.focal"),
        ("[errors]", "[[flashes]]\nposition_mm = [0, 0, -500]\n[errors]", "no flash"),
        ("format = 1", "format = ", "exact.toml"),
    ],
)
def test_unfit_description_is_named(exact, old, new, named):
    assert old in EXACT
    exact.write_text(EXACT.replace(old, new, 1))
    with pytest.raises(SessionError, match=named) as refused:
        read_rig_plan(exact)
    assert str(exact) in str(refused.value)


def test_camera_in_no_pair_and_missing_file_are_named(exact, tmp_path):
    exact.write_text(EXACT.replace('[[pairs]]\nname = "below"\nleft = "a"\nright = "b"\n', ""))
    with pytest.raises(SessionError, match="'a'"):
        read_rig_plan(exact)
    with pytest.raises(SessionError, match=r"(?i:no) such"):
        read_rig_plan(tmp_path / "none.toml")


def test_the_files_format_is_toml(repository):
    assert tomllib.loads((repository / "examples" / "rig.toml").read_text())["format"] == 1
