"""Bad photographs of a board: used where they can be, otherwise named with what they show and what to do."""

import re
from dataclasses import replace

import numpy as np
import pytest
from printed import mirrored, turned
from scipy.ndimage import gaussian_filter
from tests.first_cases import first

from mammometry.base.photograph import Photograph
from mammometry.calibration.detection.detect import Detection, Observations, detect, set_duplicates_aside
from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.calibration.targets.kinds.chessboard import ChessboardTarget
from mammometry.geometry.transform import Transform
from mammometry.simulate.rendering.develop import develop
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.solid_target import render_target
from mammometry.simulate.rigs.build import flashes
from mammometry.simulate.rigs.rig_file import make_rig

BOARD = CharucoTarget(squares=(14, 10), square_mm=25.0, marker_mm=18.0, dictionary="DICT_5X5_250")
CHESS = ChessboardTarget(squares=(14, 9), square_mm=25.0)
VIEW = make_rig("reference", 0.25, 3).cameras["front_left"]


def placed(*, shift_mm=(0.0, 0.0, 0.0), turn_deg=(8.0, -14.0, 6.0), target=BOARD):
    """Board whose middle is at `shift_mm` in the rig, its face towards the front pair."""
    middle = np.append(np.array(target.squares) * target.square_mm / 2, 0.0)
    towards = Transform(rotation=np.diag([1.0, -1.0, -1.0]), translation_mm=np.array(shift_mm))
    turn = Transform.from_rotation_vector(np.radians(turn_deg), np.zeros(3))
    return towards @ turn @ Transform(rotation=np.eye(3), translation_mm=-middle)


def light(target=BOARD, **placing):
    return render_target(VIEW, placed(target=target, **placing), target, flashes(), background=0.004)


def shoot(radiance, film=Film()):
    return develop(radiance, film, name="calibration/00/a.jpg", seed=1)


def see(photograph, target=BOARD):
    return detect({("00", "a"): photograph}, target)


def error_px(seen, target=BOARD, **placing):
    (found,) = seen.detections
    return found.uv - VIEW.project(placed(target=target, **placing).apply(target.points_target[found.ids]))


@pytest.fixture(scope="module")
def radiance():
    return light()


def grey(photograph, change):
    pixels = change(photograph.pixels.astype(np.float32))
    return Photograph(name=photograph.name, pixels=np.clip(pixels, 0, 255).astype(np.uint8))


@pytest.mark.parametrize("blur_px", first(1, [3.0, 1.5]))
def test_a_soft_picture_is_used(radiance, blur_px):
    error = error_px(see(shoot(radiance, Film(blur_px=blur_px))))
    assert len(error) > 60
    assert np.abs(error.mean(axis=0)).max() < 0.02
    assert np.sqrt(np.square(error).mean()) < 0.1


@pytest.mark.parametrize("exposure", [1.8, 0.15])
def test_an_exposure_that_is_off_but_not_lost_is_used(radiance, exposure):
    over = exposure * radiance
    seen = see(shoot(over))
    if exposure > 1:
        assert (shoot(over).pixels == 255).mean() > 0.1  # the white squares are clipped
    error = error_px(seen)
    assert len(error) > 100
    assert np.abs(error.mean(axis=0)).max() < 0.01
    assert np.sqrt(np.square(error).mean()) < 0.03


@pytest.mark.parametrize("shift_mm", [(190.0, 0.0, 0.0), (-60.0, 150.0, 60.0)])
def test_a_board_cut_off_by_the_frame_gives_its_corners_inside(shift_mm):
    error = error_px(see(shoot(light(shift_mm=shift_mm))), shift_mm=shift_mm)
    assert 20 < len(error) < 110
    assert np.sqrt(np.square(error).mean()) < 0.03


@pytest.mark.slow
def test_half_a_turn_keeps_every_corners_number(radiance):
    upright, upside_down = (
        see(photograph).detections[0] for photograph in (shoot(radiance), turned(shoot(radiance), 2))
    )
    np.testing.assert_array_equal(upright.ids, upside_down.ids)
    np.testing.assert_allclose(np.array(VIEW.size_wh) - 1 - upside_down.uv, upright.uv, atol=0.03)


def two_of_them(target):
    near, far = light(shift_mm=(-110.0, 0.0, -250.0)), light(target, shift_mm=(120.0, 0.0, -250.0))
    return np.maximum(near, far)


@pytest.mark.slow
def test_a_second_board_of_another_kind_does_not_disturb():
    other = CharucoTarget(squares=(8, 6), square_mm=25.0, marker_mm=18.0, dictionary="DICT_4X4_250")
    error = error_px(see(shoot(two_of_them(other))), shift_mm=(-110.0, 0.0, -250.0))
    assert np.sqrt(np.square(error).mean()) < 0.05


