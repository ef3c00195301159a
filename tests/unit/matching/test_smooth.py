import numpy as np
import pytest

from mammometry.matching.dense.plane_smoothing import adaptively_smooth, difference_noise, fill, plane_fit, smooth
from mammometry.matching.filters import gaussian_taps

V, U = np.mgrid[:60, :70].astype(np.float32)


def test_planes_pass_unchanged_whatever_the_weights() -> None:
    weights = np.random.default_rng(0).uniform(0.1, 5, U.shape).astype(np.float32)
    plane = (0.3 * U - 0.2 * V + 4).astype(np.float32)
    # The damping of one-sided windows leaves 4e-4 of the slope's step at the borders after twicing.
    np.testing.assert_allclose(smooth(plane, weights, 3.0)[9:-9, 9:-9], plane[9:-9, 9:-9], atol=3e-3)


def test_twicing_takes_away_the_pull_of_plain_smoothing() -> None:
    """A Gaussian mean lifts c·x² by c·σ²; twiced, a quadratic passes as it is."""
    bowl = (0.01 * (U - 35) ** 2).astype(np.float32)
    ones = np.ones_like(bowl)
    taps = gaussian_taps(3.0)
    spread = float((taps * np.arange(-9, 10) ** 2).sum())
    planes = np.empty((5, *bowl.shape), dtype=np.float32)
    plane_fit(bowl, ones, taps, planes)
    plain = planes[0]
    middle = (slice(25, 35), slice(28, 42))
    np.testing.assert_allclose((plain - bowl)[middle], 0.01 * spread, rtol=0.02)
    assert np.abs(smooth(bowl, ones, 3.0) - bowl)[middle].max() < 0.02 * 0.01 * spread


def test_gaps_are_bridged_and_the_outside_filled() -> None:
    plane = (0.1 * U).astype(np.float32)
    weights = np.ones_like(plane)
    weights[20:30, 20:30] = 0
    weights[:, 60:] = 0
    spoiled = np.where(weights > 0, plane, 99).astype(np.float32)
    result = smooth(spoiled, weights, 4.5)
    assert np.isfinite(result).all()
    assert np.abs(result - plane)[20:30, 20:30].max() < 0.1
    assert result[:, 60:].max() < 8


def test_filling_keeps_what_is_known() -> None:
    values = np.where(U < 30, 2.0, -5.0).astype(np.float32)
    known = (U < 30).astype(np.float32)
    filled = fill(values, known)
    np.testing.assert_array_equal(filled[U < 30], 2.0)
    np.testing.assert_allclose(filled[U >= 30], 2.0, atol=1e-4)


def test_the_noise_of_a_difference_of_smoothings_is_as_predicted() -> None:
    rng = np.random.default_rng(1)
    taps = gaussian_taps(2.5)
    noise = rng.normal(size=(300, 300))
    for axis in (0, 1):
        noise = np.apply_along_axis(np.convolve, axis, noise, taps, mode="same")
    noise = (noise / noise[20:-20, 20:-20].std()).astype(np.float32)
    ones = np.ones_like(noise)
    found = (smooth(noise, ones, 2.5) - smooth(noise, ones, 4.0))[40:-40, 40:-40].var()
    # 220² pixels hold about 220² / (4π·4²) ≈ 240 independent patches: 10 % standard error of a variance.
    assert found == pytest.approx(difference_noise(2.5, 4.0, 2.5), rel=0.3)


def test_relief_stays_and_noise_goes() -> None:
    rng = np.random.default_rng(2)
    relief = np.where(U > 35, np.sin(2 * np.pi * U / 14), 0).astype(np.float32)  # a fine relief on one half
    noisy = (relief + rng.normal(0, 0.1, U.shape)).astype(np.float32)
    ones = np.ones_like(relief)
    result, expected = adaptively_smooth(noisy, ones, 0.01 * ones, 0.4, (2.5, 4.0, 6.4, 10.2), 3.0)
    inner = (slice(10, -10), slice(10, -10))
    flat = (U < 22)[inner]
    rough = (U > 44)[inner]
    assert (result - relief)[inner][flat].std() < 0.015
    # The predicted deviation is that of the errors, where there is only noise; where relief is lost it is larger.
    assert 0.5 < (result - relief)[inner][flat].std() / np.sqrt(expected[inner][flat].mean()) < 2
    assert expected[inner][rough].mean() > expected[inner][flat].mean()
    # The finest scale, 2.5, passes 2 G − G² = .78 of a wave of 14 px; the coarsest would pass nothing of it.
    assert (result - relief)[inner][rough].std() < 1.2 * (1 - 0.78) / np.sqrt(2)
    assert smooth(noisy, ones, 10.2)[inner][rough].std() < 0.1
