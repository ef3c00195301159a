"""What a calibration says of its own errors, against errors that are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from virtual_rig import BOARD, PAIRS, cameras_in_rig, observe, placements, smooth_errors, with_views

from mammometry.calibration.adjust.bundle import K3_SIGMA, calibrate
from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.calibration.detection.detect import Detection, Observations
from mammometry.calibration.judge.expected_error import ExpectedError, expected_error, working_volume
from mammometry.calibration.judge.reconstruction import triangulate
from mammometry.calibration.settings import BundleSettings, CalibrateSettings
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform

CAMERAS = cameras_in_rig()
POSES = placements(10)
STIFF = CalibrateSettings(bundle=BundleSettings(free_target="never", k3="zero"))


def actual_error_mm(calibration: Calibration, expected: ExpectedError) -> np.ndarray:
    """Shifts of all points that the pairs see, true image points triangulated, but for motions and scale."""
    true_points, found = [], []
    for pair in calibration.rig.pairs:
        seen = POSES["00"].apply(expected.volume.grid_world[np.isfinite(expected.std_mm[pair.name])])
        true_points.append(seen)
        found.append(triangulate(pair, CAMERAS[pair.left.name].project(seen), CAMERAS[pair.right.name].project(seen)))
    true, seen = np.concatenate(true_points), np.concatenate(found)
    return without_similarity(true, seen)


def without_similarity(true: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Shifts that no motion, turn and scale of the whole explains (Umeyama 1991)."""
    a, b = true - true.mean(axis=0), seen - seen.mean(axis=0)
    turn, _ = Rotation.align_vectors(b, a)
    turned = turn.apply(a)
    shifts: np.ndarray = b - turned * (np.sum(turned * b) / np.sum(a * a))
    return shifts


@pytest.fixture(scope="module")
def stiff() -> Calibration:
    return calibrate(observe(CAMERAS, POSES), PAIRS, "virtual", STIFF)


def rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.slow
@pytest.mark.parametrize("amplitude_px", [0.0, 0.05])
def test_expected_error_is_the_actual_one(amplitude_px: float) -> None:
    """Monte Carlo with 0.05 px of independent noise, without and with errors that views share."""
    actual, predicted, independent = [], [], []
    for seed in range(4):
        observations = observe(CAMERAS, POSES, noise_px=0.05, seed=seed)
        observations = with_views(observations, smooth_errors(seed, amplitude_px))
        calibration = calibrate(observations, PAIRS, "virtual", STIFF)
        expected = expected_error(calibration)
        seen = np.concatenate([std[np.isfinite(std)] for std in expected.std_mm.values()])
        actual.append(rms(np.linalg.norm(actual_error_mm(calibration, expected), axis=1).tolist()))
        predicted.append(rms(seen.tolist()))
        covariance = replace(calibration.covariance, matrix=calibration.covariance.independent)
        naive = expected_error(replace(calibration, covariance=covariance))
        independent.append(rms(np.concatenate([std[np.isfinite(std)] for std in naive.std_mm.values()]).tolist()))
    # 8 runs gave actual/predicted of 0.79 without and 0.85 with shared errors, and 0.95 and 2.8 for the covariance of
    # independent ones; a mean square of four has a standard deviation of a fifth (some ten directions carry it).
    assert 0.5 < rms(actual) / rms(predicted) < 1.25
    if amplitude_px:
        assert rms(actual) / rms(independent) > 1.7
    else:
        assert rms(actual) / rms(independent) == pytest.approx(1.0, abs=0.3)


