"""Filling loops in a plane."""

import numpy as np
import pytest

from mammometry.measure.solid.patch import fill, harmonic
from mammometry.measure.solid.untangle import self_crossings, signed_area_mm2

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


@pytest.mark.parametrize("spacing_mm", [None, 3.0])
@pytest.mark.parametrize("seed", [1, 2, 5])
def test_a_curve_that_crosses_itself_is_filled_with_its_signed_area(seed: int, spacing_mm: float | None) -> None:
    rng = np.random.default_rng(seed)
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    waves = [rng.normal(0, 25 / order, (4, 2)) for order in range(2, 7)]
    around = sum(
        np.cos(order * angle)[:, None] * wave[0] + np.sin(order * angle)[:, None] * wave[1]
        for order, wave in enumerate(waves, start=2)
    )
    loop = 70 * np.stack([np.cos(angle), np.sin(angle)], axis=1) + around + FAR
    assert len(self_crossings(loop))
    assert signed_area_mm2(loop) > 0
    patch = fill((loop,), spacing_mm)
    assert patch.area_mm2() == pytest.approx(signed_area_mm2(loop), rel=1e-9)
    assert np.abs(patch.points[: patch.n_loop] - loop).max() < 1e-9
    directed = patch.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert len(np.unique(directed, axis=0)) == len(directed)  # an oriented surface
    once = {tuple(edge) for edge in directed.tolist()}
    assert {edge for edge in once if edge[::-1] not in once} == {(i, (i + 1) % len(loop)) for i in range(len(loop))}


@pytest.mark.slow
def test_a_curve_that_comes_to_cross_itself_changes_its_filling_little() -> None:
    """What lies over a fold of the curve goes through the crossing smoothly."""
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    volumes, crossings = [], []
    for lean in np.linspace(0.0, 1.2, 9):
        loop = 60 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        bump = np.exp(-((angle - np.pi / 2) ** 2) / 0.02)
        loop += 25 * bump[:, None] * np.stack([lean * np.sin((angle - np.pi / 2) * 9), np.ones(400)], axis=1)
        crossings.append(self_crossings(loop))
        patch = fill((loop,), 2.5)
        height = harmonic(patch, np.sin(2 * angle)[:, None] * 10 + loop[:, :1] / 3 + 40)[:, 0]
        a, b, c = np.moveaxis(patch.points[patch.faces], 1, 0)
        area = np.cross(np.c_[b - a, 0 * a[:, 0]], np.c_[c - a, 0 * a[:, 0]])[:, 2] / 2
        volumes.append(float(area @ height[patch.faces].mean(axis=1)) / 1000)
    assert not len(crossings[0])
    assert len(crossings[-1])
    steps = np.diff(volumes)
    assert np.abs(steps - steps.mean()).max() < 0.3  # cc, of some 500


def test_harmonic_values_reproduce_harmonic_functions() -> None:
    patch = fill((star(),), 2.0)
    x, y = (patch.points - FAR).T
    exact = np.stack([3 + 2 * x - y, x**2 - y**2], axis=1)
    found = harmonic(patch, exact[: patch.n_loop])
    assert np.abs(found[:, 0] - exact[:, 0]).max() < 1e-6  # linear elements hold linear functions
    assert np.abs(found[:, 1] - exact[:, 1]).max() < 2e-3 * np.ptp(exact[:, 1])
