"""Every kind of target that the virtual rig can hold calibrates it, end to end, as far as a user would take it."""

import json
import tomllib
from functools import cache

import numpy as np
import pytest

from mammometry.api.job import open_session
from mammometry.base.errors import SettingsError
from mammometry.calibration.targets.table import target_from_table
from mammometry.geometry.camera import Rig
from mammometry.geometry.transform import Transform
from mammometry.simulate.recipe import SessionRecipe
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.skin import make_skin
from mammometry.simulate.rigs.poses import draw_poses
from mammometry.simulate.rigs.rig_file import make_rig
from mammometry.simulate.rigs.targets import VIRTUAL_TARGETS, described, make_target, sees_target
from mammometry.simulate.session import write_session
from mammometry.simulate.studio import Studio, refusing


@pytest.mark.parametrize("name", list(VIRTUAL_TARGETS))
def test_manifest_describes_the_target(name):
    text = "\n".join(f"{key} = {json.dumps(value)}" for key, value in described(VIRTUAL_TARGETS[name]).items())
    assert target_from_table(tomllib.loads(text)) == VIRTUAL_TARGETS[name]


@cache
def drawn(name: str) -> tuple[Rig, dict[str, Transform]]:
    """The reference rig, and eight poses of a target before it."""
    rig = make_rig("reference", 0.25, 7)
    return rig, dict(draw_poses(rig, VIRTUAL_TARGETS[name], 8, 7))


@pytest.mark.parametrize(
    "name", [name if name == "charuco" else pytest.param(name, marks=pytest.mark.slow) for name in VIRTUAL_TARGETS]
)
@pytest.mark.slow
def test_cameras_see_every_target_and_neighbours_share_views(name):
    target = VIRTUAL_TARGETS[name]
    rig, poses = drawn(name)
    seen = np.array([[sees_target(camera, pose, target) for camera in rig.cameras.values()] for pose in poses.values()])
    assert seen.sum(axis=0).min() >= 4
    shared = seen.T.astype(int) @ seen.astype(int)
    assert shared.min() >= 2  # any two cameras
    assert np.linalg.norm(target.body.normals_target, axis=1) == pytest.approx(1.0)


@pytest.mark.slow
def test_alike_boards_lie_to_the_right_in_every_picture():
    target = VIRTUAL_TARGETS["circles"]
    rig, poses = drawn("circles")
    assert target.body.looks_alike_turned
    assert not VIRTUAL_TARGETS["circles-asymmetric"].body.looks_alike_turned
    assert not VIRTUAL_TARGETS["chessboard"].body.looks_alike_turned
    for pose in poses.values():
        for camera in rig.cameras.values():
            if sees_target(camera, pose, target):
                first, last = camera.project(pose.apply(target.points_target[[0, target.grid[0] - 1]]))
                assert last[0] > first[0]


def test_unknown_words_are_refused():
    makers = (
        lambda: make_target("sphere"),
        lambda: make_skin("fur"),
        lambda: Studio(background="beach"),
        lambda: Studio(image_format="bmp"),
        lambda: Film().with_noise(-1.0),
        lambda: Film(f_number=0.1),
    )
    for make in makers:
        with (
            pytest.raises(SettingsError, match=r"^simulate: "),
            refusing(SettingsError, expected="options", remedy="Correct the option"),
        ):
            make()


def test_an_unknown_renderer_is_refused_with_the_known_ones():
    with pytest.raises(SettingsError, match=r"^--renderer: .*'built-in', 'mitsuba'\. 'mitsuba'"):
        Studio(renderer="mitsubishi")


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in VIRTUAL_TARGETS if name != "charuco"])
def test_a_session_with_this_target_calibrates(name, tmp_path):
    made = write_session(
        tmp_path / "s", SessionRecipe(subject="sphere", scale=0.2, poses=10), Studio(target=make_target(name))
    )
    found = open_session(tmp_path / "s").calibrate().rig
    # Relative pose of the cameras of each pair, and focal lengths: whatever frame the target made the world.
    for pair in made.rig.pair_names:
        true, measured = made.rig.pair(pair), found.pair(pair)
        baseline = np.linalg.norm(true.left.centre_world - true.right.centre_world)
        measured_mm = np.linalg.norm(measured.left.centre_world - measured.right.centre_world)
        assert measured_mm == pytest.approx(baseline, rel=2e-3)
    for camera, true in made.rig.cameras.items():
        assert found.cameras[camera].matrix[0, 0] == pytest.approx(true.matrix[0, 0], rel=2e-3)
