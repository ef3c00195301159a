"""Compiled image filters: blur, halve, double, compare fields of shifts.

They work on C-contiguous float32 arrays, release the GIL and have NumPy versions in the tests. Each reads its image
once, row by row, since memory access takes most of the time at full size.
"""

import numpy as np

from mammometry.base.machine.compiled import fast_kernel
from mammometry.geometry.arrays import Array, Bool, Float32, Int32

_CELL = 16  # pixels; affects speed only: a cell completely inside or far outside a mask is not filtered


def gaussian_taps(sigma_px: float) -> Float32[Array, " taps"]:
    """Sampled Gaussian out to 3 σ with sum 1, the window of every local fit."""
    radius = max(1, int(np.ceil(3 * sigma_px)))
    taps = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma_px) ** 2)
    return (taps / taps.sum()).astype(np.float32)


@fast_kernel
def blur(image: Float32[Array, "h w"], taps: Float32[Array, " taps"]) -> Float32[Array, "h w"]:
    """Convolve rows and columns with an odd number of symmetric taps. Borders are extended."""
    height, width = image.shape
    radius = taps.shape[0] // 2
    out = np.empty((height, width), dtype=np.float32)
    line = np.empty(width + 2 * radius, dtype=np.float32)
    for i in range(height):
        middle = line[radius : radius + width]
        centre = image[i]
        for j in range(width):
            middle[j] = taps[radius] * centre[j]
        for k in range(1, radius + 1):
            tap = taps[radius + k]
            above, below = image[max(i - k, 0)], image[min(i + k, height - 1)]
            for j in range(width):
                middle[j] += tap * (above[j] + below[j])
        line[:radius] = middle[0]
        line[radius + width :] = middle[width - 1]
        row = out[i]
        for j in range(width):
            row[j] = taps[radius] * middle[j]
        for k in range(1, radius + 1):
            tap = taps[radius + k]
            before, after = line[radius - k : radius - k + width], line[radius + k : radius + k + width]
            for j in range(width):
                row[j] += tap * (before[j] + after[j])
    return out


