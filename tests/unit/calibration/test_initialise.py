"""First values: robust means, the graph of cameras and poses, resection, and what cannot be started from."""

from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from virtual_rig import BOARD, cameras_in_rig, observe, placements, solid_target, with_views

from mammometry.base.errors import CalibrationError
from mammometry.calibration.adjust.initialise import (
    average_network,
    components,
    initialise,
    median_transform,
    require_connected,
    resect,
)
from mammometry.calibration.detection.detect import Detection, Observations
from mammometry.geometry.transform import Transform


def angle_between(a: Transform, b: Transform) -> float:
    return float(Rotation.from_matrix(a.rotation @ b.rotation.T).magnitude())


def perturbed(transform: Transform, rng: np.random.Generator, angle_rad: float, shift_mm: float) -> Transform:
    by = Transform.from_rotation_vector(rng.normal(size=3) * angle_rad, rng.normal(size=3) * shift_mm)
    return by @ transform


def test_median_of_one_is_itself() -> None:
    only = Transform.from_rotation_vector(np.array([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0]))
    assert median_transform([only]) is only


def test_median_ignores_a_wrong_minority() -> None:
    rng = np.random.default_rng(0)
    true = Transform.from_rotation_vector(np.array([2.0, -1.0, 0.5]), np.array([100.0, -50.0, 800.0]))
    near = [perturbed(true, rng, 1e-3, 0.1) for _ in range(12)]
    far = [perturbed(true, rng, 1.0, 300.0) for _ in range(9)]
    found = median_transform([*near[:6], *far, *near[6:]])
    assert angle_between(found, true) < 2e-3
    np.testing.assert_allclose(found.translation_mm, true.translation_mm, atol=2.0)


def test_components_group_what_hangs_together() -> None:
    views = [("a", "1"), ("b", "2"), ("c", "3"), ("b", "1"), ("d", "3"), ("e", "9"), ("a", "2")]
    assert components(views) == [({"a", "b"}, {"1", "2"}), ({"c", "d"}, {"3"}), ({"e"}, {"9"})]
    require_connected([*views[:2], ("a", "2")])
    with pytest.raises(CalibrationError, match=r"cameras c with d, e: .*\ba, b"):
        require_connected(views)


def test_network_of_exact_poses_comes_back_in_the_first_poses_frame() -> None:
    cameras, poses = cameras_in_rig(), placements(4)
    # a chain: each camera shares one pose with the next one only
    chain = {"front_left": ["00", "01"], "front_right": ["01", "02"], "floor_left": ["02", "03"], "floor_right": ["03"]}
    seen = {
        (name, pose): cameras[name].camera_from_world @ poses[pose] for name, listed in chain.items() for pose in listed
    }
    cameras_from_world, world_from_targets = average_network(seen)
    for name, camera in cameras.items():
        expected = camera.camera_from_world @ poses["00"]
        np.testing.assert_allclose(cameras_from_world[name].matrix, expected.matrix, atol=1e-9)
    for pose, placement in poses.items():
        np.testing.assert_allclose(
            world_from_targets[pose].matrix, (poses["00"].inverse() @ placement).matrix, atol=1e-9
        )


def test_network_that_falls_apart_is_refused() -> None:
    with pytest.raises(ValueError, match=r"\['b'\]"):
        average_network({("a", "1"): Transform.identity(), ("b", "2"): Transform.identity()})


@pytest.mark.parametrize("kind", ["board", "solid"])
def test_resection_finds_the_pose(kind: str) -> None:
    target = BOARD if kind == "board" else solid_target()
    camera = cameras_in_rig()["floor_left"]
    for placement in placements(6, target=target, seed=3).values():
        expected = camera.camera_from_world @ placement
        points = target.points_target
        intrinsics = np.concatenate([camera.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], camera.distortion])
        found = resect(points, camera.project(placement.apply(points)), intrinsics)
        assert found is not None
        np.testing.assert_allclose(found.matrix, expected.matrix, atol=1e-5)


def test_resection_of_nonsense_does_not_fail() -> None:
    intrinsics = np.array([2000.0, 2000, 563, 375, 0, 0, 0, 0, 0])
    assert resect(BOARD.points_target[:4], np.zeros((4, 2)), intrinsics) is None


