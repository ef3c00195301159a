"""Whole calibrations of a virtual rig: against its truth, against its own standard deviations, and with faults."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from virtual_rig import BOARD, PAIRS, cameras_in_rig, observe, placements, solid_target, with_views

from mammometry.base.errors import CalibrationError
from mammometry.calibration.adjust.bundle import calibrate
from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.calibration.adjust.projection import CameraPrior
from mammometry.calibration.detection.detect import Detection, Observations
from mammometry.calibration.judge.scale import require_sides
from mammometry.calibration.settings import BundleSettings, CalibrateSettings
from mammometry.geometry.camera import Camera, Rig
from mammometry.study.accuracy import compare_rigs

CAMERAS = cameras_in_rig()
POSES = placements(8)
STIFF = CalibrateSettings(bundle=BundleSettings(free_target="never"))
VOLUME = np.stack(np.meshgrid(*[np.linspace(-90, 90, 5)] * 3), axis=-1).reshape(-1, 3)


def worst_projection_px(calibration: Calibration, world_pose: str = "00") -> float:
    """Largest image error over the working volume, the world being the target in the first pose: no alignment."""
    world_from_rig = POSES[world_pose].inverse()
    errors = [
        calibration.rig.cameras[name].project(world_from_rig.apply(VOLUME)) - camera.project(VOLUME)
        for name, camera in CAMERAS.items()
    ]
    return float(np.abs(errors).max())


@pytest.mark.slow
def test_without_noise_the_truth_comes_out() -> None:
    calibration = calibrate(observe(CAMERAS, POSES, noise_px=0.0), PAIRS, "virtual")
    assert worst_projection_px(calibration) < 1e-5
    assert calibration.rms_px < 1e-5
    assert re.search(r"chessboard .*pose 00, mm$", calibration.world)
    np.testing.assert_allclose(calibration.world_from_target["00"].matrix, np.eye(4), atol=1e-12)
    for pose, placement in POSES.items():
        expected = POSES["00"].inverse() @ placement
        np.testing.assert_allclose(calibration.world_from_target[pose].matrix, expected.matrix, atol=1e-6)


def estimation_error(calibration: Calibration, camera: Camera) -> np.ndarray:
    """Estimated − true values of a camera in the order of its parameters' names."""
    found = calibration.rig.cameras[camera.name]
    true_from_world = camera.camera_from_world @ POSES["00"]
    turn = Rotation.from_matrix(found.camera_from_world.rotation @ true_from_world.rotation.T).as_rotvec()
    shift = found.centre_world - true_from_world.inverse().translation_mm
    fx_fy_cx_cy = (found.matrix - camera.matrix)[[0, 1, 0, 1], [0, 1, 2, 2]]
    return np.concatenate([fx_fy_cx_cy, (found.distortion - camera.distortion)[:4], turn, shift])


@pytest.mark.parametrize("seeds", [pytest.param(seeds, marks=pytest.mark.slow) for seeds in (2, 6)])
def test_errors_are_as_large_as_the_covariance_says(seeds: int) -> None:
    chi2, count, scaled = 0.0, 0, []
    for seed in range(seeds):
        calibration = calibrate(observe(CAMERAS, POSES, noise_px=0.05, seed=seed), PAIRS, "virtual", STIFF)
        error = np.concatenate([estimation_error(calibration, camera) for camera in CAMERAS.values()])
        names = calibration.covariance.names[: len(error)]
        assert names[0] == "front_left.fx_px"
        assert names[-1] == "floor_right.centre_z_mm"
        block = calibration.covariance.independent[: len(error), : len(error)]
        chi2 += float(error @ np.linalg.solve(block, error))
        count += len(error)
        std = [calibration.independent_std[name.split(".")[0]][name.split(".")[1]] for name in names]
        np.testing.assert_allclose(std, np.sqrt(np.diag(block)))
        scaled.append(error / std)
        assert calibration.noise_factor == pytest.approx(1.0, abs=0.05)
        assert calibration.rms_px == pytest.approx(0.05 * np.sqrt(2), rel=0.03)
    # 56 degrees of freedom a seed: the mean square has a standard deviation of √(2 / n); four of them, and Huber's 3 %.
    assert abs(chi2 / count - 1) < 4 * np.sqrt(2 / count) + 0.03
    assert np.abs(scaled).max() < 4.5