@fast_kernel
def continue_outside(
    image: Float32[Array, "h w"], mask: Bool[Array, "h w"], taps: Float32[Array, " taps"], far: float, far_weight: float
) -> Float32[Array, "h w"]:
    """Extend the image beyond the mask.

    Outside, it is the mean of the inside pixels in the window of `taps`, plus `far` with the weight `far_weight`, which
    is the only term if the window contains no inside pixels.
    """
    height, width = image.shape
    radius = taps.shape[0] // 2
    out = np.empty((height, width), dtype=np.float32)
    rows, columns = (height + _CELL - 1) // _CELL, (width + _CELL - 1) // _CELL
    inside = np.zeros((rows, columns), dtype=np.int64)
    for i in range(height):
        for j in range(width):
            inside[i // _CELL, j // _CELL] += mask[i, j]
    sums = np.empty((2, _CELL + 2 * radius), dtype=np.float32)
    beyond = (radius + _CELL - 1) // _CELL  # cells covered by a window
    constant, share = np.float32(far), np.float32(far_weight)
    for row in range(rows):
        for column in range(columns):
            top, left = row * _CELL, column * _CELL
            bottom, right = min(top + _CELL, height), min(left + _CELL, width)
            if inside[row, column] == (bottom - top) * (right - left):
                for i in range(top, bottom):
                    for j in range(left, right):
                        out[i, j] = image[i, j]
                continue
            near = 0
            for i in range(max(row - beyond, 0), min(row + beyond + 1, rows)):
                for j in range(max(column - beyond, 0), min(column + beyond + 1, columns)):
                    near += inside[i, j]
            if near == 0:
                out[top:bottom, left:right] = constant
                continue
            for i in range(top, bottom):
                sums[:] = np.float32(0.0)
                for a in range(max(i - radius, 0), min(i + radius + 1, height)):
                    tap = taps[a - i + radius]
                    for b in range(max(left - radius, 0), min(right + radius, width)):
                        weight = tap * np.float32(mask[a, b])
                        sums[0, b - left + radius] += weight
                        sums[1, b - left + radius] += weight * image[a, b]
                for j in range(left, right):
                    mass, total = share, share * constant
                    for k in range(2 * radius + 1):
                        mass += taps[k] * sums[0, j - left + k]
                        total += taps[k] * sums[1, j - left + k]
                    out[i, j] = image[i, j] if mask[i, j] else total / mass
    return out


@fast_kernel
def halve(image: Float32[Array, "h w"], taps: Float32[Array, " taps"]) -> Float32[Array, "H W"]:
    """Filter with an even number of taps, and keep every second row and column."""
    height, width = image.shape
    reach = taps.shape[0] // 2 - 1
    rows, columns = (height + 1) // 2, (width + 1) // 2
    out = np.empty((rows, columns), dtype=np.float32)
    line = np.empty(2 * columns + 2 * reach, dtype=np.float32)
    parts = np.empty((2, columns + reach), dtype=np.float32)  # even and odd columns, for contiguous access
    for i in range(rows):
        middle = line[reach : reach + width]
        middle[:] = np.float32(0.0)
        for k in range(taps.shape[0]):
            source = image[min(max(2 * i - reach + k, 0), height - 1)]
            tap = taps[k]
            for j in range(width):
                middle[j] += tap * source[j]
        line[:reach] = middle[0]
        line[reach + width :] = middle[width - 1]
        for j in range(columns + reach):
            parts[0, j] = line[2 * j]
            parts[1, j] = line[2 * j + 1]
        row = out[i]
        row[:] = np.float32(0.0)
        for k in range(taps.shape[0]):
            tap = taps[k]
            source = parts[k % 2, k // 2 : k // 2 + columns]
            for j in range(columns):
                row[j] += tap * source[j]
    return out


@fast_kernel
def double(field: Float32[Array, "h w"], height: int, width: int, steepest: float) -> Float32[Array, "H W"]:
    """Linear interpolation on a grid twice as fine, but not across jumps.

    Where it differs from the nearest value by more than `steepest`, the nearest value is used.
    """
    rows, columns = field.shape
    out = np.empty((height, width), dtype=np.float32)
    line = np.empty(columns + 2, dtype=np.float32)
    limit = np.float32(steepest)
    near, far = np.float32(0.75), np.float32(0.25)
    for i in range(height):
        nearest = field[i // 2]
        other = field[min(max(i // 2 + 2 * (i % 2) - 1, 0), rows - 1)]
        for j in range(columns):
            line[j + 1] = near * nearest[j] + far * other[j]
        line[0], line[columns + 1] = line[1], line[columns]
        row = out[i]
        for side in range(2):  # even columns are left of their nearest value, odd ones right of it
            beside = line[2 * side : 2 * side + columns]
            for j in range((width + 1 - side) // 2):
                value = near * line[j + 1] + far * beside[j]
                row[2 * j + side] = value if abs(value - nearest[j]) < limit else nearest[j]
    return out


@fast_kernel
def pull(
    values: Float32[Array, "h w"], weights: Float32[Array, "h w"]
) -> tuple[Float32[Array, "H W"], Float32[Array, "H W"]]:
    """Weighted means of blocks of 2 × 2 pixels, 0 without weight, and the blocks' weights."""
    height, width = values.shape
    rows, columns = (height + 1) // 2, (width + 1) // 2
    means = np.empty((rows, columns), dtype=np.float32)
    mass = np.empty((rows, columns), dtype=np.float32)
    whole = width // 2
    for i in range(rows):
        last = min(2 * i + 1, height - 1)
        there = np.float32(last - 2 * i)  # 0 if the last block has one row
        upper, lower, upper_w, lower_w = values[2 * i], values[last], weights[2 * i], weights[last]
        mean, sums = means[i], mass[i]
        for j in range(whole):
            a, b = upper_w[2 * j], upper_w[2 * j + 1]
            c, d = there * lower_w[2 * j], there * lower_w[2 * j + 1]
            weight = a + b + c + d
            total = a * upper[2 * j] + b * upper[2 * j + 1] + c * lower[2 * j] + d * lower[2 * j + 1]
            sums[j] = weight
            mean[j] = total / (weight if weight > 0 else np.float32(1.0))
        if whole < columns:
            a, c = upper_w[width - 1], there * lower_w[width - 1]
            total = a * upper[width - 1] + c * lower[width - 1]
            sums[whole] = a + c
            mean[whole] = total / (a + c if a + c > 0 else np.float32(1.0))
    return means, mass


@fast_kernel
def from_blocks(means: Float32[Array, "h w"], height: int, width: int, steepest: float) -> Float32[Array, "H W"]:
    """Field at the pixels from means of 2 × 2 blocks, exact for quadratics.

    A pixel is a quarter of a block from its block's centre, so its value is the mean ± slope/4: curvature adds the same
    there as to the mean. If it differs from the mean by more than `steepest`, the mean is used, so that nothing is
    stretched across a jump.
    """
    rows, columns = means.shape
    out = np.empty((height, width), dtype=np.float32)
    line = np.empty(columns, dtype=np.float32)
    limit = np.float32(steepest)
    eighth = np.float32(0.125)
    for i in range(height):
        nearest = means[i // 2]
        down = eighth if i % 2 else -eighth
        above, below = means[max(i // 2 - 1, 0)], means[min(i // 2 + 1, rows - 1)]
        for j in range(columns):
            line[j] = nearest[j] + down * (below[j] - above[j])
        for j in range(width):
            k = j // 2
            right = eighth if j % 2 else -eighth
            value = line[k] + right * (line[min(k + 1, columns - 1)] - line[max(k - 1, 0)])
            out[i, j] = value if abs(value - nearest[k]) < limit else nearest[k]
    return out


@fast_kernel
def push(
    values: Float32[Array, "h w"], weights: Float32[Array, "h w"], coarse: Float32[Array, "H W"]
) -> Float32[Array, "h w"]:
    """Fill values without weight from the coarser level, each with the mean over 3 × 3 of its pixels."""
    height, width = values.shape
    columns = coarse.shape[1]
    out = np.empty((height, width), dtype=np.float32)
    line = np.empty(columns + 2, dtype=np.float32)
    third = np.float32(1.0 / 3.0)
    for i in range(height):
        above, here, below = coarse[max(i - 1, 0) // 2], coarse[i // 2], coarse[min(i + 1, height - 1) // 2]
        for j in range(columns):
            line[j + 1] = third * (above[j] + here[j] + below[j])
        line[0], line[columns + 1] = line[1], line[columns]
        for side in range(2):
            beside = line[2 * side : 2 * side + columns]
            for j in range((width + 1 - side) // 2):
                spread = third * (line[j + 1] + line[j + 1] + beside[j])
                out[i, 2 * j + side] = values[i, 2 * j + side] if weights[i, 2 * j + side] > 0 else spread
    return out


@fast_kernel
def squared_slope(field: Float32[Array, "h w"]) -> Float32[Array, "h w"]:
    """Squared length of the gradient, by central differences, one-sided at the borders."""
    height, width = field.shape
    out = np.empty((height, width), dtype=np.float32)
    for i in range(height):
        above, below = field[max(i - 1, 0)], field[min(i + 1, height - 1)]
        row, here = out[i], field[i]
        share = np.float32(0.5) if 0 < i < height - 1 else np.float32(1.0)
        for j in range(1, width - 1):
            across, along = share * (below[j] - above[j]), np.float32(0.5) * (here[j + 1] - here[j - 1])
            row[j] = across * across + along * along
        for j in (0, width - 1):
            across, along = share * (below[j] - above[j]), here[min(j + 1, width - 1)] - here[max(j - 1, 0)]
            row[j] = across * across + along * along
    return out


@fast_kernel
def rim(values: Float32[Array, "h w"], level: float) -> Int32[Array, "n 2"]:
    """Column and row of the outermost pixels at or above a level, by their four neighbours."""
    height, width = values.shape
    limit = np.float32(level)
    found = np.empty((64, 2), dtype=np.int32)
    count = 0
    for i in range(height):
        above, here, below = values[max(i - 1, 0)], values[i], values[min(i + 1, height - 1)]
        for j in range(width):
            if here[j] < limit:
                continue
            least = min(min(above[j], below[j]), min(here[max(j - 1, 0)], here[min(j + 1, width - 1)]))
            if least >= limit and 0 < i < height - 1 and 0 < j < width - 1:
                continue
            if count == found.shape[0]:
                longer = np.empty((2 * count, 2), dtype=np.int32)
                for k in range(count):
                    longer[k, 0], longer[k, 1] = found[k]
                found = longer
            found[count, 0], found[count, 1] = j, i
            count += 1
    return found[:count]
