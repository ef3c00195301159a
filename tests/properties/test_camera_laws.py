"""Projection and its inverse, with OpenCV as oracle.

OpenCV's own `projectPoints` is float64 throughout: agreement to 1e-8 px of a picture up to 4504 px wide is round-off.
"""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import cameras

from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.lens import distort, undistort
from mammometry.geometry.transform import Transform

ROUND_OFF_PX = 1e-7
"""Newton stops at 1e-13 in normalised coordinates; times a focal length of up to 9000 px, and a margin of a hundred."""


def pixels_of(camera: Camera, seed: int, n: int = 40) -> np.ndarray:
    """Pixels all over the photograph, corners included."""
    width, height = camera.size_wh
    inside = np.random.default_rng(seed).uniform((0, 0), (width - 1, height - 1), (n, 2))
    corners = np.array([(0, 0), (width - 1, 0), (0, height - 1), (width - 1, height - 1)], dtype=np.float64)
    return np.r_[inside, corners]


def points_seen_by(camera: Camera, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """World points 200 mm to 2 m in front of the camera, and the pixels they were cast through."""
    uv = pixels_of(camera, seed)
    distance_mm = np.random.default_rng(seed + 1).uniform(200.0, 2000.0, (len(uv), 1))
    return camera.centre_world + camera.rays_world(uv) * distance_mm, uv


@given(cameras(), st.integers(0, 1000))
def test_a_point_along_the_ray_of_a_pixel_projects_to_that_pixel(camera: Camera, seed: int) -> None:
    points_world, uv = points_seen_by(camera, seed)
    np.testing.assert_allclose(camera.project(points_world), uv, atol=ROUND_OFF_PX, rtol=0)


@given(cameras(), st.integers(0, 1000))
def test_projection_is_opencvs(camera: Camera, seed: int) -> None:
    points_world, _ = points_seen_by(camera, seed)
    pose = camera.camera_from_world
    oracle = cv2.projectPoints(
        points_world,
        pose.rotation_vector_rad.reshape(3, 1),
        pose.translation_mm.reshape(3, 1),
        camera.matrix.copy(),
        camera.distortion.copy(),
    )[0].reshape(-1, 2)
    np.testing.assert_allclose(camera.project(points_world), oracle, atol=ROUND_OFF_PX, rtol=0)


@given(cameras(), st.integers(0, 1000))
def test_undistortion_is_opencvs_iterated_to_convergence(camera: Camera, seed: int) -> None:
    uv = pixels_of(camera, seed)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-14)
    oracle = cv2.undistortPoints(
        uv.reshape(-1, 1, 2), camera.matrix.copy(), camera.distortion.copy(), criteria=criteria
    ).reshape(-1, 2)
    np.testing.assert_allclose(camera.normalised_from_pixels(uv), oracle, atol=1e-9)


@given(cameras(), st.integers(0, 1000))
def test_rays_are_unit_and_leave_the_perspective_centre(camera: Camera, seed: int) -> None:
    rays = camera.rays_world(pixels_of(camera, seed))
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0, atol=1e-12)
    assert (rays @ camera.axis_world > 0).all()
    np.testing.assert_allclose(camera.camera_from_world.apply(camera.centre_world), 0.0, atol=1e-9)


@given(cameras(), st.integers(0, 1000))
def test_the_range_along_a_ray_is_the_distance_and_not_the_depth(camera: Camera, seed: int) -> None:
    uv = pixels_of(camera, seed)
    range_mm = 700.0
    points_world = camera.centre_world + camera.rays_world(uv) * range_mm
    np.testing.assert_allclose(np.linalg.norm(points_world - camera.centre_world, axis=1), range_mm, atol=1e-9)
    depth_mm = camera.camera_from_world.apply(points_world)[:, 2]
    assert (depth_mm <= range_mm + 1e-9).all()
    assert depth_mm.min() < range_mm - 10.0  # at the corners of a 30° picture the two differ by centimetres


@pytest.fixture
def camera() -> Camera:
    return Camera(
        name="plain",
        size_wh=(640, 480),
        matrix=np.array([[800.0, 0.0, 320.0], [0.0, 800.0, 240.0], [0.0, 0.0, 1.0]]),
        distortion=np.zeros(5),
        camera_from_world=Transform.identity(),
    )


def test_x_is_right_y_is_down_z_is_forward_and_pixels_are_column_row(camera: Camera) -> None:
    uv = camera.project(np.array([[0.0, 0.0, 1000.0], [100.0, 0.0, 1000.0], [0.0, 100.0, 1000.0]]))
    np.testing.assert_allclose(uv, [(320.0, 240.0), (400.0, 240.0), (320.0, 320.0)])
    assert camera.shape_hw == (480, 640)


def test_what_is_behind_the_camera_has_no_pixel(camera: Camera) -> None:
    uv = camera.project(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    assert np.isnan(uv[:2]).all()
    assert np.isfinite(uv[2]).all()


def test_barrel_distortion_moves_points_inwards_and_pincushion_outwards() -> None:
    xy = np.array([[0.3, 0.2]])
    barrel = distort(xy, np.array([-0.2, 0.0, 0.0, 0.0, 0.0]))
    pincushion = distort(xy, np.array([0.2, 0.0, 0.0, 0.0, 0.0]))
    r2 = 0.3**2 + 0.2**2
    np.testing.assert_allclose(barrel, xy * (1 - 0.2 * r2), atol=1e-15)
    np.testing.assert_allclose(pincushion, xy * (1 + 0.2 * r2), atol=1e-15)


def test_arrays_given_are_not_changed_and_values_cannot_be_written(camera: Camera) -> None:
    xy = np.array([[0.3, 0.2]])
    undistort(xy, np.array([-0.2, 0.1, 0.001, 0.0, 0.0]))
    undistort(xy, np.zeros(5))[0, 0] = 9.0
    np.testing.assert_array_equal(xy, [[0.3, 0.2]])
    with pytest.raises(ValueError, match="read-only"):
        camera.matrix[0, 0] = 1.0


def test_a_camera_that_looks_through_its_back_is_refused(camera: Camera) -> None:
    with pytest.raises(ValueError, match="focal"):
        Camera(
            name="mirror",
            size_wh=camera.size_wh,
            matrix=np.diag([-800.0, 800.0, 1.0]),
            distortion=camera.distortion,
            camera_from_world=camera.camera_from_world,
        )


def test_a_rig_keeps_its_order_and_refuses_pairs_it_cannot_make(camera: Camera) -> None:
    cameras_by_name = {"a": camera, "b": camera, "c": camera}
    rig = Rig(name="three", cameras=cameras_by_name, pair_names={"second": ("b", "c"), "first": ("a", "b")})
    assert [pair.name for pair in rig.pairs] == ["second", "first"]
    assert rig.pair("first").left is camera
    with pytest.raises(TypeError):
        rig.cameras["d"] = camera  # type: ignore[index]
    cameras_by_name.clear()
    assert len(rig.cameras) == 3
    with pytest.raises(ValueError, match="two"):
        Rig(name="one", cameras={"a": camera}, pair_names={"self": ("a", "a")})
    with pytest.raises(ValueError, match="'z'"):
        Rig(name="one", cameras={"a": camera}, pair_names={"lost": ("a", "z")})
