"""The image filters against SciPy and NumPy."""

import numpy as np
import pytest
from scipy import ndimage

from mammometry.matching.filters import (
    blur,
    continue_outside,
    double,
    from_blocks,
    gaussian_taps,
    halve,
    pull,
    push,
    rim,
    squared_slope,
)
from mammometry.matching.pyramid import BINOMIAL, HALF_BAND

SHAPES = [(24, 31), (17, 40), (3, 5)]


def image(shape: tuple[int, int], seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("sigma", [0.8, 2.5, 6.0])
def test_blur_is_scipys(shape: tuple[int, int], sigma: float) -> None:
    values, taps = image(shape), gaussian_taps(sigma)
    expected = ndimage.correlate1d(values.astype(np.float64), taps.astype(np.float64), axis=0, mode="nearest")
    expected = ndimage.correlate1d(expected, taps.astype(np.float64), axis=1, mode="nearest")
    np.testing.assert_allclose(blur(values, taps), expected, atol=2e-6)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("taps", [HALF_BAND, BINOMIAL], ids=["half-band", "binomial"])
def test_halving_is_a_strided_correlation(shape: tuple[int, int], taps: np.ndarray) -> None:
    values = image(shape)
    expected = values.astype(np.float64)
    for _ in range(2):
        reach = len(taps) // 2 - 1
        padded = np.pad(expected, ((reach, reach + 2), (0, 0)), mode="edge")
        count = (expected.shape[0] + 1) // 2
        expected = sum(float(tap) * padded[k : k + 2 * count : 2][:count] for k, tap in enumerate(taps)).T
    np.testing.assert_allclose(halve(values, taps), expected, atol=3e-6)


@pytest.mark.parametrize(("shape", "fine"), [((8, 9), (16, 18)), ((8, 9), (15, 17)), ((2, 3), (4, 5))])
def test_doubling_is_linear_interpolation_between_centres(shape: tuple[int, int], fine: tuple[int, int]) -> None:
    values = image(shape)
    v, u = np.meshgrid(*((np.arange(n) + 0.5) / 2 - 0.5 for n in fine), indexing="ij")
    expected = ndimage.map_coordinates(values.astype(np.float64), [v, u], order=1, mode="nearest")
    np.testing.assert_allclose(double(values, *fine, np.inf), expected, atol=2e-6)
    nearest = np.repeat(np.repeat(values, 2, axis=0), 2, axis=1)[: fine[0], : fine[1]]
    kept = np.where(np.abs(expected - nearest) < 0.3, expected, nearest)
    np.testing.assert_allclose(double(values, *fine, 0.3), kept, atol=2e-6)


@pytest.mark.parametrize("shape", [(8, 12), (7, 11)])
def test_pull_and_push_average_blocks_and_give_them_back(shape: tuple[int, int]) -> None:
    values, weights = image(shape), np.maximum(image(shape, 1), 0)
    means, mass = pull(values, weights)
    for i, j in np.ndindex(means.shape):
        block = (slice(2 * i, 2 * i + 2), slice(2 * j, 2 * j + 2))
        assert mass[i, j] == pytest.approx(weights[block].sum(), rel=1e-5)
        expected = np.average(values[block], weights=weights[block]) if weights[block].any() else 0.0
        assert means[i, j] == pytest.approx(expected, abs=1e-5)
    repeated = np.repeat(np.repeat(means, 2, axis=0), 2, axis=1)[: shape[0], : shape[1]].astype(np.float64)
    spread = ndimage.uniform_filter(repeated, 3, mode="nearest")
    np.testing.assert_allclose(push(values, weights, means), np.where(weights > 0, values, spread), atol=2e-6)


def test_a_quadratic_comes_back_from_the_means_of_its_blocks() -> None:
    v, u = np.mgrid[:20, :26].astype(np.float64)
    field = 0.01 * u**2 - 0.02 * u * v + 0.007 * v**2 + 0.3 * u - 0.1 * v + 2
    means, _ = pull(field.astype(np.float32), np.ones(field.shape, dtype=np.float32))
    inner = (slice(2, -2), slice(2, -2))
    np.testing.assert_allclose(from_blocks(means, 20, 26, np.inf)[inner], field[inner], atol=1e-5)


def test_nothing_is_stretched_across_a_jump_of_block_means() -> None:
    step = np.where(np.arange(12) < 6, 0.0, 8.0).astype(np.float32) * np.ones((5, 1), dtype=np.float32)
    np.testing.assert_array_equal(from_blocks(step, 10, 24, 0.5), np.repeat(np.repeat(step, 2, axis=0), 2, axis=1))


@pytest.mark.parametrize("shape", SHAPES)
def test_the_squared_slope_is_numpys_gradients(shape: tuple[int, int]) -> None:
    values = image(shape)
    np.testing.assert_allclose(squared_slope(values), np.hypot(*np.gradient(values)) ** 2, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("radius", [2.0, 6.5])
def test_an_image_is_continued_by_its_normalised_blur(radius: float) -> None:
    values, taps = image((70, 90)), gaussian_taps(radius)
    mask = np.hypot(*(np.mgrid[:70, :90] - np.array([20, 30])[:, None, None])) < 18
    weight, total = mask.astype(np.float64), np.where(mask, values, 0.0).astype(np.float64)
    for axis in (0, 1):
        weight, total = (
            ndimage.correlate1d(a, taps.astype(np.float64), axis=axis, mode="constant") for a in (weight, total)
        )
    expected = np.where(mask, values, (total + 1e-3 * 0.7) / (weight + 1e-3))
    np.testing.assert_allclose(continue_outside(values, mask, taps, 0.7, 1e-3), expected, atol=2e-5)


@pytest.mark.parametrize("shape", [*SHAPES, (1, 7), (60, 80)])
def test_the_rim_is_what_an_erosion_takes_away(shape: tuple[int, int]) -> None:
    values = ndimage.gaussian_filter(image(shape), 0.7)
    above = values >= np.float32(-0.1)
    rows, columns = np.nonzero(above & ~ndimage.binary_erosion(above))  # beyond the border nothing is set
    np.testing.assert_array_equal(rim(values, -0.1), np.stack([columns, rows], axis=1))


def test_what_lies_below_the_level_everywhere_has_no_rim() -> None:
    assert rim(np.zeros((5, 6), dtype=np.float32), 0.4).shape == (0, 2)
