"""What may be the body in a walk's photographs: near measured skin, and nothing else."""

import numpy as np
import pytest

from mammometry.geometry import Camera, Rig, Transform
from mammometry.matching.foreground.foreground import Foreground
from mammometry.surface.ranges.range_image import RangeImage
from mammometry.walk.outlines import outlines

FOCAL_PX, DISTANCE_MM, RADIUS_MM = 400.0, 500.0, 60.0
REACH_PX = 30.0 * FOCAL_PX / DISTANCE_MM  # the reach of 30 mm, as seen at the skin's distance
CELLS_PX = 8.0  # the outline is computed in cells of 4 pixels, from one to the other


def camera(name: str, x_mm: float = 0.0) -> Camera:
    return Camera(
        name=name,
        size_wh=(400, 300),
        matrix=np.array([[FOCAL_PX, 0.0, 199.5], [0.0, FOCAL_PX, 149.5], [0.0, 0.0, 1.0]]),
        distortion=np.zeros(5),
        camera_from_world=Transform(rotation=np.eye(3), translation_mm=np.array([-x_mm, 0.0, DISTANCE_MM])),
    )


def ring(inner_mm: float) -> RangeImage:
    """A flat ring of skin in the plane z = 0."""
    own = camera("pair")
    row, column = np.mgrid[:300, :400]
    x, y = (column - 199.5) / FOCAL_PX * DISTANCE_MM, (row - 149.5) / FOCAL_PX * DISTANCE_MM
    from_axis_mm = np.hypot(x, y)
    valid = (from_axis_mm <= RADIUS_MM) & (from_axis_mm >= inner_mm)
    range_mm = np.where(valid, np.sqrt(from_axis_mm**2 + DISTANCE_MM**2), 0.0).astype(np.float32)
    even = valid.astype(np.float32)
    return RangeImage(name="pair", camera=own, range_mm=range_mm, valid=valid, sigma_mm=even, confidence=even)


@pytest.fixture
def given() -> Foreground:
    coverage = np.ones((300, 400), dtype=np.float32)
    coverage[:100] = 0.0  # the upper third is outside the region
    return Foreground(camera="b", coverage=coverage, contour_level=0.5, everything=False)


@pytest.mark.parametrize("inner_mm", [0.0, 45.0])
def test_the_outline_is_measured_skin_and_its_surroundings_without_holes(given: Foreground, inner_mm: float) -> None:
    seen = camera("b", x_mm=80.0)
    found = outlines([ring(inner_mm)], {"b": given}, Rig(name="walk", cameras={"b": seen}, pair_names={}))["b"]
    row, column = np.mgrid[:300, :400]
    middle = seen.project(np.zeros((1, 3)))[0]
    away_px = np.hypot(column - middle[0], row - middle[1])
    radius_px = RADIUS_MM * FOCAL_PX / DISTANCE_MM + REACH_PX
    lower = row >= 100
    assert found.mask[lower & (away_px < radius_px - CELLS_PX)].all()
    assert not found.mask[away_px > radius_px + CELLS_PX].any()
    assert not found.mask[~lower].any()


def test_a_photograph_that_shows_no_measured_skin_keeps_its_mask(given: Foreground) -> None:
    away = camera("b", x_mm=2000.0)
    found = outlines([ring(0.0)], {"b": given}, Rig(name="walk", cameras={"b": away}, pair_names={}))["b"]
    np.testing.assert_array_equal(found.mask, given.mask)
