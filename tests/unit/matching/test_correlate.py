"""Every compiled kernel against a plain NumPy twin."""

import numpy as np
import pytest
from scipy import ndimage
from scipy.interpolate import BSpline, make_interp_spline

from mammometry.base.photograph import LUMA
from mammometry.matching.correlation_kernels import (
    calm_at,
    least_squares,
    mean_slope,
    sample_spline,
    slope_ratio,
    spline_along_rows,
    warp_rows,
    weighted_channels,
)
from mammometry.matching.dense.plane_smoothing import choose_windows, evaluate_planes, plane_fit
from mammometry.matching.filters import blur, gaussian_taps
from mammometry.matching.rectify import SPLINE_TAPS
from mammometry.matching.semiglobal import COSTS_TO_ONE, aggregate, cheapest, matching_costs

RNG = np.random.default_rng(0)
SHAPE = (24, 31)


def image(seed: int) -> np.ndarray:
    return ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=SHAPE), 1.2).astype(np.float32)


def test_spline_sampling_is_scipys() -> None:
    values = image(1)
    u = RNG.uniform(-3, SHAPE[1] + 2, (40, 17)).astype(np.float32)
    v = RNG.uniform(-3, SHAPE[0] + 2, (40, 17)).astype(np.float32)
    coefficients = ndimage.spline_filter(values, order=3, mode="mirror", output=np.float32)
    held = [np.clip(v, 0, SHAPE[0] - 1), np.clip(u, 0, SHAPE[1] - 1)]
    expected = ndimage.map_coordinates(values.astype(np.float64), held, order=3, mode="mirror")
    wanted = RNG.uniform(size=u.shape) > 0.3
    found = sample_spline(coefficients, u, v, wanted)
    np.testing.assert_allclose(found, np.where(wanted, expected, 0), atol=3e-6)


def test_a_symmetric_filter_makes_the_splines_coefficients() -> None:
    values = np.random.default_rng(10).normal(size=(60, 70)).astype(np.float32)
    expected = ndimage.spline_filter(values.astype(np.float64), order=3, mode="mirror")
    inner = (slice(11, -11), slice(11, -11))  # nearer, what lies beyond the picture counts
    # Cut off where the pole's power is 2e-6, summed in float32.
    np.testing.assert_allclose(blur(values, SPLINE_TAPS)[inner], expected[inner], atol=2e-5)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_weighted_channels_are_a_product(kind: type) -> None:
    pixels = RNG.integers(0, np.iinfo(kind).max, (7, 9, 3)).astype(kind)
    np.testing.assert_allclose(weighted_channels(pixels, LUMA), pixels @ LUMA.astype(np.float64), rtol=1e-6)


def test_splines_along_rows_are_scipys() -> None:
    knots, columns = np.linspace(0, 30, 7), np.arange(31.0)
    values = RNG.normal(size=(5, 7))
    spline = make_interp_spline(knots, values, k=3, axis=1)
    design = BSpline.design_matrix(columns, spline.t, 3)
    first, weights = design.indices.reshape(31, 4)[:, 0].astype(np.int64), design.data.reshape(31, 4)
    coefficients = np.ascontiguousarray(np.moveaxis(spline.c, 0, 1) if spline.c.shape[0] == 7 else spline.c)
    np.testing.assert_allclose(spline_along_rows(coefficients, first, weights), spline(columns), atol=1e-5)