@pytest.mark.slow
def test_outliers_are_left_out_and_do_no_harm() -> None:
    rng = np.random.default_rng(3)
    wrong: dict[tuple[str, str], np.ndarray] = {}

    def with_errors(detection: Detection) -> Detection:
        bad = rng.random(len(detection.ids)) < 0.05
        wrong[detection.camera, detection.pose] = bad
        return replace(detection, uv=detection.uv + bad[:, None] * rng.choice([-3.0, 3.0], size=(len(bad), 2)))

    observations = with_views(observe(CAMERAS, POSES), with_errors)
    calibration = calibrate(observations, PAIRS, "virtual")
    assert worst_projection_px(calibration) < 0.1  # as without outliers: 0.03–0.06
    for detection, residual_px in zip(observations.detections, calibration.residuals_px, strict=True):
        np.testing.assert_array_equal(np.isnan(residual_px[:, 0]), wrong[detection.camera, detection.pose])


@pytest.mark.slow
def test_noise_is_measured_where_detections_underrate_it() -> None:
    def too_sure(detection: Detection) -> Detection:
        return replace(detection, covariance_px2=detection.covariance_px2 / 16)

    calibration = calibrate(with_views(observe(CAMERAS, POSES), too_sure), PAIRS, "virtual")
    honest = calibrate(observe(CAMERAS, POSES), PAIRS, "virtual")
    assert calibration.noise_factor == pytest.approx(4 * honest.noise_factor, rel=1e-3)
    assert calibration.parameter_std["front_left"]["fx_px"] == pytest.approx(
        honest.parameter_std["front_left"]["fx_px"], rel=1e-3
    )


@pytest.mark.slow  # test_faults has it, with what is said
def test_picture_of_another_pose_is_set_aside_by_name() -> None:
    clean = observe(CAMERAS, POSES)
    other = {detection.pose: detection for detection in clean.detections if detection.camera == "floor_left"}
    observations = with_views(
        clean, lambda d: replace(other["06"], pose="03") if (d.camera, d.pose) == ("floor_left", "03") else d
    )
    calibration = calibrate(observations, PAIRS, "virtual")
    assert [(view.camera, view.pose) for view in calibration.set_aside] == [("floor_left", "03")]
    assert calibration.set_aside[0].residual_px > 10
    assert worst_projection_px(calibration) < 0.1
    index = observations.detections.index(
        next(d for d in observations.detections if (d.camera, d.pose) == ("floor_left", "03"))
    )
    assert np.isnan(calibration.residuals_px[index]).all()


@pytest.mark.slow  # test_faults has it, with what is said
def test_left_and_right_exchanged_in_one_pose_are_both_named() -> None:
    exchange = {"front_left": "front_right", "front_right": "front_left"}

    def exchanged(detection: Detection) -> Detection:
        if detection.pose != "02":
            return detection
        return replace(detection, camera=exchange.get(detection.camera, detection.camera))

    calibration = calibrate(with_views(observe(CAMERAS, POSES), exchanged), PAIRS, "virtual")
    assert {(view.camera, view.pose) for view in calibration.set_aside} == {("front_left", "02"), ("front_right", "02")}
    assert worst_projection_px(calibration) < 0.1


@pytest.mark.slow  # test_faults has it, with what is said
def test_pair_exchanged_everywhere_is_an_error_that_names_it() -> None:
    with pytest.raises(CalibrationError, match=r"pair floor.*floor_right") as caught:
        require_sides(
            calibrate(observe(CAMERAS, POSES), {**PAIRS, "floor": ("floor_right", "floor_left")}, "v").rig, ()
        )
    assert "left and right" in str(caught.value)


@pytest.mark.slow
def test_pose_of_a_single_camera_counts_for_its_intrinsics() -> None:
    only_front_left = [(camera, pose) for camera in CAMERAS if camera != "front_left" for pose in ("06", "07")]
    with_them = calibrate(observe(CAMERAS, POSES, skip=only_front_left), PAIRS, "virtual")
    without = [(camera, pose) for camera in CAMERAS for pose in ("06", "07")]
    fewer = calibrate(observe(CAMERAS, POSES, skip=without), PAIRS, "virtual")
    std = {name: result.independent_std["front_left"]["fx_px"] for name, result in (("all", with_them), ("few", fewer))}
    assert std["all"] < 0.98 * std["few"]  # equal if the two views were ignored
    assert set(with_them.world_from_target) == set(POSES)


@pytest.mark.slow
def test_world_is_the_first_pose_in_name_order_whatever_the_order_given() -> None:
    observations = observe(CAMERAS, POSES)
    backwards = Observations(
        target=BOARD, sizes_wh=observations.sizes_wh, detections=tuple(reversed(observations.detections))
    )
    calibration = calibrate(backwards, PAIRS, "virtual")
    assert calibration.world.endswith("pose 00, mm")
    assert worst_projection_px(calibration) < 0.1
    for detection, residual_px in zip(backwards.detections, calibration.residuals_px, strict=True):
        assert residual_px.shape == detection.uv.shape


