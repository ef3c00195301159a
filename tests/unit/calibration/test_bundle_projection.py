"""The adjustment's camera against `geometry.camera` and its derivatives against central differences."""

import numpy as np

from mammometry.calibration.adjust.projection import INTRINSIC_NAMES, project, project_with_derivatives
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform

INTRINSICS = np.array([2010.0, 2004.0, 570.0, 371.0, -0.06, 0.2, 3e-4, -2e-4, 0.05, 0.7])
RNG = np.random.default_rng(5)
POINTS = np.column_stack([RNG.uniform(-200, 200, 40), RNG.uniform(-150, 150, 40), RNG.uniform(600, 900, 40)])


def test_same_camera_as_geometry() -> None:
    fx, fy, cx, cy = INTRINSICS[:4]
    camera = Camera(
        name="c",
        size_wh=(1126, 750),
        matrix=np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]),
        distortion=INTRINSICS[4:9],
        camera_from_world=Transform.identity(),
    )
    many = np.tile([*INTRINSICS[:9], 0.0], (len(POINTS), 1))
    np.testing.assert_allclose(project(POINTS, many), camera.project(POINTS), atol=1e-9)
    np.testing.assert_allclose(project_with_derivatives(POINTS, many).uv, camera.project(POINTS), atol=1e-9)


def test_derivatives_by_the_point() -> None:
    many = np.tile(INTRINSICS, (len(POINTS), 1))
    by_point = project_with_derivatives(POINTS, many).by_point
    for axis in range(3):
        h = np.eye(3)[axis] * 1e-3  # third derivatives are below 1e-6 px/mm³: the difference is good to 1e-8
        difference = (project(POINTS + h, many) - project(POINTS - h, many)) / 2e-3
        np.testing.assert_allclose(by_point[:, :, axis], difference, atol=1e-7)


def test_derivatives_by_the_intrinsics_in_the_order_of_their_names() -> None:
    many = np.tile(INTRINSICS, (len(POINTS), 1))
    by_intrinsics = project_with_derivatives(POINTS, many).by_intrinsics
    for index, name in enumerate(INTRINSIC_NAMES):
        h = np.zeros(10)
        h[index] = 1e-2 if name.endswith("px") else 1e-5  # linear in each of them: only rounding limits this
        difference = (project(POINTS, many + h) - project(POINTS, many - h)) / (2 * h[index])
        np.testing.assert_allclose(by_intrinsics[:, :, index], difference, atol=1e-6, err_msg=name)


def plain_projection(points: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """The model written out once more, for complex numbers."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3, skew = intrinsics
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return np.stack([fx * u + skew * v + cx, fy * v + cy], axis=1)


def test_derivatives_by_complex_step() -> None:
    """An imaginary step of 1e-30 gives derivatives to the last digit: no difference is taken (Squire, Trapp 1998)."""
    exact = project_with_derivatives(POINTS, np.tile(INTRINSICS, (len(POINTS), 1)))
    np.testing.assert_allclose(exact.uv, plain_projection(POINTS, INTRINSICS), rtol=1e-12)
    for axis in range(3):
        slope = plain_projection(POINTS + 1e-30j * np.eye(3)[axis], INTRINSICS).imag / 1e-30
        np.testing.assert_allclose(exact.by_point[:, :, axis], slope, rtol=1e-11, atol=1e-12)
    for index in range(len(INTRINSIC_NAMES)):
        slope = plain_projection(POINTS, INTRINSICS + 1e-30j * np.eye(10)[index]).imag / 1e-30
        np.testing.assert_allclose(exact.by_intrinsics[:, :, index], slope, rtol=1e-11, atol=1e-12)