def test_first_values_are_within_a_pixel() -> None:
    cameras, poses = cameras_in_rig(), placements(8)
    initial = initialise(observe(cameras, poses))
    volume = np.stack(np.meshgrid(*[np.linspace(-60, 60, 3)] * 3), axis=-1).reshape(-1, 3)
    for name, camera in cameras.items():
        fx, fy, cx, cy = initial.intrinsics[name][:4]
        assert fx == pytest.approx(camera.matrix[0, 0], rel=3e-3)
        there = (initial.camera_from_world[name] @ poses["00"].inverse()).apply(volume)
        uv = there[:, :2] / there[:, 2:] * (fx, fy) + (cx, cy)
        assert np.abs(uv - camera.project(volume)).max() < 4  # lens distortion, left out here, is 1–2 px of it


def test_first_values_are_found_by_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Several add up their views in the order in which they finish: a rerun would not give equal bytes."""
    threads, real = list[int](), cv2.calibrateCameraExtended

    def watched(*args: Any, **kwargs: Any) -> Any:
        threads.append(cv2.getNumThreads())
        return real(*args, **kwargs)

    monkeypatch.setattr(cv2, "calibrateCameraExtended", watched)
    before = cv2.getNumThreads()
    cameras, poses = cameras_in_rig(), placements(8)
    initialise(observe(cameras, poses))
    assert set(threads) == {1}
    assert cv2.getNumThreads() == before


def test_one_mistaken_view_does_not_spoil_the_intrinsics() -> None:
    cameras, poses = {"front_left": cameras_in_rig()["front_left"]}, placements(8)
    clean = observe(cameras, poses)

    def misread(detection: Detection) -> Detection:
        """Lower half of the board read one corner too far to the right."""
        if detection.pose != "03":
            return detection
        uv = detection.uv.copy()
        uv[44:-1] = detection.uv[45:]
        return Detection(
            camera=detection.camera,
            pose=detection.pose,
            ids=detection.ids,
            uv=uv,
            covariance_px2=detection.covariance_px2,
        )

    spoilt = with_views(clean, misread)
    found, expected = (initialise(o).intrinsics["front_left"][0] for o in (spoilt, clean))
    assert found == pytest.approx(expected, rel=2e-3)


def test_views_with_few_points_or_points_on_a_line_do_not_count() -> None:
    cameras, poses = {"front_left": cameras_in_rig()["front_left"]}, placements(4)
    clean = observe(cameras, poses)

    def reduced(detection: Detection, keep: np.ndarray) -> Detection:
        chosen = np.isin(detection.ids, keep)
        return Detection(
            camera=detection.camera,
            pose=detection.pose,
            ids=detection.ids[chosen],
            uv=detection.uv[chosen],
            covariance_px2=detection.covariance_px2[chosen],
        )

    line, few = np.arange(11), np.array([0, 40, 60])
    a, b, c, d = clean.detections
    views = (reduced(a, line), reduced(b, few), c, d)
    with pytest.raises(CalibrationError, match=r"^camera front_left: .*\b2 .*\b3\b"):
        initialise(Observations(target=clean.target, sizes_wh=clean.sizes_wh, detections=views))


@pytest.mark.slow
def test_views_that_are_never_tilted_determine_no_focal_length() -> None:
    """Fronto-parallel boards: any focal length fits; it must not come out as if nothing were the matter."""
    camera = cameras_in_rig()["front_left"]
    middle = BOARD.points_target.mean(axis=0)
    facing = {
        f"{i}": camera.camera_from_world.inverse()
        @ Transform(rotation=np.eye(3), translation_mm=np.array([10.0 * i, 5.0 * i, 780.0]) - middle)
        for i in range(4)
    }
    from mammometry.calibration.adjust.bundle import calibrate
    from mammometry.calibration.judge.quality import assess

    try:
        quality = assess(calibrate(observe({"front_left": camera}, facing), {}, "virtual"))
    except CalibrationError as error:
        assert "front_left" in str(error)  # noqa: PT017
    else:
        assert quality.verdict == "refuse"
        assert "front_left" in {name for notice in quality.refusals for name in notice.about}
