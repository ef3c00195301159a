"""Windows beside depth jumps, against NumPy twins and a step in closed form."""

import numpy as np
import pytest
from scipy import ndimage

from mammometry.matching.correlation_kernels import least_squares
from mammometry.matching.dense.depth_layers import beside_jump, jumps, layered_least_squares, without_specks
from mammometry.matching.filters import gaussian_taps
from mammometry.matching.pyramid import finer_shift

V, U = np.mgrid[:40, :60].astype(np.float32)
STEP = np.where(U < 30, 0.2 * U, 0.2 * U + 8).astype(np.float32)
EVERYWHERE = (V.astype(np.int64).ravel(), U.astype(np.int64).ravel())


def images(seed: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    there, slope, rest = (rng.normal(0, 0.1, U.shape).astype(np.float32) for _ in range(3))
    weight = (rng.uniform(size=U.shape) > 0.2).astype(np.float32)
    return (0.8 * there + 0.3 * slope + 0.1 * rest).astype(np.float32), there, slope, weight


@pytest.mark.parametrize("reach", [1, 4, 8])
def test_pixels_beside_a_jump_are_those_within_reach_of_it(reach: int) -> None:
    found = beside_jump(STEP, np.ones(U.shape, dtype=bool), reach)
    np.testing.assert_array_equal(found, np.abs(U - 29.5) < reach + 1)  # the jump is columns 29 and 30
    half = STEP.copy()
    half[: V.shape[0] // 2] = 0.2 * U[: V.shape[0] // 2]
    distance = ndimage.distance_transform_edt(~jumps(half, np.ones(U.shape, dtype=bool)))
    np.testing.assert_array_equal(beside_jump(half, np.ones(U.shape, dtype=bool), reach), distance <= reach)


def test_a_slope_a_speck_and_the_outline_are_no_jumps() -> None:
    speck = 0.6 * U
    speck[10, 10] += 9
    mask = np.ones(U.shape, dtype=bool)
    assert not beside_jump(speck.astype(np.float32), mask, 5).any()
    assert not beside_jump(STEP, U < 30, 5).any()


def test_jumps_are_those_of_a_masked_range_filter() -> None:
    rng = np.random.default_rng(3)
    shift = (0.8 * rng.normal(size=U.shape)).astype(np.float32)
    mask = rng.uniform(size=U.shape) > 0.3
    highest = ndimage.maximum_filter(np.where(mask, shift, -np.inf), 3, mode="nearest")
    lowest = ndimage.minimum_filter(np.where(mask, shift, np.inf), 3, mode="nearest")
    np.testing.assert_array_equal(jumps(shift, mask), mask & (highest - lowest > np.float32(1.5)))


def test_specks_are_small_connected_components() -> None:
    marks = np.random.default_rng(4).uniform(size=(60, 80)) < 0.22
    labels, count = ndimage.label(marks, structure=np.ones((3, 3)))
    large = np.bincount(labels.ravel(), minlength=count + 1) >= 10
    np.testing.assert_array_equal(without_specks(marks, 10), marks & large[labels])


def test_on_one_surface_a_layers_window_is_the_ordinary_one() -> None:
    given = images(1)
    taps = gaussian_taps(2.5)
    whole = least_squares(*given, taps, 1e-8, (0, U.shape[0]))
    one = layered_least_squares(EVERYWHERE, given, (0.3 * U - 0.1 * V).astype(np.float32), taps, 1e-8)
    for ours, theirs in zip(one, whole, strict=True):
        np.testing.assert_allclose(ours.reshape(U.shape), theirs, rtol=2e-3, atol=2e-3)


def test_a_layers_window_is_a_weighted_regression_over_its_own_side() -> None:
    here, there, slope, weight = images(2)
    taps = gaussian_taps(2.5)
    radius = len(taps) // 2
    found = layered_least_squares(EVERYWHERE, (here, there, slope, weight), STEP, taps, 1e-8).reshape(4, *U.shape)
    padded = [np.pad(a.astype(np.float64), radius) for a in (here, there, slope)]
    for i, j in [(20, 27), (20, 29), (20, 30), (7, 33)]:
        own = weight * ((U < 30) == (j < 30))
        w = np.pad(own.astype(np.float64), radius)[i : i + 2 * radius + 1, j : j + 2 * radius + 1].ravel()
        w = w * np.outer(taps, taps).astype(np.float64).ravel()
        left, right, steep = (a[i : i + 2 * radius + 1, j : j + 2 * radius + 1].ravel() for a in padded)
        root = np.sqrt(w)
        design = np.stack([np.ones_like(right), right, steep], axis=1)
        solution = np.linalg.lstsq(design * root[:, None], left * root, rcond=None)[0]
        assert found[0, i, j] == pytest.approx(solution[2] / solution[1], abs=2e-3)
        assert found[2, i, j] == pytest.approx(w.sum(), rel=1e-4)
        a, b = left - np.average(left, weights=w), right - np.average(right, weights=w)
        zncc = (w * a * b).sum() / np.sqrt((w * a * a).sum() * (w * b * b).sum())
        assert found[1, i, j] == pytest.approx(zncc, abs=1e-3)


def test_a_finer_field_of_shifts_keeps_its_jump() -> None:
    fine = finer_shift(STEP, (80, 120))
    assert np.all((fine[:, :60] < 2 * 6) & (fine[:, 60:] > 2 * 13.9).all())  # 5.8 and 14 on either side, doubled
    np.testing.assert_allclose(np.diff(fine[0, 4:56]), 0.2, atol=1e-5)  # 0.2 px a pixel on either level
