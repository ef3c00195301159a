"""Standard deviations near the edge of what a pair of a walk's photographs measured."""

import numpy as np
import pytest

from mammometry.geometry import Camera, StereoPair, Transform
from mammometry.surface.ranges.range_image import MAX_SIGMA_MM, RangeImage
from mammometry.walk.data_edges import with_edge_errors

SIGMA_MM, SIDE_PX, HOLE, FOCAL_PX, BASELINE_MM, DEPTH_MM = 0.3, 120, (60, 60), 800.0, 200.0, 600.0
PX_MM = DEPTH_MM**2 / (FOCAL_PX * BASELINE_MM)
"""Depth of a pixel of disparity: 2.25 mm."""


def camera(name: str, x_mm: float) -> Camera:
    return Camera(
        name=name,
        size_wh=(SIDE_PX, SIDE_PX),
        matrix=np.array([[FOCAL_PX, 0, 60], [0, FOCAL_PX, 60], [0, 0, 1]]),
        distortion=np.zeros(5),
        camera_from_world=Transform(rotation=np.eye(3), translation_mm=np.array([-x_mm, 0.0, 0.0])),
    )


def plane(baseline_mm: float = BASELINE_MM) -> tuple[RangeImage, StereoPair]:
    """A plane that faces the cameras, with a pixel that was not measured."""
    pair = StereoPair(name="01-02", left=camera("01", 0.0), right=camera("02", baseline_mm))
    valid = np.ones((SIDE_PX, SIDE_PX), dtype=bool)
    valid[HOLE] = False
    rows, columns = np.indices(valid.shape)
    away = np.sqrt(1 + ((columns - 60) / FOCAL_PX) ** 2 + ((rows - 60) / FOCAL_PX) ** 2)
    image = RangeImage(
        name=pair.name,
        camera=pair.left,
        range_mm=np.where(valid, DEPTH_MM * away, 0.0).astype(np.float32),
        sigma_mm=np.where(valid, SIGMA_MM, 0.0).astype(np.float32),
        confidence=valid.astype(np.float32),
        valid=valid,
    )
    return image, pair


def test_the_error_is_a_pixel_at_an_edge_and_falls_off_within_a_window() -> None:
    image, pair = plane()
    found = with_edge_errors(image, pair)
    for place in ((60, 61), (60, 68), (30, 30), (0, 60)):
        to_hole = np.hypot(place[0] - HOLE[0], place[1] - HOLE[1])
        to_border = min(*place, SIDE_PX - 1 - place[0], SIDE_PX - 1 - place[1]) + 1
        away = image.range_mm[place] / DEPTH_MM
        expected = np.hypot(SIGMA_MM, PX_MM * away * np.exp(-min(to_hole, to_border) / 8.0))
        assert found.sigma_mm[place] == pytest.approx(expected, rel=1e-5)
    assert found.sigma_mm[HOLE] == 0.0
    assert found.sigma_mm[30, 30] < 1.02 * SIGMA_MM
    np.testing.assert_array_equal(found.valid, image.valid)
    np.testing.assert_array_equal(found.range_mm, image.range_mm)


def test_data_at_the_edge_are_left_out_where_a_pixel_is_too_much_in_depth() -> None:
    """Half of the baseline: a pixel is 4.5 mm."""
    image, pair = plane(BASELINE_MM / 2)
    found = with_edge_errors(image, pair)
    assert not found.valid[60, 61]
    assert found.valid[60, 68]
    assert found.sigma_mm.max() <= MAX_SIGMA_MM
