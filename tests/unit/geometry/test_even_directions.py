"""Directions spread evenly over the sphere."""

import numpy as np

from mammometry.geometry.directions import even_directions


def test_directions_are_spread_evenly() -> None:
    directions = even_directions(500)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    np.testing.assert_allclose(directions.mean(axis=0), 0.0, atol=2e-3)
    nearest = np.sort(np.arccos((directions @ directions.T - 2 * np.eye(500)).max(axis=1)))
    assert nearest[-1] < 1.6 * nearest[0]