def test_expected_error_of_a_single_uncertain_focal_length(stiff: Calibration) -> None:
    """A pair's depth and width by hand: with one camera's focal length off, points shift as triangulation says."""
    std_px = 1.0
    only = {"matrix": np.array([[std_px**2]]), "independent": np.array([[std_px**2]]), "names": ("front_left.fx_px",)}
    calibration = replace(stiff, covariance=replace(stiff.covariance, **only))
    expected = expected_error(calibration)
    pair = calibration.rig.pair("front")
    matrix = pair.left.matrix.copy()
    matrix[0, 0] += std_px
    longer = replace(pair, left=replace(pair.left, matrix=matrix))
    both, count = [], {}
    for name in PAIRS:
        points = expected.volume.grid_world[np.isfinite(expected.std_mm[name])]
        count[name] = len(points)
        seen = calibration.rig.pair(name)
        uv = seen.left.project(points), seen.right.project(points)
        both.append(triangulate(longer if name == "front" else seen, *uv) - points)
    points = np.concatenate([expected.volume.grid_world[np.isfinite(expected.std_mm[name])] for name in PAIRS])
    shifts = np.concatenate(both)
    free = without_similarity(points, points + shifts)
    found = np.concatenate([std[np.isfinite(std)] for std in expected.std_mm.values()])
    # Midpoints of rays are not quite least squares in the image, and the motion is linearised: a few per cent.
    np.testing.assert_allclose(found, np.linalg.norm(free, axis=1), rtol=0.1, atol=0.02 * found.max())


def test_working_volume_is_what_pairs_see_where_the_target_was_held(stiff: Calibration) -> None:
    calibration = stiff
    volume = working_volume(calibration)
    centre = volume.grid_world[4, 4, 4]
    assert np.linalg.norm(POSES["00"].apply(centre)) < 40  # the cameras look at the rig's origin, to 0.01 rad or so
    assert 8 * volume.spacing_mm == pytest.approx(750 * 0.4, rel=0.05)  # as high as a picture, 0.4 mm a pixel
    for pair in calibration.rig.pairs:
        for camera in (pair.left, pair.right):
            uv = camera.project(volume.grid_world[~np.isnan(expected_error(calibration).std_mm[pair.name])])
            assert ((uv > -1) & (uv < np.array(camera.size_wh))).all()
    # Cameras made parallel, whose axes meet nowhere, see the same volume: it is about the places of the target.
    turn = calibration.rig.cameras["front_left"].camera_from_world.rotation
    parallel = {
        name: replace(camera, camera_from_world=Transform(rotation=turn, translation_mm=-turn @ camera.centre_world))
        for name, camera in calibration.rig.cameras.items()
    }
    elsewhere = working_volume(replace(calibration, rig=replace(calibration.rig, cameras=parallel)))
    np.testing.assert_allclose(elsewhere.grid_world[4, 4, 4], centre, atol=1e-9)
    np.testing.assert_allclose(calibration.rig.target_middle_world, centre, atol=1e-9)


def with_k3(k3: float) -> dict[str, Camera]:
    return {
        name: replace(camera, distortion=np.array([*camera.distortion[:4], k3])) for name, camera in CAMERAS.items()
    }


@pytest.mark.slow
@pytest.mark.parametrize("true_k3", [0.0, 8.0])
def test_k3_is_adjusted_where_the_lens_has_one(true_k3: float) -> None:
    cameras = with_k3(true_k3)
    observations = with_views(observe(cameras, POSES, noise_px=0.02), smooth_errors(1, 0.02))
    settings = CalibrateSettings(bundle=BundleSettings(free_target="never"))
    calibration = calibrate(observations, PAIRS, "virtual", settings)
    for name in cameras:
        found, std = calibration.rig.cameras[name].distortion[4], calibration.parameter_std[name]["k3"]
        if true_k3:
            assert abs(found - true_k3) < 4 * std
            assert found > K3_SIGMA * std > 0
        else:
            assert found == std == 0


@pytest.mark.slow
def test_left_out_poses_fit_as_the_others_do() -> None:
    """With a free board, too."""
    calibration = calibrate(observe(CAMERAS, POSES), PAIRS, "virtual")
    left_out = calibration.left_out
    assert left_out is not None
    assert left_out.poses == len(POSES)
    assert left_out.fitted_px == pytest.approx(calibration.rms_px)
    assert 1.0 < left_out.ratio < 1.05  # the goal; some 14 of 100 parameters a camera hang on each pose
    assert left_out.excess == pytest.approx(1.0, abs=0.01)  # errors are independent