def along_row(values: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The cubic spline of every row at columns x, mirrored at the ends."""
    knots = ndimage.spline_filter1d(values.astype(np.float64), order=3, axis=1, mode="mirror")
    rows = np.broadcast_to(np.arange(values.shape[0])[:, None], x.shape)
    result = np.zeros(x.shape)
    for offset in range(-1, 3):
        column = np.floor(x).astype(int) + offset
        distance = np.abs(x - column)
        weight = np.where(distance < 1, 2 / 3 - distance**2 + distance**3 / 2, (2 - distance) ** 3 / 6)
        reflected = np.abs(column)
        reflected = np.where(reflected > values.shape[1] - 1, 2 * (values.shape[1] - 1) - reflected, reflected)
        result += weight * knots[rows, np.clip(reflected, 0, values.shape[1] - 1)]
    return result


def slope_along_row(values: np.ndarray, x: np.ndarray, step: float = 1e-4) -> np.ndarray:
    return (along_row(values, x + step) - along_row(values, x - step)) / (2 * step)


def spline_of(values: np.ndarray) -> np.ndarray:
    return np.asarray(ndimage.spline_filter1d(values, order=3, axis=1, mode="mirror", output=np.float32))


def test_warped_rows_their_slope_and_their_mask() -> None:
    values = image(2)
    mask = RNG.uniform(size=SHAPE) > 0.3
    shift = RNG.uniform(-4, 4, SHAPE).astype(np.float32)
    found = warp_rows(spline_of(values), mask, shift)
    position = np.arange(SHAPE[1]) + shift.astype(np.float64)
    inside = (position >= 0) & (position <= SHAPE[1] - 1)
    rows = np.broadcast_to(np.arange(SHAPE[0])[:, None], SHAPE).astype(np.float64)
    linear = ndimage.map_coordinates(mask.astype(np.float64), [rows, position], order=1, mode="nearest")
    seen = inside & (linear > 1e-4)
    np.testing.assert_allclose(found[0][seen], along_row(values, position)[seen], atol=3e-6)
    well_inside = seen & (position > 1e-4) & (position < SHAPE[1] - 1 - 1e-4)
    np.testing.assert_allclose(found[1][well_inside], slope_along_row(values, position)[well_inside], atol=2e-3)
    np.testing.assert_allclose(found[2][inside], linear[inside], atol=1e-5)
    assert not found[2][~inside].any()


def test_the_mean_slope_weighs_both_pictures_alike() -> None:
    """The other picture is this one, three times as strong and stretched: own slope × ratio is the other's."""
    columns = np.arange(64.0)
    ours = np.tile(np.sin(2 * np.pi * columns / 16), (16, 1)).astype(np.float32)
    theirs = np.tile(3 * np.sin(2 * np.pi * columns / 20), (16, 1)).astype(np.float32)
    shift = np.tile(0.25 * columns, (16, 1)).astype(np.float32)  # u → 1.25 u
    everywhere = np.ones(ours.shape, dtype=bool)
    ratio = slope_ratio(spline_of(ours), everywhere, spline_of(theirs), everywhere, shift)
    assert ratio == pytest.approx(3, rel=0.01)
    _, slope, _ = warp_rows(spline_of(theirs), everywhere, shift)
    other = slope.copy()
    mean_slope(slope, spline_of(ours), shift, ratio)
    own = slope_along_row(ours, np.tile(columns, (16, 1))) / 1.25
    np.testing.assert_allclose(slope[:, 1:50], 0.5 * (other + ratio * own)[:, 1:50], atol=2e-3)
    np.testing.assert_allclose(
        slope[:, 8:44], other[:, 8:44], atol=0.02
    )  # 2 % of the largest: the splines near their ends


def test_calm_values_are_gaussian_means_of_the_warped_picture() -> None:
    ours, theirs = image(8), image(9)
    shift = RNG.uniform(-2, 2, SHAPE).astype(np.float32)
    taps = gaussian_taps(1.0)
    rows, columns = (index.ravel() for index in np.mgrid[5:19, 6:25])
    found = calm_at((rows, columns), ours, spline_of(theirs), shift, taps)
    position = np.arange(SHAPE[1]) + shift.astype(np.float64)

    def calm(values: np.ndarray) -> np.ndarray:
        for axis in (0, 1):
            values = ndimage.correlate1d(values, taps.astype(np.float64), axis=axis, mode="nearest")
        return values

    value = calm(along_row(theirs, position))
    expected = [
        calm(ours.astype(np.float64)),
        value,
        calm(slope_along_row(theirs, position)),
        np.gradient(value, axis=0),
    ]
    for one, plain in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, plain[rows, columns], atol=1e-3)


