"""Points along closed curves, against a square and a circle."""

import numpy as np
import pytest

from mammometry.geometry.curves import closed_length_mm, evenly_spaced, points_along

SQUARE = np.array([[0.0, 0.0, 5.0], [4.0, 0.0, 5.0], [4.0, 4.0, 5.0], [0.0, 4.0, 5.0]])


def test_the_last_side_counts():
    assert closed_length_mm(SQUARE) == pytest.approx(16.0)


def test_points_lie_where_the_distance_along_a_square_says():
    found = points_along(SQUARE, np.array([0.0, 1.0, 6.0, 15.0]))
    np.testing.assert_allclose(found, [[0, 0, 5], [1, 0, 5], [4, 2, 5], [0, 1, 5]], atol=1e-12)


def test_points_of_a_circle_are_evenly_spaced_though_its_corners_are_not():
    turn = 2 * np.pi * np.linspace(0, 1, 2000, endpoint=False) ** 2
    found = evenly_spaced(50.0 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1), 12)
    wanted = 2 * np.pi * np.arange(12) / 12
    np.testing.assert_allclose(found, 50.0 * np.stack([np.cos(wanted), np.sin(wanted), 0 * wanted], axis=1), atol=0.01)
