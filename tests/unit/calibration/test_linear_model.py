"""Estimates of small motions against the textbook's formulas with dense matrices."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from mammometry.calibration.adjust.linear_model import FREE, linear_model, square_root

UNKNOWNS, COUNTS, SHARED = 7, (9, 14, 8), 3


@pytest.fixture(scope="module")
def observed():
    """Derivatives, values and covariance of their noise, and the model of it: radians beside millimetres."""
    rng = np.random.default_rng(4)
    scale = np.array([1e-4, 1e-4, 1e-4, 0.02, 0.02, 0.02, 3.0])
    noise = [rng.normal(size=(count, count)) + 3 * np.eye(count) for count in COUNTS]
    design, shared = rng.normal(size=(sum(COUNTS), UNKNOWNS)) / scale, rng.normal(size=(sum(COUNTS), SHARED))
    values = design @ (scale * rng.normal(size=UNKNOWNS)) + rng.normal(size=sum(COUNTS))
    covariance, white, log_det, start = shared @ shared.T, [], 0.0, 0
    for root in noise:
        part = slice(start, start + len(root))
        covariance[part, part] += root @ root.T
        white.append(np.linalg.solve(root, np.column_stack([design[part], values[part], shared[part]])))
        log_det += np.linalg.slogdet(root @ root.T)[1]
        start += len(root)
    return design, values, covariance, scale, linear_model(white, UNKNOWNS, log_det=log_det)


@pytest.mark.parametrize("holds", [(), (1, 6)])
def test_free_and_held_unknowns_are_those_of_generalised_least_squares(observed, holds):
    design, values, covariance, _, model = observed
    std = np.full(UNKNOWNS, FREE)
    std[list(holds)] = 0.0
    free = np.flatnonzero(std)
    weight = np.linalg.inv(covariance)
    expected = np.linalg.inv(design[:, free].T @ weight @ design[:, free])
    motions = expected @ design[:, free].T @ weight @ values
    left = values - design[:, free] @ motions
    fit = model.fit(std)
    np.testing.assert_allclose(fit.motions[free], motions, rtol=1e-9)
    np.testing.assert_allclose(
        fit.covariance[np.ix_(free, free)], expected, rtol=1e-8, atol=1e-10 * np.abs(expected).min()
    )
    assert not fit.motions[list(holds)].any()
    assert not fit.covariance[list(holds)].any()
    assert fit.misfit == pytest.approx(left @ weight @ left, rel=1e-9)
    assert fit.freedom == sum(COUNTS) - len(free)


def test_evidence_is_the_probability_of_the_values(observed):
    """Of values whose covariance is that of the noise and of the motions together."""
    design, values, covariance, scale, model = observed
    constant = -0.5 * len(values) * np.log(2 * np.pi)
    for factor in (0.0, 0.3, 2.0):
        std = factor * scale
        std[3] = 0.0
        drawn = design * std
        expected = multivariate_normal(cov=covariance + drawn @ drawn.T).logpdf(values) - constant
        assert model.log_evidence(std[None]) == pytest.approx(expected, abs=1e-8)
        fit = model.fit(std)
        assert fit.log_evidence == pytest.approx(expected, abs=1e-8)
        gain = drawn.T @ np.linalg.inv(covariance + drawn @ drawn.T)
        np.testing.assert_allclose(fit.motions, std * (gain @ values), rtol=1e-8, atol=1e-12)
        after = np.diag(std**2) - std[:, None] * (gain @ drawn) * std
        np.testing.assert_allclose(fit.covariance, after, rtol=1e-6, atol=1e-9 * (std**2).max())


def test_what_is_not_determined_does_not_move():
    """Only the differences of three places are observed: the mean stays 0, and counts as no unknown."""
    rows = np.array([[1.0, -1, 0, 0.5], [0, 1, -1, 0.2], [1, 0, -1, 0.9]])
    fit = linear_model([rows], 3).fit(np.full(3, FREE))
    assert fit.motions.sum() == pytest.approx(0.0, abs=1e-12)
    assert fit.motions[0] - fit.motions[2] == pytest.approx((0.5 + 0.2 + 2 * 0.9) / 3)
    assert fit.freedom == 1
    assert fit.misfit == pytest.approx((0.9 - 0.5 - 0.2) ** 2 / 3)
    np.testing.assert_allclose(fit.covariance.sum(axis=0), 0.0, atol=1e-12)


def test_further_unknowns_are_found_for_any_values_of_the_others(observed):
    *_, model = observed
    std = np.full(UNKNOWNS, FREE)
    std[:2] = 0.0
    further = model.beyond(model.fit(std), slice(0, 2)).fit(np.full(2, FREE))
    both = model.fit(np.full(UNKNOWNS, FREE))
    np.testing.assert_allclose(further.motions, both.motions[:2], rtol=1e-8)
    np.testing.assert_allclose(further.covariance, both.covariance[:2, :2], rtol=1e-8)
    assert further.misfit == pytest.approx(both.misfit, rel=1e-9)
    assert further.freedom == both.freedom


def test_square_root_gives_a_matrix_that_is_singular():
    half = np.random.default_rng(2).normal(size=(6, 4))
    root = square_root(half @ half.T)
    np.testing.assert_allclose(root @ root.T, half @ half.T, atol=1e-12)
