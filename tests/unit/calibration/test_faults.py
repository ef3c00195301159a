"""Faults of a calibration are found and named: each is made on purpose, in the points that virtual cameras see.

Corners are measured to 0.02 px, as real ones are at a quarter of the reference size (0.4 mm a pixel at 0.8 m).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from virtual_rig import BOARD, PAIRS, cameras_in_rig, observe, placements, see, shifted, turned, with_views

from mammometry.base.errors import CalibrationError
from mammometry.calibration.adjust.bundle import calibrate
from mammometry.calibration.detection.detect import Detection, Observations
from mammometry.calibration.judge.quality import CalibrationQuality, assess
from mammometry.calibration.judge.scale import require_sides
from mammometry.calibration.targets.kinds.chessboard import ChessboardTarget
from mammometry.geometry.camera import Camera

CAMERAS = cameras_in_rig()
POSES = placements(6)
LATE = list(POSES)[3:]
Shot = tuple[str, str]


def observed(
    changed: Mapping[str, Camera], poses: Sequence[str], *, noise_px: Mapping[Shot, float] | None = None, seed: int = 3
) -> Observations:
    """All views, those of the changed cameras in some poses by the changed ones."""
    rng = np.random.default_rng(seed)
    views = []
    for pose, placed in POSES.items():
        for name, camera in CAMERAS.items():
            seen_by = changed[name] if name in changed and pose in poses else camera
            noise = (noise_px or {}).get((name, pose), 0.02)
            views.append(see(seen_by, pose, placed, BOARD.points_target, rng, noise_px=noise))
    sizes = {name: camera.size_wh for name, camera in CAMERAS.items()}
    return Observations(target=BOARD, sizes_wh=sizes, detections=tuple(views))


def judged(observations: Observations) -> CalibrationQuality:
    return assess(calibrate(observations, PAIRS, "virtual"))


def exchanged(pictures: Mapping[Shot, Shot]) -> Observations:
    """The clean views, but at a shot lies the picture of another one."""
    views = {(seen.camera, seen.pose): seen for seen in observe(CAMERAS, POSES).detections}
    detections = tuple(replace(views[pictures.get(shot, shot)], camera=shot[0], pose=shot[1]) for shot in views)
    sizes = {name: camera.size_wh for name, camera in CAMERAS.items()}
    return Observations(target=BOARD, sizes_wh=sizes, detections=detections)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("camera", "change", "effect_mm"),
    [
        # 0.03 mm across, 0.075 px, is 0.03 · 0.8 m / 0.24 m = 0.1 mm of depth; 0.003° is 0.042 mm at 0.8 m, 0.14 mm of
        # depth; upwards, as the cameras are rolled and the rays only part, 0.03 mm by triangulating with the truth.
        ("floor_left", lambda camera: shifted(camera, (0.03, 0, 0)), 0.1),
        pytest.param("front_right", lambda camera: turned(camera, (0, 0.003, 0)), 0.14, marks=pytest.mark.slow),
        pytest.param("floor_right", lambda camera: turned(camera, (0.003, 0, 0)), 0.03, marks=pytest.mark.slow),
    ],
)
def test_camera_that_moved_between_poses(camera: str, change: Callable[[Camera], Camera], effect_mm: float) -> None:
    quality = judged(observed({camera: change(CAMERAS[camera])}, LATE))
    found = quality.movements[0]
    assert (found.cameras, found.first, found.only) == ((camera,), LATE[0], False)
    assert found.effect_mm == pytest.approx(effect_mm, rel=0.25)
    assert all(one.cameras == (camera,) for one in quality.movements)
    assert quality.verdict == ("refuse" if effect_mm > 0.05 else "warn")
    first = quality.notices[0]
    assert (first.code, first.about, first.values["pose"]) == ("camera-moved", (camera,), LATE[0])


@pytest.mark.slow
def test_two_cameras_that_moved_are_both_named() -> None:
    changed = {
        "front_left": shifted(CAMERAS["front_left"], (0.05, 0, 0)),
        "floor_right": turned(CAMERAS["floor_right"], (0, 0.006, 0)),
    }
    quality = judged(observed(changed, LATE))
    assert {one.cameras for one in quality.movements[:2]} == {("front_left",), ("floor_right",)}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 6))])
def test_still_rigs_give_no_alarm(seed: int) -> None:
    quality = judged(observed({}, (), seed=seed))
    assert quality.movements == ()
    assert quality.verdict == "pass"


@pytest.mark.slow
def test_camera_not_exposed_together_with_the_others_in_one_pose() -> None:
    """The board, in a hand, went on by 0.05 mm before this camera's shutter opened."""
    late = shifted(CAMERAS["front_left"], (0.05, 0, 0))
    quality = judged(observed({"front_left": late}, ["04"]))
    found = quality.movements[0]
    assert (found.cameras, found.first, found.only) == (("front_left",), "04", True)
    assert quality.verdict == "warn"
    first = quality.notices[0]
    assert (first.code, first.photographs) == ("camera-not-together", ("calibration/04/front_left",))