@pytest.mark.slow
@pytest.mark.parametrize("count", [4, pytest.param(6, marks=pytest.mark.slow)])
def test_excess_of_left_out_poses_tells_shared_errors_from_many_unknowns(count: int) -> None:
    """Fitted residuals keep 1 − p/n of the errors' variance; poses left out have 1 + q/n of it and more.

    Few poses have a ratio well above 1 by the number of unknowns alone. Only errors that a photograph's points share
    make an excess.
    """
    poses = {name: POSES[name] for name in list(POSES)[:count]}
    alone = calibrate(observe(CAMERAS, poses), PAIRS, "virtual").left_out
    shared = with_views(observe(CAMERAS, poses), smooth_errors(0, 0.03))
    together = calibrate(shared, PAIRS, "virtual").left_out
    assert alone is not None
    assert together is not None
    assert alone.ratio > 1.02
    assert alone.excess == pytest.approx(1.0, abs=0.02)
    assert together.excess > 1.08


@pytest.mark.slow
def test_separate_photographs_are_left_out_where_no_shared_pose_can_be() -> None:
    from virtual_rig import solid_target

    target = solid_target()
    placed = placements(1, target=target, seed=4)
    every = observe(CAMERAS, POSES)
    own = {
        name: Observations(
            target=BOARD,
            sizes_wh={name: camera.size_wh},
            detections=tuple(seen for seen in every.detections if seen.camera == name),
        )
        for name, camera in CAMERAS.items()
    }
    rig = observe(CAMERAS, placed, target=target)
    left_out = calibrate(rig, PAIRS, "virtual", STIFF, intrinsics_observations=own).left_out
    assert left_out is not None
    assert left_out.poses == len(POSES) * len(CAMERAS)
    assert left_out.fitted_px == pytest.approx(0.028, rel=0.05)  # 0.02 px a coordinate
    assert 1.0 < left_out.ratio < 1.1


@pytest.mark.slow
def test_left_out_pose_is_that_of_a_whole_calibration_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against the long way: calibrate without the pose, place its target by SciPy, with the board as it came out."""
    from scipy.optimize import least_squares

    poses = {name: POSES[name] for name in list(POSES)[:4]}
    monkeypatch.setattr("mammometry.calibration.adjust.robust.HUBER_MAD", 1e6)
    monkeypatch.setattr("mammometry.calibration.adjust.robust.REJECT_SIGMA", 1e6)
    settings = CalibrateSettings(bundle=BundleSettings(free_target="never", k3="zero"))
    observations = observe(CAMERAS, poses)
    squares, count = 0.0, 0
    for name in poses:
        kept = tuple(seen for seen in observations.detections if seen.pose != name)
        fewer = Observations(target=BOARD, sizes_wh=observations.sizes_wh, detections=kept)
        without = calibrate(fewer, PAIRS, "virtual", settings)
        first = min(set(poses) - {name})
        seen = [seen for seen in observations.detections if seen.pose == name]
        start = POSES[first].inverse() @ POSES[name]

        def errors(x: np.ndarray, seen: list[Detection] = seen, cameras: Calibration = without) -> np.ndarray:
            world = BOARD.points_target @ Rotation.from_rotvec(x[:3].copy()).as_matrix().T + x[3:]
            parts = [cameras.rig.cameras[view.camera].project(world[view.ids]) - view.uv for view in seen]
            return np.concatenate(parts).ravel()

        x0 = np.concatenate([Rotation.from_matrix(start.rotation.copy()).as_rotvec(), start.translation_mm])
        squares += 2 * least_squares(errors, x0, x_scale="jac").cost
        count += sum(len(view.ids) for view in seen)
    left_out = calibrate(observations, PAIRS, "virtual", settings).left_out
    assert left_out is not None
    assert left_out.left_out_px == pytest.approx(np.sqrt(squares / count), rel=1e-3)


def test_no_pose_can_be_spared_of_a_single_one() -> None:
    from virtual_rig import solid_target

    target = solid_target()
    placed = placements(1, target=target, seed=4)
    calibration = calibrate(observe(CAMERAS, placed, target=target), PAIRS, "virtual", STIFF)
    assert calibration.left_out is None


def test_scale_uncertainty_of_the_print_is_carried() -> None:
    board = replace(BOARD, edge_std_mm=0.06)
    calibration = calibrate(observe(CAMERAS, placements(4), target=board), PAIRS, "virtual", STIFF)
    assert calibration.scale_std == pytest.approx(0.06 / 300)
