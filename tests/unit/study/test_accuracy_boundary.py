"""Distances between circles are known."""

import numpy as np
import pytest

from mammometry.study.evaluation import compare_boundaries, resampled

ANGLES = np.linspace(0, 2 * np.pi, 400, endpoint=False)
CIRCLE = 60.0 * np.stack([np.cos(ANGLES), np.sin(ANGLES), np.zeros_like(ANGLES)], axis=1)
FRONT = np.array([0.1, 0.0, 1.0])


def test_a_wider_circle_that_starts_elsewhere() -> None:
    found = compare_boundaries(np.roll(CIRCLE * 1.05, 77, axis=0)[::-1], CIRCLE, FRONT)
    assert (found.mean_mm, found.p95_mm, found.worst_mm) == pytest.approx((3.0, 3.0, 3.0), abs=0.01)
    assert found.height_bias_mm == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("height", [0.4, -0.4])
def test_a_raised_circle(height: float) -> None:
    found = compare_boundaries(CIRCLE + np.array([0, 0, height]), CIRCLE, FRONT)
    assert found.height_bias_mm == pytest.approx(height)
    assert found.mean_mm == pytest.approx(0.4, abs=0.01)


def test_a_part_that_the_measured_curve_leaves_out_shows_in_the_worst() -> None:
    cut = CIRCLE[1.5 * np.pi > ANGLES]  # three quarters, closed by a chord
    found = compare_boundaries(cut, CIRCLE, FRONT)
    assert found.worst_mm == pytest.approx(60 * (1 - np.cos(np.pi / 4)), abs=0.5)  # the sagitta


def test_points_are_spread_evenly_over_uneven_corners() -> None:
    square = np.array([[0.0, 0, 0], [10, 0, 0], [10, 10, 0], [9, 10, 0], [0, 10, 0]])
    found = resampled(square, 0.5)
    assert len(found) == 80
    assert found[20] == pytest.approx([10, 0, 0])
    assert np.linalg.norm(np.roll(found, -1, axis=0) - found, axis=1) == pytest.approx(0.5)