@pytest.mark.slow
def test_pair_not_exposed_together_with_the_others_in_one_pose() -> None:
    changed = {name: shifted(CAMERAS[name], (0.1, 0.05, 0)) for name in PAIRS["front"]}
    quality = judged(observed(changed, ["04"]))
    found = quality.movements[0]
    assert found.cameras in PAIRS.values()  # of two pairs, either: only motion between them shows
    assert (found.first, found.only) == ("04", True)
    assert (quality.notices[0].code, quality.notices[0].values["pose"]) == ("cameras-not-together", "04")


def named(quality: CalibrationQuality) -> tuple[object, ...]:
    """Code of the first finding, and the two photographs that it names."""
    first = quality.notices[0]
    return (first.code, *(first.values[name] for name in ("camera", "pose", "other_camera", "other_pose")))


@pytest.mark.slow
def test_picture_of_another_pose_is_recognised() -> None:
    quality = judged(exchanged({("floor_left", "03"): ("floor_left", "05")}))
    assert quality.verdict == "warn"
    assert named(quality) == ("photograph-of-another", "floor_left", "03", "floor_left", "05")


@pytest.mark.slow
def test_left_and_right_swapped_in_one_pose() -> None:
    left, right = ("front_left", "02"), ("front_right", "02")
    quality = judged(exchanged({left: right, right: left}))
    assert quality.verdict == "warn"
    assert named(quality) == ("photographs-exchanged", "front_left", "02", "front_right", "02")
    assert "photographs-exchanged" not in {notice.code for notice in quality.notices[1:]}


@pytest.mark.slow
def test_left_and_right_swapped_in_every_pose() -> None:
    """No residual shows it: only that the right camera then stands to the left."""
    swap = {}
    for pose in POSES:
        swap |= {("front_left", pose): ("front_right", pose), ("front_right", pose): ("front_left", pose)}
    calibration = calibrate(exchanged(swap), PAIRS, "virtual")
    with pytest.raises(CalibrationError, match=r"pair front: .*front_right .*front_left"):
        require_sides(calibration.rig, ())


def test_camera_seen_by_too_few_views_is_named() -> None:
    skip = [("floor_right", pose) for pose in list(POSES)[2:]]
    with pytest.raises(CalibrationError, match=r"camera floor_right: .*\b2 .*\b1 "):
        calibrate(observe(CAMERAS, POSES, skip=skip), PAIRS, "virtual")


@pytest.mark.slow
def test_few_and_blurred_views_are_refused_by_the_focal_length() -> None:
    """Three views, all but parallel, one of them blurred: the residual stays small, the focal length is unknown."""
    skip = [("floor_right", pose) for pose in list(POSES)[3:]]
    observations = observe(CAMERAS, POSES, skip=skip, noise_px=0.2)
    quality = judged(observations)
    assert quality.verdict == "refuse"
    poor = [notice for notice in quality.notices if notice.code == "focal-length-uncertain"]
    assert ("floor_right", 3) in [(notice.about[0], notice.values["views"]) for notice in poor]


@pytest.mark.slow
def test_blurred_view_is_named() -> None:
    quality = judged(observed({}, (), noise_px={("floor_left", "05"): 0.4}))
    assert quality.verdict == "warn"
    assert ("photograph-blurred", ("floor_left",)) in [(notice.code, notice.about) for notice in quality.notices]


