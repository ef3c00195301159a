"""Skin past the edges of data: tangent planes, where skin faces the camera and does not turn away."""

import numpy as np
from spheres import camera_towards, ellipsoid_range, range_image

from mammometry.surface.occlusion import continued_world

TILT = 0.4  # of the plane: slope in x


def plane_seen(slope: float = TILT):
    """A tilted plane before a camera along z, measured in the middle of its picture alone."""
    camera = camera_towards("c0", (0, 0, 1))
    rays = range_image(camera, np.full(camera.shape_hw, 500.0)).ray_directions()
    normal = np.array([-slope, 0.0, 1.0]) / np.hypot(slope, 1.0)
    distance = -(camera.centre_world @ normal) / (rays @ normal)
    height, width = distance.shape
    measured = np.full(distance.shape, np.nan)
    middle = (slice(height // 4, 3 * height // 4), slice(width // 4, 3 * width // 4))
    measured[middle] = distance[middle]
    return camera, normal, range_image(camera, measured)


def test_a_plane_goes_on_past_its_data_as_a_plane():
    camera, normal, image = plane_seen()
    points = continued_world(image)
    assert np.abs(points @ normal).max() < 0.05
    column, row = camera.project(points).round().astype(int).T
    past = ~image.valid[row, column]
    assert past.any()
    rows, columns = np.nonzero(image.valid)
    away = np.maximum.reduce(
        [rows.min() - row[past], row[past] - rows.max(), columns.min() - column[past], column[past] - columns.max()]
    )
    assert away.max() == 6  # half a window


def test_data_beside_an_edge_that_lean_towards_what_hides_change_nothing():
    _, normal, image = plane_seen()
    leaning = np.array(image.range_mm)
    edge = image.valid & ~np.roll(image.valid, -3, axis=0)  # the last three rows
    leaning[edge] -= 4.0
    points = continued_world(range_image(image.camera, np.where(image.valid, leaning, np.nan)))
    assert len(points) == len(continued_world(image))
    assert np.abs(points @ normal).max() < 0.05


def test_skin_that_turns_away_ends_there():
    camera = camera_towards("c0", (0, 0, 1))
    ball = range_image(camera, ellipsoid_range(camera, (30.0,) * 3))
    assert len(continued_world(ball)) < 30  # of a ring of some 1,500 pixels
    assert len(continued_world(plane_seen(slope=2.5)[2])) == 0  # 68° off the normal
