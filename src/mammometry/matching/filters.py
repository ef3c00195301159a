"""Compiled image filters of matching: blur, halve, double, and compare two fields of shifts.

As the kernels of `correlate` they work on C-contiguous float32 arrays, release the interpreter's lock and have plain
twins in the tests. Each reads its image once, row by row: at full size that is what costs the time.
"""

import numpy as np
from numba import njit

from mammometry.geometry.arrays import Array, Float32


def gaussian_taps(sigma_px: float) -> Float32[Array, " taps"]:
    """Sampled Gaussian out to 3 σ, of sum 1: the window of every local fit."""
    radius = max(1, int(np.ceil(3 * sigma_px)))
    taps = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma_px) ** 2)
    return (taps / taps.sum()).astype(np.float32)


@njit(cache=True, nogil=True, fastmath=True)
def blur(image: Float32[Array, "h w"], taps: Float32[Array, " taps"]) -> Float32[Array, "h w"]:
    """Convolve rows and columns with an odd number of symmetric taps; beyond the borders the image goes on as there."""
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


@njit(cache=True, nogil=True, fastmath=True)
def halve(image: Float32[Array, "h w"], taps: Float32[Array, " taps"]) -> Float32[Array, "H W"]:
    """Filter with an even number of taps and keep every other row and column, new pixels between two old ones."""
    height, width = image.shape
    reach = taps.shape[0] // 2 - 1
    rows, columns = (height + 1) // 2, (width + 1) // 2
    out = np.empty((rows, columns), dtype=np.float32)
    line = np.empty(2 * columns + 2 * reach, dtype=np.float32)
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
        for j in range(columns):
            total = np.float32(0.0)
            for k in range(taps.shape[0]):
                total += taps[k] * line[2 * j + k]
            out[i, j] = total
    return out


@njit(cache=True, nogil=True, fastmath=True)
def double(field: Float32[Array, "h w"], height: int, width: int, steepest: float) -> Float32[Array, "H W"]:
    """Linear interpolation on a grid twice as fine, but not across jumps.

    Where it differs from the nearest value by more than `steepest`, that one is taken, so that nothing is stretched.
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
        for j in range(width):
            column = j // 2
            value = near * line[column + 1] + far * line[column + 2 * (j % 2)]
            out[i, j] = value if abs(value - nearest[column]) < limit else nearest[column]
    return out


@njit(cache=True, nogil=True, fastmath=True)
def there_and_back(ours: Float32[Array, "h w"], theirs: Float32[Array, "h w"]) -> Float32[Array, "h w"]:
    """How far a pixel lands from itself when it goes to the other image and back, pixels; the width where it leaves."""
    height, width = ours.shape
    out = np.empty((height, width), dtype=np.float32)
    for i in range(height):
        for j in range(width):
            target = np.float32(j) + ours[i, j]
            if target < 0 or target > width - 1:
                out[i, j] = np.float32(width)
                continue
            column = min(int(target), width - 2)
            fraction = target - np.float32(column)
            back = (np.float32(1.0) - fraction) * theirs[i, column] + fraction * theirs[i, column + 1]
            out[i, j] = abs(ours[i, j] + back)
    return out


@njit(cache=True, nogil=True, fastmath=True)
def pull(
    values: Float32[Array, "h w"], weights: Float32[Array, "h w"]
) -> tuple[Float32[Array, "H W"], Float32[Array, "H W"]]:
    """Weighted means of blocks of 2 × 2 pixels (0 where nothing has weight), and the blocks' weights."""
    height, width = values.shape
    rows, columns = (height + 1) // 2, (width + 1) // 2
    means = np.zeros((rows, columns), dtype=np.float32)
    mass = np.zeros((rows, columns), dtype=np.float32)
    for i in range(rows):
        for j in range(columns):
            total, weight = np.float32(0.0), np.float32(0.0)
            for a in range(2 * i, min(2 * i + 2, height)):
                for b in range(2 * j, min(2 * j + 2, width)):
                    weight += weights[a, b]
                    total += weights[a, b] * values[a, b]
            mass[i, j] = weight
            if weight > 0:
                means[i, j] = total / weight
    return means, mass


@njit(cache=True, nogil=True, fastmath=True)
def from_blocks(means: Float32[Array, "h w"], height: int, width: int, steepest: float) -> Float32[Array, "H W"]:
    """Values at the pixels of a field of which the means over blocks of 2 × 2 pixels are given; exact for quadratics.

    A pixel lies a quarter of a block from its block's middle: mean ± slope/4, for what the curvature adds there is what
    it has added to the mean. Where that is more than `steepest` the mean is taken: nothing is stretched across a jump.
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


@njit(cache=True, nogil=True, fastmath=True)
def push(
    values: Float32[Array, "h w"], weights: Float32[Array, "h w"], coarse: Float32[Array, "H W"]
) -> Float32[Array, "h w"]:
    """The values where they have weight; elsewhere the mean over 3 × 3 pixels of the coarse ones, each repeated."""
    height, width = values.shape
    out = np.empty((height, width), dtype=np.float32)
    ninth = np.float32(1.0 / 9.0)
    for i in range(height):
        for j in range(width):
            if weights[i, j] > 0:
                out[i, j] = values[i, j]
                continue
            total = np.float32(0.0)
            for a in range(i - 1, i + 2):
                for b in range(j - 1, j + 2):
                    total += coarse[min(max(a, 0), height - 1) // 2, min(max(b, 0), width - 1) // 2]
            out[i, j] = total * ninth
    return out
