"""Sphere and plane fits against closed form and scipy, widths, and uncertainties by leaving cells out."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.optimize import least_squares

from mammometry.study.acceptance.fits import (
    fit_plane,
    fit_sphere,
    jackknife_std,
    narrowest_width,
    sphere_shifts,
    width_shifts,
    within_rule,
)


def cap(rng: np.random.Generator, count: int = 400, noise_mm: float = 0.0) -> np.ndarray:
    """Points of the front of a ball of 50 mm radius."""
    out = rng.normal(size=(count, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    out[:, 2] = np.abs(out[:, 2])
    return out * (50.0 + noise_mm * rng.normal(size=(count, 1))) + np.array([300.0, -20.0, 800.0])


@pytest.mark.requirement("R-ACCEPT-1")
@settings(deadline=None, max_examples=20)
@given(st.floats(5.0, 200.0), st.integers(0, 1000))
def test_an_exact_sphere_is_found_exactly(radius: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = (cap(rng, 60) - [300.0, -20.0, 800.0]) * radius / 50.0 + [1.0, 2.0, 3.0]
    fit = fit_sphere(points, rng.uniform(0.5, 2.0, len(points)))
    assert fit.radius_mm == pytest.approx(radius, abs=1e-8 * radius)
    np.testing.assert_allclose(fit.centre, [1.0, 2.0, 3.0], atol=1e-8 * radius)


@pytest.mark.requirement("R-ACCEPT-1")
def test_the_sphere_agrees_with_scipy() -> None:
    rng = np.random.default_rng(3)
    points, weights = cap(rng, noise_mm=0.5), rng.uniform(0.2, 3.0, 400)

    def rest(unknowns: np.ndarray) -> np.ndarray:
        return np.sqrt(weights) * (np.linalg.norm(points - unknowns[:3], axis=1) - unknowns[3])

    known = least_squares(rest, [300.0, -20.0, 800.0, 50.0], xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    fit = fit_sphere(points, weights)
    np.testing.assert_allclose([*fit.centre, fit.radius_mm], known, atol=1e-6)


@pytest.mark.requirement("R-ACCEPT-1")
def test_the_plane_agrees_with_scipy_and_closed_form() -> None:
    rng = np.random.default_rng(4)
    x, y = rng.uniform(-100, 100, (2, 500))
    weights = rng.uniform(0.2, 3.0, 500)
    points = np.stack([x, y, 0.3 * x - 0.2 * y + 40.0 + rng.normal(0, 0.4, 500)], axis=1)

    def rest(unknowns: np.ndarray) -> np.ndarray:
        normal = np.array([*unknowns[:2], 1.0])
        return np.sqrt(weights) * (points @ normal - unknowns[2]) / np.linalg.norm(normal)

    a, b, d = least_squares(rest, [0.0, 0.0, 0.0], xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    fit = fit_plane(points, weights, np.array([0.0, 0.0, -1.0]))
    assert fit.normal[2] < 0
    np.testing.assert_allclose(fit.normal / fit.normal[2], [a, b, 1.0], atol=1e-7)
    assert fit.point @ np.array([a, b, 1.0]) == pytest.approx(d, abs=1e-6)
    exact = np.stack([x, y, 0.3 * x - 0.2 * y + 40.0], axis=1)
    np.testing.assert_allclose(fit_plane(exact, weights, fit.normal).deviations(exact), 0.0, atol=1e-10)


def test_the_narrowest_width_of_uniform_numbers_is_their_share() -> None:
    ordered = np.linspace(0.0, 1.0, 1001)
    assert narrowest_width(ordered, np.ones(1001), 0.95) == pytest.approx(0.95, abs=0.002)
    assert narrowest_width(np.append(ordered, 50.0), np.ones(1002), 0.95) == pytest.approx(0.95, abs=0.003)
    # a point that stands for half of the weight is in every interval
    assert narrowest_width(np.array([0.0, 1.0, 9.0]), np.array([5.0, 4.0, 1.0]), 0.9) == 1.0


def test_three_per_mille_are_left_out_and_no_more() -> None:
    deviations = np.random.default_rng(0).normal(0, 0.1, 2000)
    deviations[:20] = 30.0
    kept = within_rule(deviations)
    assert (~kept).sum() == 6
    assert not kept[:20].all()
    assert within_rule(deviations[:300]).all()


def test_the_jackknife_of_a_mean_is_its_standard_error() -> None:
    values = np.random.default_rng(1).normal(size=400)
    without = (values.sum() - values) / 399
    expected = values.std(ddof=1) / 20.0 * stats.t.ppf(0.975, 399) / stats.norm.ppf(0.975)
    assert jackknife_std([without[:, None]])[0] == pytest.approx(expected, rel=1e-9)
    assert jackknife_std([without[:, None], np.full((2, 1), without[0])])[0] == pytest.approx(expected, rel=1e-9)


def test_few_cells_give_an_uncertainty_that_still_holds() -> None:
    """Means of seven normal numbers: the factor of Student makes two standard uncertainties hold in 95 %."""
    rng = np.random.default_rng(2)
    held = 0
    for _ in range(2000):
        values = rng.normal(size=7)
        std = jackknife_std([((values.sum() - values) / 6)[:, None]])[0]
        held += abs(values.mean()) <= 1.96 * std
    assert held / 2000 == pytest.approx(0.95, abs=0.015)  # three standard errors of the share


def test_leaving_a_cell_out_is_fitting_without_it() -> None:
    rng = np.random.default_rng(5)
    points, weights, cells = cap(rng, noise_mm=0.1), rng.uniform(0.5, 2.0, 400), np.arange(400) % 10
    fit = fit_sphere(points, weights)
    shifts = sphere_shifts(fit, points, weights, cells)
    deviations = fit.deviations(points)
    widths = width_shifts(deviations, weights, cells, 0.95)
    for cell in range(10):
        used = cells != cell
        other = fit_sphere(points[used], weights[used])
        np.testing.assert_allclose(
            shifts[cell], [*(other.centre - fit.centre), other.radius_mm - fit.radius_mm], atol=1e-3
        )
        assert widths[cell, 0] == pytest.approx(narrowest_width(deviations[used], weights[used], 0.95))
