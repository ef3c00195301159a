"""Pairs of a walk, and the box in which the body is."""

import re

import numpy as np
import pytest

from mammometry.base.errors import CalibrationError
from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.geometry import Camera, Rig, Transform
from mammometry.walk.pairs import NARROWEST_DEG, WIDEST_DEG, candidates, choose_pairs, require_arc, require_upright
from mammometry.walk.region import region_above

MIDDLE = np.array([0.0, -200.0, 0.0])


def looking(name, angle_deg, distance_mm=650.0, height_mm=0.0, roll_deg=0.0):
    """A camera that looks at the body's middle from an angle to the left or right of straight ahead (−z)."""
    angle = np.radians(angle_deg)
    centre = MIDDLE + np.array([distance_mm * np.sin(angle), height_mm, -distance_mm * np.cos(angle)])
    ahead = (MIDDLE - centre) / np.linalg.norm(MIDDLE - centre)
    right = np.cross([0.0, 1.0, 0.0], ahead)
    right /= np.linalg.norm(right)
    roll = np.radians(roll_deg)
    down = np.cross(ahead, right)
    rotation = np.stack([np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right, ahead])
    return Camera(
        name=name,
        size_wh=(2000, 1500),
        matrix=np.array([[1500.0, 0, 1000], [0, 1500.0, 750], [0, 0, 1]]),
        distortion=np.zeros(5),
        camera_from_world=Transform(rotation=rotation, translation_mm=-rotation @ centre),
    )


def rig(cameras):
    return Rig(name="telephone", cameras={camera.name: camera for camera in cameras}, pair_names={})


def test_pairs_cover_the_arc_with_the_left_picture_on_the_left():
    cameras = [looking(f"{i:02d}", angle) for i, angle in enumerate(range(-60, 61, 6))]
    pairs = choose_pairs(rig(cameras), MIDDLE, most=10)
    by_name = {camera.name: camera for camera in cameras}
    directions = []
    for left, right in pairs.values():
        one, other = by_name[left], by_name[right]
        assert (one.camera_from_world.rotation @ (other.centre_world - one.centre_world))[0] > 0
        to_one, to_other = one.centre_world - MIDDLE, other.centre_world - MIDDLE
        cosine = to_one @ to_other / np.linalg.norm(to_one) / np.linalg.norm(to_other)
        assert NARROWEST_DEG <= np.degrees(np.arccos(cosine)) <= WIDEST_DEG
        middle = to_one + to_other
        directions.append(np.degrees(np.arctan2(middle[0], -middle[2])))
    directions.sort()
    assert len(pairs) == 10
    assert directions[0] < -45
    assert directions[-1] > 45
    assert np.diff(directions).max() < 25


def test_pictures_from_other_distances_or_too_far_apart_make_no_pair():
    near, far = looking("near", -7, distance_mm=500), looking("far", 7, distance_mm=700)
    assert candidates([near, far], MIDDLE) == []
    assert candidates([looking("one", -15), looking("other", 15)], MIDDLE) == []


@pytest.mark.parametrize(
    ("angles_deg", "gap"),
    [
        (range(-60, 61, 10), None),
        ((*range(-60, -19, 10), *range(20, 61, 10)), (-20, 20)),
        (range(-60, 11, 10), (10, 30)),
        (range(-20, 61, 10), (-30, -20)),
    ],
)
def test_a_gap_in_the_arc_is_named(angles_deg, gap):
    cameras = [looking(str(angle), angle) for angle in angles_deg]
    if gap is None:
        require_arc(cameras, MIDDLE)
        return
    with pytest.raises(CalibrationError) as refused:
        require_arc(cameras, MIDDLE)
    assert [int(number) for number in re.findall(r"([+-]\d+)°", refused.value.found)] == list(gap)


def test_the_region_is_above_the_board_and_its_picture_is_whole():
    target = CharucoTarget(squares=(11, 7), square_mm=24.0, marker_mm=17.0, dictionary="DICT_5X5_100")
    region = region_above(target)
    assert not region.contains(target.points_target).any()
    above = np.array([[132.0, -150.0, -60.0], [0.0, -150.0, 20.0]])
    assert region.contains(above).all()
    camera = looking("one", 20)
    mask = region.mask(camera)
    rng = np.random.default_rng(3)
    inside = region.low_world + rng.uniform(size=(500, 3)) * (region.high_world - region.low_world)
    uv = np.round(camera.project(inside)).astype(int)
    seen = (uv >= 1).all(axis=1) & (uv < np.array(camera.size_wh) - 1).all(axis=1)
    assert mask[uv[seen, 1], uv[seen, 0]].all()


def test_a_board_that_is_upside_down_on_the_patient_is_refused():
    """In the board's frame the breasts are then below it. A board alone is no reason."""
    board_middle = MIDDLE + np.array([0.0, 300.0, 30.0])
    cameras = [looking(str(i), angle) for i, angle in enumerate(range(-60, 61, 12))]
    require_upright(cameras, MIDDLE, board_middle)
    turned = np.append((2 * board_middle - MIDDLE)[:2], MIDDLE[2])
    with pytest.raises(CalibrationError):
        require_upright(cameras, turned, board_middle)
    require_upright(cameras, MIDDLE + np.array([0.0, -400.0, 0.0]), MIDDLE)
