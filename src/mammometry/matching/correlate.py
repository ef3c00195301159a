"""Compiled kernels of matching, and only them; `match` composes them. Each has a plain NumPy twin in the tests.

All work on C-contiguous float32 arrays of one pyramid level and release the interpreter's lock, so that several may run
at once in threads. A GPU implementation can stand beside this module behind the same names.
"""

import numpy as np
from numba import njit

from mammometry.geometry.arrays import Array, Float32, Float64, Int64

_BAND_ROWS = 64


@njit(cache=True, nogil=True, inline="always")
def _cubic_weights(t):  # type: ignore[no-untyped-def]
    """Cubic B-spline weights of the knots −1, 0, 1, 2 at the fraction t."""
    s = np.float32(1.0) - t
    sixth = np.float32(1.0 / 6.0)
    two_thirds = np.float32(2.0 / 3.0)
    half = np.float32(0.5)
    return (
        sixth * s * s * s,
        two_thirds - half * t * t * (np.float32(2.0) - t),
        two_thirds - half * s * s * (np.float32(2.0) - s),
        sixth * t * t * t,
    )


@njit(cache=True, nogil=True)
def sample_spline(
    coefficients: Float32[Array, "h w"], u: Float32[Array, "m n"], v: Float32[Array, "m n"]
) -> Float32[Array, "m n"]:
    """Evaluate a cubic B-spline image at positions (u, v), held within the image; pixels.

    `coefficients` are those of `scipy.ndimage.spline_filter(..., mode="mirror")`.
    """
    height, width = coefficients.shape
    out = np.empty(u.shape, dtype=np.float32)
    for i in range(u.shape[0]):
        for j in range(u.shape[1]):
            x = min(max(u[i, j], np.float32(0.0)), np.float32(width - 1))
            y = min(max(v[i, j], np.float32(0.0)), np.float32(height - 1))
            column = min(int(x), width - 2)
            row = min(int(y), height - 2)
            x0, x1, x2, x3 = _cubic_weights(x - np.float32(column))
            weights_y = _cubic_weights(y - np.float32(row))
            before = abs(column - 1)  # mirrored at the borders, as the coefficients are
            after = column + 2 if column + 2 < width else 2 * (width - 1) - (column + 2)
            total = np.float32(0.0)
            for k in range(4):
                line = abs(row - 1 + k)
                if line >= height:
                    line = 2 * (height - 1) - line
                total += weights_y[k] * (
                    x0 * coefficients[line, before]
                    + x1 * coefficients[line, column]
                    + x2 * coefficients[line, column + 1]
                    + x3 * coefficients[line, after]
                )
            out[i, j] = total
    return out


@njit(cache=True, nogil=True, fastmath=True)
def spline_along_rows(
    coefficients: Float64[Array, "h knots"], first: Int64[Array, " w"], weights: Float64[Array, "w 4"]
) -> Float32[Array, "h w"]:
    """Σ_k weights[j, k] · coefficients[i, first[j] + k]: cubic B-splines along rows, evaluated at columns j."""
    height, width = coefficients.shape[0], first.shape[0]
    out = np.empty((height, width), dtype=np.float32)
    for i in range(height):
        row = coefficients[i]
        for j in range(width):
            k = first[j]
            out[i, j] = (
                weights[j, 0] * row[k]
                + weights[j, 1] * row[k + 1]
                + weights[j, 2] * row[k + 2]
                + weights[j, 3] * row[k + 3]
            )
    return out