@pytest.mark.slow
def test_board_of_another_print_scale_shows_in_no_residual_and_is_asked_for() -> None:
    """0.5 % too large a print: the same residuals, a rig 0.5 % too small; so the edge has to be measured."""
    larger = ChessboardTarget(squares=BOARD.squares, square_mm=BOARD.square_mm * 1.005)
    poses = placements(5)  # too few to adjust the board as well
    truth = calibrate(observe(CAMERAS, poses, points=larger.points_target, target=larger), PAIRS, "virtual")
    fooled = calibrate(observe(CAMERAS, poses, points=larger.points_target), PAIRS, "virtual")
    assert fooled.rms_px == pytest.approx(truth.rms_px, rel=1e-3)
    base = [np.linalg.norm(rig.pair("front").right.centre_world - rig.pair("front").left.centre_world)
            for rig in (truth.rig, fooled.rig)]  # fmt: skip
    assert base[1] / base[0] == pytest.approx(1 / 1.005, abs=2e-5)
    assert assess(fooled).notices[-1].code == "target-not-measured"

    measured = replace(BOARD, edge_std_mm=0.06)  # of 300 mm: 0.02 %
    last = assess(calibrate(observe(CAMERAS, poses, target=measured), PAIRS, "virtual")).notices[-1]
    assert last.code == "target-measured"
    assert last.values == {"percent": pytest.approx(0.02, abs=5e-4), "volume_percent": pytest.approx(0.06, abs=2e-3)}


@pytest.mark.slow
def test_one_camera_s_picture_under_another_s_name_in_one_pose() -> None:
    quality = judged(exchanged({("front_right", "02"): ("front_left", "02")}))
    assert named(quality) == ("photograph-of-another", "front_right", "02", "front_left", "02")


@pytest.mark.slow
@pytest.mark.parametrize("pose", ["02", "00", "05"])
def test_pictures_of_two_pairs_cameras_swapped_in_one_pose(pose: str) -> None:
    """Of four: half of that pose's views are wrong, but each in its own way, and the other half agree."""
    one, other = ("front_left", pose), ("floor_right", pose)
    quality = judged(exchanged({one: other, other: one}))
    assert quality.verdict == "warn"
    assert set(named(quality)[1:]) == {"front_left", "floor_right", pose}
    assert quality.notices[0].code == "photographs-exchanged"
    assert not {notice.code for notice in quality.notices[1:]} & {"photograph-unfitting", "photograph-of-another"}


def mirrored(seen: Detection) -> Detection:
    """What a chessboard's detector finds in the mirror image: the corners counted from the other side."""
    columns = BOARD.squares[0] - 1
    ids = seen.ids // columns * columns + columns - 1 - seen.ids % columns
    order = np.argsort(ids)
    uv = np.column_stack([CAMERAS[seen.camera].size_wh[0] - 1 - seen.uv[:, 0], seen.uv[:, 1]])
    return replace(seen, ids=ids[order], uv=uv[order])


@pytest.mark.slow
def test_mirrored_picture_of_a_chessboard_is_set_aside() -> None:
    """By itself it is a flawless picture of a chessboard: only the other cameras contradict it."""
    clean = observe(CAMERAS, POSES)
    quality = judged(with_views(clean, lambda d: mirrored(d) if (d.camera, d.pose) == ("floor_left", "03") else d))
    assert quality.verdict == "warn"
    first = quality.notices[0]
    assert (first.code, first.photographs) == ("photograph-unfitting", ("calibration/03/floor_left",))
    assert quality.rms_px == pytest.approx(0.028, abs=0.002)


@pytest.mark.slow
@pytest.mark.parametrize("camera", ["front_right", "floor_left"])
def test_camera_that_mirrors_all_its_chessboards_is_named(camera: str) -> None:
    clean = observe(CAMERAS, POSES)
    with pytest.raises(CalibrationError, match=rf"camera {camera}: "):
        calibrate(with_views(clean, lambda d: mirrored(d) if d.camera == camera else d), PAIRS, "virtual")


@pytest.mark.slow
def test_camera_missing_in_a_pose_is_used_in_the_others() -> None:
    skip = [("front_left", "01"), ("floor_right", "04")]
    calibration = calibrate(observe(CAMERAS, POSES, skip=skip), PAIRS, "virtual")
    assert len(calibration.observations.detections) == len(POSES) * len(CAMERAS) - 2
    assert calibration.set_aside == ()
    assert all(np.isfinite(residual_px).all() for residual_px in calibration.residuals_px)
    assert assess(calibration).verdict == "pass"
    for name, camera in CAMERAS.items():
        found = calibration.rig.cameras[name].matrix[0, 0]
        assert abs(found - camera.matrix[0, 0]) < 4 * calibration.parameter_std[name]["fx_px"]


def test_detections_are_as_they_were() -> None:
    """The virtual pictures of this module are those of the clean rig where nothing is changed."""
    one: Detection = observed({}, ()).detections[0]
    camera = CAMERAS[one.camera]
    true = camera.project(POSES[one.pose].apply(BOARD.points_target))[one.ids]
    assert np.sqrt(np.mean((one.uv - true) ** 2)) == pytest.approx(0.02, rel=0.2)