def test_least_squares_is_a_weighted_regression_in_every_window() -> None:
    here, there, slope = image(3), image(4), image(5)
    here = (0.8 * there + 0.3 * slope + 0.1 * here).astype(np.float32)
    weight = (RNG.uniform(size=SHAPE) > 0.2).astype(np.float32)
    taps = gaussian_taps(2.5)
    shift, correlation, mass, variance = least_squares(here, there, slope, weight, taps, 1e-8, (0, SHAPE[0]))
    for part, whole in zip(
        least_squares(here, there, slope, weight, taps, 1e-8, (7, 11)),
        (shift, correlation, mass, variance),
        strict=True,
    ):
        np.testing.assert_allclose(part, whole[7:11], rtol=1e-6)
    radius = len(taps) // 2
    padded = [np.pad(a.astype(np.float64), radius) for a in (here, there, slope, weight)]
    window = np.outer(taps, taps).astype(np.float64)
    for i, j in [(0, 0), (12, 15), (23, 30), (5, 28)]:
        left, right, steep, w = (a[i : i + 2 * radius + 1, j : j + 2 * radius + 1].ravel() for a in padded)
        w = w * window.ravel()
        root = np.sqrt(w)
        design = np.stack([np.ones_like(right), right, steep], axis=1)
        solution = np.linalg.lstsq(design * root[:, None], left * root, rcond=None)[0]
        assert mass[i, j] == pytest.approx(w.sum(), rel=1e-4)
        assert shift[i, j] == pytest.approx(solution[2] / solution[1], abs=2e-3)
        a, b = left - np.average(left, weights=w), right - np.average(right, weights=w)
        zncc = (w * a * b).sum() / np.sqrt((w * a * a).sum() * (w * b * b).sum())
        assert correlation[i, j] == pytest.approx(zncc, abs=1e-3)
        # Variance of a ratio of coefficients at fixed gain: residual × Σw²/(Σw)² / (gain² · what slope alone holds).
        residual = (w * (left - design @ solution) ** 2).sum() / w.sum()
        rest = steep - design[:, :2] @ np.linalg.lstsq(design[:, :2] * root[:, None], steep * root, rcond=None)[0]
        concentration = (window**2).sum() / w.sum()
        expected = residual * concentration / (solution[1] ** 2 * (w * rest**2).sum() / w.sum())
        assert variance[i, j] == pytest.approx(expected, rel=0.02)


def test_a_flat_window_has_no_shift_and_no_correlation() -> None:
    flat = np.full(SHAPE, 0.5, dtype=np.float32)
    shift, correlation, _, variance = least_squares(
        flat, flat, image(6), np.ones_like(flat), gaussian_taps(2.5), 1e-6, (0, SHAPE[0])
    )
    assert not shift.any()
    assert not correlation.any()
    assert variance.min() > 1e3


def fitted_planes(values: np.ndarray, weights: np.ndarray, taps: np.ndarray) -> np.ndarray:
    planes = np.full((5, *values.shape), np.nan, dtype=np.float32)
    plane_fit(values, weights, taps, planes)
    return planes


def test_plane_fit_is_a_weighted_plane_in_every_window() -> None:
    values = image(7) + np.linspace(0, 3, SHAPE[1], dtype=np.float32)
    weights = RNG.uniform(0.2, 2.0, SHAPE).astype(np.float32)
    taps = gaussian_taps(3.0)
    planes = fitted_planes(values, weights, taps)
    radius = len(taps) // 2
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    for i, j in [(12, 15), (0, 3), (23, 30)]:
        near = (np.abs(v - i) <= radius) & (np.abs(u - j) <= radius)
        x, y = (u - j)[near].astype(np.float64), (v - i)[near].astype(np.float64)
        w = weights[near] * taps[(u - j)[near] + radius].astype(np.float64) * taps[(v - i)[near] + radius]
        spread = float((taps * np.arange(-radius, radius + 1) ** 2).sum())
        design = np.stack([np.ones_like(x), x - np.average(x, weights=w), y - np.average(y, weights=w)], axis=1)
        # Slopes are damped by 2 % of the window's spread (ridge regression on the centred coordinates).
        normal = design.T @ (w[:, None] * design) + np.diag([0, 0.02 * spread * w.sum(), 0.02 * spread * w.sum()])
        mean, along_u, along_v = np.linalg.solve(normal, design.T @ (w * values[near]))
        at_pixel = mean - along_u * np.average(x, weights=w) - along_v * np.average(y, weights=w)
        np.testing.assert_allclose(planes[:3, i, j], [at_pixel, along_u, along_v], atol=2e-4)
        assert planes[4, i, j] == pytest.approx(w.sum(), rel=1e-4)
        scatter = np.average((values[near] - mean) ** 2, weights=w)
        explained = np.average((values[near] - mean) * (design @ [0, along_u, along_v]), weights=w)
        assert planes[3, i, j] == pytest.approx(scatter - explained, rel=5e-3, abs=1e-4)