def test_too_few_poses_say_how_many_are_needed() -> None:
    with pytest.raises(CalibrationError, match=r"^camera front_left: .*\b2 .*\b3\b"):
        calibrate(observe(CAMERAS, placements(2)), PAIRS, "virtual")


def test_camera_that_saw_nothing_is_named() -> None:
    skip = [("floor_right", pose) for pose in POSES]
    with pytest.raises(CalibrationError, match=r"^camera floor_right: .*\b0 "):
        calibrate(observe(CAMERAS, POSES, skip=skip), PAIRS, "virtual")


def test_cameras_without_a_common_pose_are_named() -> None:
    skip = [(camera, pose) for camera in PAIRS["floor"] for pose in list(POSES)[:4]]
    skip += [(camera, pose) for camera in PAIRS["front"] for pose in list(POSES)[4:]]
    with pytest.raises(CalibrationError, match=r"front_left with front_right: .*floor_left"):
        calibrate(observe(CAMERAS, POSES, skip=skip), PAIRS, "virtual")


def test_pair_with_an_unknown_camera_is_named() -> None:
    with pytest.raises(CalibrationError, match=r"pair left: .*left_left"):
        calibrate(observe(CAMERAS, POSES), {"left": ("left_left", "left_right")}, "virtual")


@pytest.mark.slow
def test_bowed_board_needs_free_points() -> None:
    nominal = BOARD.points_target
    away = nominal[:, :2] - nominal[:, :2].mean(axis=0)
    bow_mm = 0.5 * (1 - np.sum(away**2, axis=1) / np.sum(away**2, axis=1).max())
    points = nominal + bow_mm[:, None] * np.array([0, 0, 1.0])
    observations = observe(CAMERAS, POSES, points=points)
    stiff = calibrate(observations, PAIRS, "virtual", STIFF)
    free = calibrate(observations, PAIRS, "virtual")
    assert stiff.rms_px > 0.06
    assert free.rms_px == pytest.approx(0.02 * np.sqrt(2), rel=0.08)
    found_mm = free.target_points[:, 2] - nominal[:, 2]
    # Up to a tilt, which is the placement's: remove the best plane from both.
    plane = np.column_stack([away, np.ones(len(away))])
    for values in (found_mm, bow_mm):
        values -= plane @ np.linalg.lstsq(plane, values, rcond=None)[0]
    assert np.abs(found_mm - bow_mm).max() < 0.05
    # What it costs: the calibrated against the true cameras over the volume that skin takes.
    ticks = np.linspace(-100, 100, 5)
    volume = np.stack(np.meshgrid(ticks, ticks, ticks), axis=-1).reshape(-1, 3)
    true = Rig(name="true", cameras=CAMERAS, pair_names=PAIRS)
    assert compare_rigs(free.rig, true, volume).projection_rms_px <= 0.02
    assert compare_rigs(stiff.rig, true, volume).projection_rms_px > 0.04


@pytest.mark.slow
def test_paper_model_ties_the_focal_lengths() -> None:
    settings = CalibrateSettings(bundle=BundleSettings(model="paper"))
    calibration = calibrate(observe(CAMERAS, POSES), PAIRS, "virtual", settings)
    for name, camera in calibration.rig.cameras.items():
        assert camera.matrix[0, 0] == camera.matrix[1, 1]
        assert camera.distortion[2:].tolist() == [0, 0, 0]
        assert calibration.parameter_std[name]["p1"] == 0
        assert calibration.parameter_std[name]["fx_px"] == calibration.parameter_std[name]["fy_px"] > 0


def separate_photographs(noise_px: float = 0.02) -> dict[str, Observations]:
    """Six photographs of a board for each camera, each camera by itself, at poses of its own."""
    separate = {}
    for i, (name, camera) in enumerate(CAMERAS.items()):
        own_poses = {f"own{pose}": placement for pose, placement in placements(6, seed=20 + i).items()}
        separate[name] = observe({name: camera}, own_poses, noise_px=noise_px, seed=i)
    return separate


@pytest.mark.slow
def test_one_view_of_a_surveyed_target_with_separate_intrinsics() -> None:
    target = solid_target()
    placement = placements(1, target=target, seed=4)
    observations = observe(CAMERAS, placement, target=target)
    calibration = calibrate(observations, PAIRS, "virtual", intrinsics_observations=separate_photographs())
    assert re.search(r"points .*pose 00, mm$", calibration.world)
    assert list(calibration.world_from_target) == ["00"]
    world_from_rig = placement["00"].inverse()
    for name, camera in CAMERAS.items():
        found = calibration.rig.cameras[name].project(world_from_rig.apply(VOLUME))
        assert np.abs(found - camera.project(VOLUME)).max() < 0.15
        assert len(calibration.intrinsics_residuals_px[name]) == 6
        std = calibration.parameter_std[name]["fx_px"]
        assert abs(calibration.rig.cameras[name].matrix[0, 0] - camera.matrix[0, 0]) < 4 * std


