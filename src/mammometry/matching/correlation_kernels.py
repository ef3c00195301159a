"""Compiled kernels of the correlation, used by `match`.

All work on C-contiguous float32 arrays of one pyramid level and release the GIL, so that several run in threads. NumPy
versions are in the tests. A GPU implementation can have the same interface.
"""

import numpy as np

from mammometry.base.machine.compiled import fast_kernel
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int64, Shaped

_TILE_ROWS, _TILE_COLUMNS = 32, 128  # pixels; a tile's sums fit into the L2 cache
_LEAST_STRETCH = 0.5  # smallest stretch of a row between the images; the largest is 1 / this
LEAST_DETERMINED = np.float32(1e-3)  # smallest share of a slope² that the other unknowns do not explain
LEAST_GAIN, LARGEST_GAIN = np.float32(0.1), np.float32(10.0)  # between the images
UNKNOWN_VARIANCE_PX2 = np.float32(1e4)
_RATIO_ROWS = 2  # every second row is enough for a ratio


@fast_kernel
def _cubic_weights(t):  # type: ignore[no-untyped-def]
    """Cubic B-spline weights of knots −1, 0, 1, 2 at fraction t."""
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


@fast_kernel
def _knots(image, row, column):  # type: ignore[no-untyped-def]
    """The four coefficients around a fraction after a column, mirrored at both ends like the spline."""
    width = image.shape[1]
    after = column + 2 if column + 2 < width else 2 * (width - 1) - (column + 2)
    return image[row, abs(column - 1)], image[row, column], image[row, column + 1], image[row, after]


@fast_kernel
def _along(image, row, column, x0, x1, x2, x3):  # type: ignore[no-untyped-def]
    c0, c1, c2, c3 = _knots(image, row, column)
    return x0 * c0 + x1 * c1 + x2 * c2 + x3 * c3


@fast_kernel
def sample_spline(
    coefficients: Float32[Array, "h w"], u: Float32[Array, "m n"], v: Float32[Array, "m n"], wanted: Bool[Array, "m n"]
) -> Float32[Array, "m n"]:
    """Evaluate a cubic B-spline image at positions (u, v).

    Pixels are clamped to the image; 0 where not wanted. `coefficients` are from `scipy.ndimage.spline_filter(...,
    mode="mirror")`.
    """
    height, width = coefficients.shape
    out = np.zeros(u.shape, dtype=np.float32)
    for i in range(u.shape[0]):
        for j in range(u.shape[1]):
            if not wanted[i, j]:
                continue
            x = min(max(u[i, j], np.float32(0.0)), np.float32(width - 1))
            y = min(max(v[i, j], np.float32(0.0)), np.float32(height - 1))
            column = min(int(x), width - 2)
            row = min(int(y), height - 2)
            x0, x1, x2, x3 = _cubic_weights(x - np.float32(column))
            y0, y1, y2, y3 = _cubic_weights(y - np.float32(row))
            above = abs(row - 1)  # mirrored at the borders, like the coefficients
            below = row + 2 if row + 2 < height else 2 * (height - 1) - (row + 2)
            out[i, j] = (
                y0 * _along(coefficients, above, column, x0, x1, x2, x3)
                + y1 * _along(coefficients, row, column, x0, x1, x2, x3)
                + y2 * _along(coefficients, row + 1, column, x0, x1, x2, x3)
                + y3 * _along(coefficients, below, column, x0, x1, x2, x3)
            )
    return out


@fast_kernel
def weighted_channels(
    pixels: Shaped[Array, "h w channels"], weights: Float32[Array, " channels"]
) -> Float32[Array, "h w"]:
    """Σ_c weights[c] · pixels[…, c] of an integer image."""
    height, width, channels = pixels.shape
    out = np.empty((height, width), dtype=np.float32)
    for i in range(height):
        for j in range(width):
            total = np.float32(0.0)
            for c in range(channels):
                total += weights[c] * np.float32(pixels[i, j, c])
            out[i, j] = total
    return out


@fast_kernel
def spline_along_rows(
    coefficients: Float64[Array, "h knots"], first: Int64[Array, " w"], weights: Float64[Array, "w 4"]
) -> Float32[Array, "h w"]:
    """Evaluate cubic B-splines along rows at columns j. Σ_k weights[j, k] · coefficients[i, first[j] + k]."""
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


