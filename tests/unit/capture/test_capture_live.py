"""Aids to aiming and focusing, on pictures whose faults the test made."""

import numpy as np
import pytest
from scipy import ndimage
from tests.unit.capture.virtual_capture import ball, rig_file

from mammometry.base.photograph import Photograph
from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.capture.loop import OpenRig
from mammometry.capture.page import REGIONS, LiveView, aids
from mammometry.simulate.rendering.develop import develop
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.solid_target import render_target
from mammometry.simulate.rigs.build import REFERENCE, build_rig, flashes
from mammometry.simulate.rigs.poses import draw_poses

BOARD = CharucoTarget(squares=(14, 10), square_mm=25.0, marker_mm=18.0, dictionary="DICT_5X5_250")


@pytest.fixture(scope="module")
def rig():
    return build_rig(REFERENCE, 0.2, 3)


@pytest.fixture(scope="module")
def subject(rig):
    return ball(rig.cameras["front_left"])


def seen(pixels, **how):
    return aids(Photograph(name="it", pixels=np.ascontiguousarray(pixels)), "front_left", "model", **how)


def test_sharpness_falls_where_the_picture_is_blurred_and_only_there(subject):
    half = subject.shape[1] // 2
    blurred = subject.copy()
    blurred[:, :half] = ndimage.gaussian_filter(subject[:, :half], (3, 3, 0))
    before, after = seen(subject).sharpness, seen(blurred).sharpness
    middle = slice(1, 3)  # where the ball is
    assert (after[middle, 2] < 0.6 * before[middle, 2]).all()
    assert after[middle, 3:5] == pytest.approx(before[middle, 3:5], rel=0.05)


def test_saturation_and_histogram_count_what_is_there():
    pixels = np.zeros((320, 480, 3), np.uint8)
    pixels[:, :120] = 255
    found = seen(pixels)
    assert found.saturated == pytest.approx(0.25)
    assert found.histogram[0] == 320 * 360
    assert found.histogram[-1] == 320 * 120
    assert found.histogram.sum() == 320 * 480


def test_a_subject_that_is_cut_off_is_said(subject):
    assert seen(subject).is_whole
    assert not seen(subject[200:]).is_whole


@pytest.mark.slow
def test_where_the_target_was_seen_is_remembered_and_the_rest_still_wanted(rig):
    camera = rig.cameras["front_left"]
    covered = np.zeros(REGIONS, dtype=bool)
    for placed in draw_poses(rig, BOARD, 3, 1).values():
        picture = develop(render_target(camera, placed, BOARD, flashes()), Film(), name="it", seed=1)
        found = aids(picture, "front_left", "model", target=BOARD, covered=covered)
        uv = camera.project(placed.apply(BOARD.points_target))
        inside = (uv > 0).all(axis=1) & (uv < np.array(camera.size_wh)).all(axis=1)
        assert found.target > 0.5 * inside.sum()
        assert (found.covered >= covered).all()
        covered = found.covered
    assert covered.sum() > 0
    nothing = aids(
        Photograph(name="it", pixels=np.full((100, 150), 90, np.uint8)), "it", "model", target=BOARD, covered=covered
    )
    assert nothing.target == 0
    assert (nothing.covered == covered).all()


@pytest.mark.slow
def test_all_cameras_are_looked_at_and_a_broken_one_has_a_sentence(place):
    with OpenRig(rig_file(place, faults='left_left = "unplugged"')) as rigged:
        view = LiveView(rigged.backend, rigged.cameras, "model", BOARD)
        found = view.look()
        assert view.wanted() == dict.fromkeys(rigged.cameras, REGIONS[0] * REGIONS[1])
        view.close()
    assert "cable" in found.pop("left_left")
    assert all(one.jpeg.startswith(b"\xff\xd8") for one in found.values())
    assert all(one.as_table()["is_whole"] for one in found.values())