def test_one_view_of_a_surveyed_target_alone() -> None:
    """The paper's own calibration: everything from targets of known coordinates."""
    target = solid_target()
    placement = placements(1, target=target, seed=4)
    calibration = calibrate(observe(CAMERAS, placement, target=target, noise_px=0.0), PAIRS, "virtual")
    world_from_rig = placement["00"].inverse()
    for name, camera in CAMERAS.items():
        found = calibration.rig.cameras[name].project(world_from_rig.apply(VOLUME))
        assert np.abs(found - camera.project(VOLUME)).max() < 1e-4


def test_separate_photographs_of_another_size_are_named() -> None:
    separate = separate_photographs()
    separate["floor_left"] = replace(separate["floor_left"], sizes_wh={"floor_left": (750, 1126)})
    with pytest.raises(CalibrationError, match=r"floor_left: .*750 × 1126 pixels, .*1126 × 750"):
        calibrate(observe(CAMERAS, POSES), PAIRS, "virtual", intrinsics_observations=separate)
    with pytest.raises(CalibrationError, match="of x: "):
        calibrate(observe(CAMERAS, POSES), PAIRS, "virtual", intrinsics_observations={"x": separate["floor_left"]})


@pytest.mark.slow
def test_progress_reaches_the_end() -> None:
    fractions: list[float] = []
    calibrate(observe(CAMERAS, POSES), PAIRS, "virtual", STIFF, progress=fractions.append)
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0


def as_prior(camera: Camera, std: dict[str, float]) -> CameraPrior:
    return CameraPrior(camera=camera, std=std)


@pytest.mark.slow
def test_prior_holds_what_it_fixes_and_guides_what_it_knows() -> None:
    observations = observe(CAMERAS, POSES, noise_px=0.05)
    longer = CAMERAS["front_left"].matrix + np.diag([3.0, 3.0, 0.0])
    off = replace(CAMERAS["front_left"], matrix=longer)
    fixed = calibrate(
        observations, PAIRS, "virtual", STIFF, priors={"front_left": as_prior(off, {"fx_px": 0.0, "fy_px": 0.0})}
    )
    assert fixed.rig.cameras["front_left"].matrix[0, 0] == longer[0, 0]
    assert fixed.parameter_std["front_left"]["fx_px"] == 0
    assert "front_left.fx_px" not in fixed.covariance.names
    alone = calibrate(observations, PAIRS, "virtual", STIFF)
    found = alone.rig.cameras["front_left"].matrix[0, 0]
    weak = {"front_left": as_prior(off, {"fx_px": 1e3})}
    assert calibrate(observations, PAIRS, "virtual", STIFF, priors=weak).rig.cameras["front_left"].matrix[
        0, 0
    ] == pytest.approx(found, abs=1e-3)
    drawn = {"front_left": as_prior(off, {"fx_px": alone.independent_std["front_left"]["fx_px"]})}
    between = calibrate(observations, PAIRS, "virtual", STIFF, priors=drawn).rig.cameras["front_left"].matrix[0, 0]
    assert found + 0.1 < between < longer[0, 0] - 0.1


@pytest.mark.slow
def test_with_the_last_calibration_as_prior_one_pose_suffices() -> None:
    last = calibrate(observe(CAMERAS, POSES, seed=1), PAIRS, "virtual", STIFF)
    names = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3")
    priors = {
        name: as_prior(camera, {key: last.parameter_std[name][key] for key in names})
        for name, camera in last.rig.cameras.items()
    }
    one = observe(CAMERAS, {"00": POSES["00"]}, seed=2)
    with pytest.raises(CalibrationError, match=r"\b1 .*view"):
        calibrate(one, PAIRS, "virtual", STIFF)
    calibration = calibrate(one, PAIRS, "virtual", STIFF, priors=priors)
    assert worst_projection_px(calibration) < 0.15


def test_prior_of_another_image_size_is_named() -> None:
    priors = {"floor_left": as_prior(replace(CAMERAS["floor_left"], size_wh=(2252, 1500)), {})}
    with pytest.raises(CalibrationError, match=r"prior of camera floor_left: .*2252 × 1500"):
        calibrate(observe(CAMERAS, POSES), PAIRS, "virtual", STIFF, priors=priors)