@fast_kernel
def _slope_weights(t):  # type: ignore[no-untyped-def]
    """Derivatives of `_cubic_weights` with respect to the fraction."""
    s = np.float32(1.0) - t
    half, three, four = np.float32(0.5), np.float32(3.0), np.float32(4.0)
    return -half * s * s, half * t * (three * t - four), -half * s * (three * s - four), half * t * t


@fast_kernel
def warp_rows(
    coefficients: Float32[Array, "h w"], mask: Bool[Array, "h w"], shift: Float32[Array, "h w"]
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"], Float32[Array, "h w"]]:
    """Sample the other image at (u + shift, v).

    Returns its value, its analytic derivative along the row, and its mask (linear). `coefficients` are cubic B-spline
    coefficients along the rows (`spline_filter1d(..., axis=1, mode="mirror")`). All are 0 outside the image and well
    outside the mask.
    """
    height, width = coefficients.shape
    value = np.zeros((height, width), dtype=np.float32)
    slope = np.zeros((height, width), dtype=np.float32)
    weight = np.zeros((height, width), dtype=np.float32)
    for i in range(height):
        inside = mask[i]
        for j in range(width):
            x = np.float32(j) + shift[i, j]
            if x < 0 or x > width - 1:
                continue
            column = min(int(x), width - 2)
            if not (inside[column] or inside[column + 1]):
                continue
            t = x - np.float32(column)
            c0, c1, c2, c3 = _knots(coefficients, i, column)
            a, b, c, d = _cubic_weights(t)
            value[i, j] = a * c0 + b * c1 + c * c2 + d * c3
            a, b, c, d = _slope_weights(t)
            slope[i, j] = a * c0 + b * c1 + c * c2 + d * c3
            weight[i, j] = (np.float32(1.0) - t) * inside[column] + t * inside[column + 1]
    return value, slope, weight


@fast_kernel
def _own_slope(line, shift, j):  # type: ignore[no-untyped-def]
    """Derivative along the row at this image's pixel, per pixel of the other image."""
    width = line.shape[0]
    before, after = max(j - 1, 0), min(j + 1, width - 1)
    slope = np.float32(0.5) * (line[after] - line[before]) if 0 < j < width - 1 else np.float32(0.0)
    stretch = np.float32(1.0) + (shift[after] - shift[before]) / np.float32(after - before)
    return slope / min(max(stretch, np.float32(_LEAST_STRETCH)), np.float32(1 / _LEAST_STRETCH))


@fast_kernel
def slope_ratio(
    here: Float32[Array, "h w"],
    here_mask: Bool[Array, "h w"],
    there: Float32[Array, "h w"],
    there_mask: Bool[Array, "h w"],
    shift: Float32[Array, "h w"],
) -> float:
    """RMS ratio of the slopes of the other image and this one, on every second row, from their splines."""
    height, width = shift.shape
    power_there, power_here = 0.0, 1e-30
    for i in range(0, height, _RATIO_ROWS):
        line, moved = here[i], shift[i]
        for j in range(width):
            x = np.float32(j) + shift[i, j]
            if x < 0 or x > width - 1 or not here_mask[i, j]:
                continue
            column = min(int(x), width - 2)
            t = x - np.float32(column)
            weight = (np.float32(1.0) - t) * there_mask[i, column] + t * there_mask[i, column + 1]
            a, b, c, d = _slope_weights(t)
            c0, c1, c2, c3 = _knots(there, i, column)
            slope, own = a * c0 + b * c1 + c * c2 + d * c3, _own_slope(line, moved, j)
            power_there += weight * slope * slope
            power_here += weight * own * own
    return np.sqrt(power_there / power_here)


@fast_kernel
def mean_slope(
    slope: Float32[Array, "h w"], coefficients: Float32[Array, "h w"], shift: Float32[Array, "h w"], ratio: float
) -> None:
    """Replace the other image's slope by the mean of both.

    This has less noise and no bias towards the other image's grid. `coefficients` are this image's, `ratio` is the
    factor by which the other image is steeper.
    """
    height, width = slope.shape
    half, share = np.float32(0.5), np.float32(0.5 * ratio)
    for i in range(height):
        row, line, moved = slope[i], coefficients[i], shift[i]
        for j in range(width):
            row[j] = half * row[j] + share * _own_slope(line, moved, j)


@fast_kernel
def calm_at(
    pixels: tuple[Int64[Array, " n"], Int64[Array, " n"]],
    here: Float32[Array, "h w"],
    coefficients: Float32[Array, "h w"],
    shift: Float32[Array, "h w"],
    taps: Float32[Array, " taps"],
) -> Float32[Array, "4 n"]:
    """Gaussian means around chosen pixels (rows, columns).

    The pixels are farther from the borders than the window plus one. Means of this image, and of the other one as
    sampled by `warp_rows`: its value, its slope along the row, and half the difference between the means around the
    pixels below and above.
    """
    rows, columns = pixels
    width = here.shape[1]
    radius = taps.shape[0] // 2
    out = np.zeros((4, rows.shape[0]), dtype=np.float32)
    for n in range(rows.shape[0]):
        i, j = rows[n], columns[n]
        for a in range(-radius - 1, radius + 2):
            tap = taps[a + radius] if abs(a) <= radius else np.float32(0.0)
            above = taps[a + 1 + radius] if abs(a + 1) <= radius else np.float32(0.0)  # window shifted up by one row
            below = taps[a - 1 + radius] if abs(a - 1) <= radius else np.float32(0.0)
            ours = value = slope = np.float32(0.0)
            for b in range(-radius, radius + 1):
                x = min(max(np.float32(j + b) + shift[i + a, j + b], np.float32(0.0)), np.float32(width - 1))
                column = min(int(x), width - 2)
                t = x - np.float32(column)
                c0, c1, c2, c3 = _knots(coefficients, i + a, column)
                w0, w1, w2, w3 = _cubic_weights(t)
                s0, s1, s2, s3 = _slope_weights(t)
                across = taps[b + radius]
                ours += across * here[i + a, j + b]
                value += across * (w0 * c0 + w1 * c1 + w2 * c2 + w3 * c3)
                slope += across * (s0 * c0 + s1 * c1 + s2 * c2 + s3 * c3)
            out[0, n] += tap * ours
            out[1, n] += tap * value
            out[2, n] += tap * slope
            out[3, n] += np.float32(0.5) * (below - above) * value
    return out


@fast_kernel
def shift_of_sums(m, mr, mg, mrr, mrg, mgg, ml, mlr, mlg, mll, floor, concentration):  # type: ignore[no-untyped-def]
    """Shift, correlation and variance of one window.

    From its weighted sums of 1, R, g, RR, Rg, gg, L, LR, Lg, LL. `concentration` is Σw² of a window whose Σw is 1. See
    `least_squares`. Without branches, so that loops are vectorised: invalid divisions are computed with other values
    and discarded.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    filled = m >= np.float32(0.01)
    scale = one / (m if filled else one)
    r1, g1, l1 = mr * scale, mg * scale, ml * scale
    rr, rg, gg = mrr * scale - r1 * r1, mrg * scale - r1 * g1, mgg * scale - g1 * g1
    lr, lg, ll = mlr * scale - l1 * r1, mlg * scale - l1 * g1, mll * scale - l1 * l1
    textured = filled & (rr >= floor) & (ll >= floor)
    correlation = lr / np.sqrt(rr * ll if textured else one)
    rr = rr if textured else one
    steep = gg - rg * rg / rr  # the slope's part that gain and offset do not explain
    determined = textured & (steep >= LEAST_DETERMINED * gg) & (steep > zero) & (lr > zero)
    steep = steep if determined else one
    gained = (lg - lr * rg / rr) / steep
    gain = (lr - gained * rg) / rr
    determined = determined & (gain >= LEAST_GAIN) & (gain <= LARGEST_GAIN)
    gain = gain if determined else one
    left_over = max(ll - gain * lr - gained * lg, np.float32(1e-3) * ll)
    variance = left_over * concentration * scale / (gain * gain * steep)
    shift = gained / gain if determined else zero
    return shift, correlation if textured else zero, variance if determined else UNKNOWN_VARIANCE_PX2


@fast_kernel
def least_squares(
    here: Float32[Array, "h w"],
    there: Float32[Array, "h w"],
    slope: Float32[Array, "h w"],
    weight: Float32[Array, "h w"],
    taps: Float32[Array, " taps"],
    floor: float,
    rows: tuple[int, int],
) -> tuple[Float32[Array, "n w"], Float32[Array, "n w"], Float32[Array, "n w"], Float32[Array, "n w"]]:
    """Shift that maximises the correlation of Eq. 1 around every pixel.

    It solves here ≈ offset + gain·(there + slope·shift). The window is the outer product of `taps` times `weight`.
    `floor` is the variance below which a window is flat (square of image units). For the rows from the first up to the
    last (exclusive), returns the shift (px), the correlation before it (−1…1, 0 if flat), the window's mass (0…1) and
    the shift's variance (px², large if unknown).
    """
    height, width = here.shape
    first, last = rows
    radius = taps.shape[0] // 2
    shift = np.zeros((last - first, width), dtype=np.float32)
    correlation = np.zeros((last - first, width), dtype=np.float32)
    mass = np.zeros((last - first, width), dtype=np.float32)
    variance = np.full((last - first, width), UNKNOWN_VARIANCE_PX2, dtype=np.float32)
    squares = np.float32(0.0)
    for k in range(taps.shape[0]):
        squares += taps[k] * taps[k]
    concentration = squares * squares  # Σw² of a window whose Σw is 1
    flat = np.float32(floor)
    # In tiles, whose products and sums stay in the cache; tiles without weight are skipped.
    wide = _TILE_COLUMNS + 2 * radius
    products = np.zeros((_TILE_ROWS + 2 * radius, 10, wide), dtype=np.float32)
    columns = np.zeros((10, wide), dtype=np.float32)
    sums = np.zeros((10, _TILE_COLUMNS), dtype=np.float32)
    for top in range(first, last, _TILE_ROWS):
        bottom = min(top + _TILE_ROWS, last)
        upper, lower = max(0, top - radius), min(height, bottom + radius)
        for left in range(0, width, _TILE_COLUMNS):
            right = min(left + _TILE_COLUMNS, width)
            start, stop = max(0, left - radius), min(width, right + radius)
            if not weight[upper:lower, start:stop].any():
                continue
            products[:] = np.float32(0.0)
            for source in range(upper, lower):
                row, offset = products[source - top + radius], start - left + radius
                p0, p1, p2, p3, p4 = row[0, offset:], row[1, offset:], row[2, offset:], row[3, offset:], row[4, offset:]
                p5, p6, p7, p8, p9 = row[5, offset:], row[6, offset:], row[7, offset:], row[8, offset:], row[9, offset:]
                weights, ours = weight[source, start:stop], here[source, start:stop]
                theirs, steep = there[source, start:stop], slope[source, start:stop]
                for j in range(stop - start):
                    w, r, g = weights[j], theirs[j], steep[j]
                    wr, wg = w * r, w * g
                    p0[j], p1[j], p2[j] = w, wr, wg
                    p3[j], p4[j], p5[j] = wr * r, wr * g, wg * g
                for j in range(stop - start):
                    l, wl = ours[j], weights[j] * ours[j]  # noqa: E741
                    p6[j], p7[j], p8[j], p9[j] = wl, wl * theirs[j], wl * steep[j], wl * l
            for i in range(top, bottom):
                middle_row = i - top + radius
                for q in range(10):
                    line, total, here_line = columns[q], sums[q], products[middle_row, q]
                    # The window is symmetric. Four neighbours at a time give fewer passes over the sums.
                    for j in range(wide):
                        line[j] = taps[radius] * here_line[j]
                    for k in range(1, radius + 1, 2):
                        a, b = taps[radius + k], taps[radius + k + 1] if k < radius else np.float32(0.0)
                        further = min(k + 1, radius)
                        q0, q1 = products[middle_row - k, q], products[middle_row + k, q]
                        q2, q3 = products[middle_row - further, q], products[middle_row + further, q]
                        for j in range(wide):
                            line[j] += a * (q0[j] + q1[j]) + b * (q2[j] + q3[j])
                    middle = line[radius:]
                    for j in range(_TILE_COLUMNS):
                        total[j] = taps[radius] * middle[j]
                    for k in range(1, radius + 1, 2):
                        a, b = taps[radius + k], taps[radius + k + 1] if k < radius else np.float32(0.0)
                        further = min(k + 1, radius)
                        q0, q1 = line[radius - k :], line[radius + k :]
                        q2, q3 = line[radius - further :], line[radius + further :]
                        for j in range(_TILE_COLUMNS):
                            total[j] += a * (q0[j] + q1[j]) + b * (q2[j] + q3[j])
                for j in range(_TILE_COLUMNS):  # the results overwrite sums that are no longer needed
                    found = shift_of_sums(
                        sums[0, j], sums[1, j], sums[2, j], sums[3, j], sums[4, j], sums[5, j], sums[6, j], sums[7, j],
                        sums[8, j], sums[9, j], flat, concentration,
                    )  # fmt: skip
                    sums[1, j], sums[2, j], sums[3, j] = found
                inside = right - left
                for j in range(inside):
                    mass[i - first, left + j], shift[i - first, left + j] = sums[0, j], sums[1, j]
                    correlation[i - first, left + j], variance[i - first, left + j] = sums[2, j], sums[3, j]
    return shift, correlation, mass, variance
