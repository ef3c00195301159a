"""Compiled projection against the camera's own."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mammometry.geometry.camera import Camera
from mammometry.geometry.projection import projected
from mammometry.geometry.transform import Transform


def camera(seed: int) -> Camera:
    random = np.random.default_rng(seed)
    rotation, _ = np.linalg.qr(random.normal(size=(3, 3)))
    return Camera(
        name="front_left",
        size_wh=(4504, 3000),
        matrix=np.array([[6000.0, 0.0, 2251.5], [0.0, 6010.0, 1499.5], [0.0, 0.0, 1.0]]),
        distortion=random.normal(0, [0.1, 0.05, 1e-3, 1e-3, 0.01]),
        camera_from_world=Transform(
            rotation=rotation * np.sign(np.linalg.det(rotation)), translation_mm=random.normal(0, 300, 3)
        ),
    )


@given(seed=st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_many_points_fall_where_the_camera_sees_each(seed: int) -> None:
    seen_by = camera(seed)
    points = np.random.default_rng(seed + 1).normal(0, 400, (500, 3))
    found, expected = projected(seen_by, points), seen_by.project(points)
    np.testing.assert_array_equal(np.isnan(found[:, 0]), np.isnan(expected[:, 0]))
    # Sums of three products in another order: 1e-12 of the pixels' size, which lenses enlarge at wide angles.
    np.testing.assert_allclose(found[:, :2], expected, rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(found[:, 2], seen_by.camera_from_world.apply(points)[:, 2], atol=1e-9)


def test_what_is_not_in_front_has_no_pixel() -> None:
    seen_by = camera(3)
    behind = seen_by.centre_world - 100.0 * seen_by.axis_world
    column, row, depth = projected(seen_by, np.stack([behind, seen_by.centre_world + 100.0 * seen_by.axis_world])).T
    assert np.isnan([column[0], row[0]]).all()
    assert depth == pytest.approx([-100.0, 100.0])
    assert (column[1], row[1]) == pytest.approx((2251.5, 1499.5))


def test_no_points_give_none() -> None:
    assert projected(camera(1), np.empty((0, 3))).shape == (0, 3)
