"""Filling loops in a plane."""

import numpy as np
import pytest

from mammometry.base.errors import MeasureError
from mammometry.measure.solid.patch import fill, harmonic, signed_area_mm2

FAR = np.array([1e4, -2e4])


def star(n: int = 300, depth: float = 0.3) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    radius = 50 * (1 + depth * np.sin(5 * angle))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1) + FAR


@pytest.mark.parametrize("spacing_mm", [None, 1.0, 7.0])
def test_a_patch_covers_its_loop_and_keeps_it(spacing_mm: float | None) -> None:
    loop = star()
    patch = fill((loop,), spacing_mm)
    assert patch.area_mm2() == pytest.approx(signed_area_mm2(loop), rel=1e-12)
    assert np.array_equal(patch.points[: patch.n_loop], loop)
    edges = np.sort(patch.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    rim = unique[count == 1]
    assert len(rim) == len(loop)  # the loop's own edges and no others
    assert set(map(tuple, rim)) == {tuple(sorted((i, (i + 1) % len(loop)))) for i in range(len(loop))}


def test_a_hole_stays_open() -> None:
    outer = star(depth=0.0)
    hole = (outer - outer.mean(axis=0))[::-1] / 3 + outer.mean(axis=0)
    patch = fill((outer, hole), 3.0)
    assert patch.area_mm2() == pytest.approx(signed_area_mm2(outer) + signed_area_mm2(hole), rel=1e-12)
    assert np.linalg.norm(patch.points - outer.mean(axis=0), axis=1).min() > 50 / 3 - 1e-6


def test_a_curve_that_crosses_itself_is_refused() -> None:
    angle = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    eight = np.stack([50 * np.cos(angle) + 30 * np.cos(2 * angle), 40 * np.sin(2 * angle)], axis=1)
    with pytest.raises(MeasureError, match="crosses itself"):
        fill((eight,), None)


def test_harmonic_values_reproduce_harmonic_functions() -> None:
    patch = fill((star(),), 2.0)
    x, y = (patch.points - FAR).T
    exact = np.stack([3 + 2 * x - y, x**2 - y**2], axis=1)
    found = harmonic(patch, exact[: patch.n_loop])
    assert np.abs(found[:, 0] - exact[:, 0]).max() < 1e-6  # linear elements hold linear functions
    assert np.abs(found[:, 1] - exact[:, 1]).max() < 2e-3 * np.ptp(exact[:, 1])