def test_beside_a_jump_the_window_moves_to_the_pixels_own_side() -> None:
    step = np.where(np.arange(40) < 20, 0.0, 6.0).astype(np.float32) * np.ones((30, 1), dtype=np.float32)
    planes = fitted_planes(step, np.ones_like(step), gaussian_taps(2.5))
    choice = choose_windows(planes, step, 5, 0.5, 1e-3)
    fitted = evaluate_planes(planes, choice, 5)
    beside = np.abs(np.arange(40) - 19.5) < 4
    assert np.abs(planes[0] - step)[5:-5, beside].max() > 1.5  # what the plain fit does to it
    # Moved by 2 σ, a window holds 4 % of the other side, whose plane meets the pixel with .04 · 6 px · a few.
    assert np.abs(fitted - step)[5:-5, beside].max() < 0.8
    far = np.abs(np.arange(40) - 19.5) > 10
    assert not choice[:, far].any()


def test_matching_costs_are_one_minus_the_product_of_unit_vectors() -> None:
    here, there = RNG.normal(size=(2, 6, 9, 9)).astype(np.float32)
    here, there = (each / np.linalg.norm(each, axis=2, keepdims=True) for each in (here, there))
    masks = [RNG.uniform(size=(6, 9)) > 0.2 for _ in range(2)]
    costs = matching_costs(here, there, masks[0], masks[1], -2, 5, 1.2)
    for i, j, d in np.ndindex(6, 9, 5):
        partner = j - 2 + d
        if not masks[0][i, j]:
            expected = 0.0
        elif not (0 <= partner < 9) or not masks[1][i, partner]:
            expected = 1.2
        else:
            expected = 1 - float(here[i, j] @ there[i, partner])
        assert costs[i, j, d] / COSTS_TO_ONE == pytest.approx(expected, abs=0.501 / COSTS_TO_ONE)


def aggregate_plainly(costs: np.ndarray, mask: np.ndarray, small: float, large: float) -> np.ndarray:
    height, width, count = costs.shape
    total = np.zeros(costs.shape)
    for di, dj in [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)]:
        path = np.zeros(costs.shape)
        for i in range(height) if di <= 0 else range(height - 1, -1, -1):
            for j in range(width) if (dj < 0 or (dj == 0)) else range(width - 1, -1, -1):
                if not mask[i, j]:
                    continue
                path[i, j] = costs[i, j]
                a, b = i + di, j + dj
                if 0 <= a < height and 0 <= b < width and mask[a, b]:
                    before = path[a, b]
                    for d in range(count):
                        options = [before[d], before.min() + large]
                        options += [before[e] + small for e in (d - 1, d + 1) if 0 <= e < count]
                        path[i, j, d] += min(options) - before.min()
        total += path
    return total


def test_semi_global_aggregation_follows_its_definition() -> None:
    costs = RNG.integers(0, 200, (7, 8, 6), dtype=np.uint8)
    mask = RNG.uniform(size=(7, 8)) > 0.15
    costs[~mask] = 0
    np.testing.assert_array_equal(aggregate(costs, mask, 25, 100), aggregate_plainly(costs, mask, 25, 100))


def test_the_cheapest_shift_of_both_images() -> None:
    total = RNG.permutation(5 * 12 * 7).reshape(5, 12, 7).astype(np.uint16)
    mask = RNG.uniform(size=(5, 12)) > 0.1
    ours, theirs = cheapest(total, mask, -3)
    for i, j in zip(*np.nonzero(mask), strict=True):
        assert abs(ours[i, j] - (np.argmin(total[i, j]) - 3)) <= 0.5
    for i, j in np.ndindex(5, 12):
        candidates = {d: total[i, j + 3 - d, d] for d in range(7) if 0 <= j + 3 - d < 12 and mask[i, j + 3 - d]}
        if candidates:
            assert theirs[i, j] == 3 - min(candidates, key=lambda d: candidates[d])