SMALL = CharucoTarget(squares=(8, 6), square_mm=40.0, marker_mm=29.0, dictionary="DICT_5X5_250")
OTHER = CharucoTarget(squares=(8, 6), square_mm=40.0, marker_mm=29.0, dictionary="DICT_4X4_250")
LARGE = CharucoTarget(squares=(16, 12), square_mm=20.0, marker_mm=15.0, dictionary="DICT_5X5_250")
CASES = {
    "mirrored": (lambda r: mirrored(shoot(r)), BOARD, "mirrored board", "without flipping"),
    "over-exposed": (lambda r: shoot(40 * np.maximum(r, 0.01)), BOARD, "overexposed", "Expose it less"),
    "black": (lambda r: shoot(0.005 * r), BOARD, "nearly black", "flash"),
    "blurred": (lambda r: shoot(gaussian_filter(r, 14.0)), BOARD, "without sharp edges", "Focus"),
    "other dictionary": (
        lambda r: shoot(light(OTHER)),
        BOARD,
        'dictionary = "DICT_4X4_50" and squares = [8, 6]',
        'Write dictionary = "DICT_4X4_50" and squares',
    ),
    "smaller board": (
        lambda r: shoot(light(SMALL)),
        BOARD,
        "a board with squares = [8, 6]",
        "Write squares = [8, 6] in [target]",
    ),
    "larger board": (
        lambda r: shoot(light(LARGE)),
        BOARD,
        "a board with squares = [16, 12]",
        "Write squares = [16, 12]",
    ),
    "larger markers": (
        lambda r: shoot(r),
        replace(BOARD, marker_mm=16.0),
        "times square_mm, but in [target] 16 and 25 mm, 0.640 times",
        "either square_mm = 25 and marker_mm = 18.",
    ),
    "smaller markers": (lambda r: shoot(r), replace(BOARD, marker_mm=20.0), "marker_mm 0.7", "Measure both"),
    "two boards": (lambda r: shoot(two_of_them(BOARD)), BOARD, "two boards in view", "one board"),
    "nothing": (lambda r: shoot(np.full_like(r, 0.1)), BOARD, "no target", ""),
    "other chessboard": (
        lambda r: shoot(light(replace(CHESS, squares=(10, 7)))),
        CHESS,
        "not a complete one of 14 × 9 squares",
        "squares",
    ),
    "cut chessboard": (
        lambda r: shoot(light(CHESS, shift_mm=(190.0, 0.0, 0.0))),
        CHESS,
        "not a complete one of 14 × 9 squares",
        "border",
    ),
}
REPEATED = {"other chessboard", "cut chessboard", "other dictionary", "smaller board", "larger board", "mirrored"}
"""Cost most; `tests/brought/test_boards.py` shows the same of small photographs."""


@pytest.mark.parametrize(
    "case",
    [pytest.param(name, marks=[pytest.mark.slow] if name in REPEATED else []) for name in CASES],
)
def test_what_cannot_be_used_is_named(radiance, case):
    make, target, found, remedy = CASES[case]
    seen = see(make(radiance), target)
    assert seen.detections == ()
    (missed,) = seen.missed
    assert (missed.pose, missed.camera) == ("00", "a")
    assert found in missed.found
    assert remedy in missed.remedy
    assert bool(remedy) == bool(missed.remedy)
    assert str(missed).startswith(f"pose 00, a: {missed.found}")


def test_a_view_with_too_few_points_says_how_many(radiance, monkeypatch):
    monkeypatch.setattr(type(BOARD), "least_points", 118)
    seen = detect({("00", "a"): shoot(radiance)}, BOARD)
    assert seen.detections == ()
    assert "117 points" in seen.missed[0].found


# --- duplicates ---


def detection(pose, camera, uv, ids=None):
    ids = np.arange(len(uv)) if ids is None else ids
    return Detection(
        camera=camera, pose=pose, ids=ids, uv=uv, covariance_px2=np.tile(1e-4 * np.eye(2), (len(uv), 1, 1))
    )


@pytest.fixture
def rig_views():
    """Three poses, three cameras, corners anywhere but never twice the same."""
    rng = np.random.default_rng(8)
    return {(pose, camera): rng.uniform(0, 900, (60, 2)) for pose in ("00", "01", "02") for camera in "abc"}


def observed(views):
    detections = tuple(detection(pose, camera, uv) for (pose, camera), uv in sorted(views.items()))
    return Observations(target=BOARD, sizes_wh=dict.fromkeys("abc", (900, 900)), detections=detections)


def left(observations):
    return {(seen.pose, seen.camera) for seen in observations.detections}


def test_honest_views_stay_as_they_are(rig_views):
    seen = observed(rig_views)
    assert set_duplicates_aside(seen) is seen


def test_one_picture_under_two_cameras_names_is_believed_of_neither(rig_views):
    rig_views["01", "b"] = rig_views["01", "a"] + 0.02
    seen = set_duplicates_aside(observed(rig_views))
    assert left(seen) == rig_views.keys() - {("01", "a"), ("01", "b")}
    one, other = map(str, seen.missed)
    assert re.search("^pose 01, a: .*01/b", one)
    assert re.search("^pose 01, b: .*01/a", other)


def test_one_cameras_picture_in_two_poses_is_believed_in_neither(rig_views):
    rig_views["02", "c"] = rig_views["00", "c"]
    seen = set_duplicates_aside(observed(rig_views))
    assert left(seen) == rig_views.keys() - {("00", "c"), ("02", "c")}
    assert re.search("^pose 02, c: .*00/c", str(seen.missed[1]))


def test_a_pose_that_was_copied_counts_once(rig_views):
    for camera in "abc":
        rig_views["02", camera] = rig_views["00", camera]
    seen = set_duplicates_aside(observed(rig_views))
    assert left(seen) == {view for view in rig_views if view[0] != "02"}


def test_two_exposures_of_a_board_that_stood_still_both_count(rig_views):
    noise = np.random.default_rng(2)
    for camera in "abc":
        rig_views["02", camera] = rig_views["00", camera] + 0.01 * noise.normal(size=(60, 2))
    seen = observed(rig_views)
    assert set_duplicates_aside(seen) is seen


def test_other_points_are_another_picture(rig_views):
    uv = rig_views["00", "a"]
    twin = detection("01", "a", uv[:20], np.arange(20))
    first = detection("00", "a", uv)
    seen = Observations(target=BOARD, sizes_wh={"a": (900, 900)}, detections=(first, twin))
    assert set_duplicates_aside(seen) is seen