@njit(cache=True, nogil=True, fastmath=True)
def warp_rows(
    coefficients: Float32[Array, "h w"], mask: Float32[Array, "h w"], shift: Float32[Array, "h w"]
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"], Float32[Array, "h w"]]:
    """Read the other image at (u + shift, v): value, analytic derivative along the row, and its mask (linear).

    `coefficients` are cubic B-spline coefficients along the rows (`spline_filter1d(..., axis=1, mode="mirror")`).
    Outside the image the mask is 0.
    """
    height, width = coefficients.shape
    value = np.zeros((height, width), dtype=np.float32)
    slope = np.zeros((height, width), dtype=np.float32)
    weight = np.zeros((height, width), dtype=np.float32)
    half = np.float32(0.5)
    for i in range(height):
        for j in range(width):
            x = np.float32(j) + shift[i, j]
            if x < 0 or x > width - 1:
                continue
            column = min(int(x), width - 2)
            t = x - np.float32(column)
            s = np.float32(1.0) - t
            a, b, c, d = _cubic_weights(t)
            c0 = coefficients[i, abs(column - 1)]
            c1 = coefficients[i, column]
            c2 = coefficients[i, column + 1]
            c3 = coefficients[i, column + 2 if column + 2 < width else 2 * (width - 1) - (column + 2)]
            value[i, j] = a * c0 + b * c1 + c * c2 + d * c3
            slope[i, j] = half * (
                -s * s * c0
                + t * (np.float32(3.0) * t - np.float32(4.0)) * c1
                - s * (np.float32(3.0) * s - np.float32(4.0)) * c2
                + t * t * c3
            )
            weight[i, j] = s * mask[i, column] + t * mask[i, column + 1]
    return value, slope, weight


@njit(cache=True, nogil=True, fastmath=True)
def row_slope(coefficients: Float32[Array, "h w"]) -> Float32[Array, "h w"]:
    """Derivative along the rows at the pixels themselves, of the spline that `warp_rows` reads."""
    height, width = coefficients.shape
    slope = np.zeros((height, width), dtype=np.float32)  # 0 at both ends, where the spline is mirrored
    half = np.float32(0.5)
    for i in range(height):
        for j in range(1, width - 1):
            slope[i, j] = half * (coefficients[i, j + 1] - coefficients[i, j - 1])
    return slope


@njit(cache=True, nogil=True, inline="always")
def shift_of_sums(sums, floor, concentration):  # type: ignore[no-untyped-def]
    """Shift, correlation and variance of one window from its weighted sums of 1, R, g, RR, Rg, gg, L, LR, Lg, LL.

    `concentration` is Σw² of a window whose Σw is 1. See `least_squares`.
    """
    unknown = np.float32(0.0), np.float32(0.0), np.float32(1e4)
    if sums[0] < np.float32(0.01):
        return unknown
    scale = np.float32(1.0) / sums[0]
    r1 = sums[1] * scale
    g1 = sums[2] * scale
    l1 = sums[6] * scale
    rr = sums[3] * scale - r1 * r1
    rg = sums[4] * scale - r1 * g1
    gg = sums[5] * scale - g1 * g1
    lr = sums[7] * scale - l1 * r1
    lg = sums[8] * scale - l1 * g1
    ll = sums[9] * scale - l1 * l1
    if rr < floor or ll < floor:
        return unknown
    correlation = lr / np.sqrt(rr * ll)
    steep = gg - rg * rg / rr  # what the slope holds that gain and offset do not
    if steep < np.float32(1e-3) * gg or lr <= 0:
        return np.float32(0.0), correlation, np.float32(1e4)
    gained = (lg - lr * rg / rr) / steep
    gain = (lr - gained * rg) / rr
    if gain < np.float32(0.1) or gain > np.float32(10.0):
        return np.float32(0.0), correlation, np.float32(1e4)
    left_over = max(ll - gain * lr - gained * lg, np.float32(1e-3) * ll)
    return gained / gain, correlation, left_over * concentration * scale / (gain * gain * steep)


@njit(cache=True, nogil=True, fastmath=True)
def least_squares(
    here: Float32[Array, "h w"],
    there: Float32[Array, "h w"],
    slope: Float32[Array, "h w"],
    weight: Float32[Array, "h w"],
    taps: Float32[Array, " taps"],
    floor: float,
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"], Float32[Array, "h w"], Float32[Array, "h w"]]:
    """Shift that maximises the correlation of Eq. 1 around every pixel: here ≈ offset + gain·(there + slope·shift).

    The window is the outer product of `taps` times `weight`. `floor` is the variance below which a window counts as
    flat (its square of image units). Returns the shift (px), the correlation before it (−1…1, 0 where flat), the
    window's mass (0…1) and the shift's variance (px², large where unknown).
    """
    height, width = here.shape
    radius = taps.shape[0] // 2
    shift = np.zeros((height, width), dtype=np.float32)
    correlation = np.zeros((height, width), dtype=np.float32)
    mass = np.zeros((height, width), dtype=np.float32)
    variance = np.full((height, width), np.float32(1e4), dtype=np.float32)
    squares = np.float32(0.0)
    for k in range(taps.shape[0]):
        squares += taps[k] * taps[k]
    concentration = squares * squares  # Σw² of the window, whose Σw is 1
    products = np.zeros((10, _BAND_ROWS + 2 * radius, width), dtype=np.float32)
    columns = np.zeros((10, width + 2 * radius), dtype=np.float32)
    sums = np.zeros((10, width), dtype=np.float32)
    for top in range(0, height, _BAND_ROWS):
        rows = min(_BAND_ROWS, height - top)
        for i in range(rows + 2 * radius):
            source = top - radius + i
            if source < 0 or source >= height:
                for q in range(10):
                    for j in range(width):
                        products[q, i, j] = 0.0
                continue
            for j in range(width):
                w = weight[source, j]
                l = here[source, j]  # noqa: E741
                r = there[source, j]
                g = slope[source, j]
                products[0, i, j] = w
                products[1, i, j] = w * r
                products[2, i, j] = w * g
                products[3, i, j] = w * r * r
                products[4, i, j] = w * r * g
                products[5, i, j] = w * g * g
                products[6, i, j] = w * l
                products[7, i, j] = w * l * r
                products[8, i, j] = w * l * g
                products[9, i, j] = w * l * l
        for i in range(rows):
            for q in range(10):
                line = columns[q, radius : radius + width]
                for j in range(width):
                    line[j] = 0.0
                for k in range(taps.shape[0]):
                    tap = taps[k]
                    source_line = products[q, i + k]
                    for j in range(width):
                        line[j] += tap * source_line[j]
                total = sums[q]
                for j in range(width):
                    total[j] = 0.0
                for k in range(taps.shape[0]):
                    tap = taps[k]
                    for j in range(width):
                        total[j] += tap * columns[q, j + k]
            for j in range(width):
                mass[top + i, j] = sums[0, j]
                if sums[0, j] >= np.float32(0.01):
                    shift[top + i, j], correlation[top + i, j], variance[top + i, j] = shift_of_sums(
                        sums[:, j], floor, concentration
                    )
    return shift, correlation, mass, variance
