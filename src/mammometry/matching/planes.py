"""Compiled kernels of smoothing: planes fitted in windows, and the choice between windows beside a jump.

As those of `correlate` they work on C-contiguous float32 arrays, release the interpreter's lock and have NumPy twins in
the tests.
"""

import numpy as np
from numba import njit

from mammometry.geometry.arrays import Array, Float32, UInt8

_TILE_COLUMNS = 128
_BETTER = np.float32(0.25)  # of its own scatter: a window that gains less is not exchanged
_OFFSETS = np.array([(0, 0), (-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)], dtype=np.int64)


@njit(cache=True, nogil=True, fastmath=True)
def plane_fit(
    values: Float32[Array, "h w"],
    weights: Float32[Array, "h w"],
    taps: Float32[Array, " taps"],
    planes: Float32[Array, "5 h w"],
) -> None:
    """Plane fitted around each pixel, window `taps` ⊗ `taps` times `weights`.

    Written to `planes` are its value at the pixel, its slopes along u and v, the variance of the values about it, and
    the window's mass; all are 0 where nothing has weight. Where the neighbours lie on one side only, the slopes are
    damped, so that the plane does not run away.
    """
    height, width = values.shape
    count = taps.shape[0]
    radius = count // 2
    planes[:] = np.float32(0.0)
    along = np.empty(count, dtype=np.float32)
    square = np.empty(count, dtype=np.float32)
    spread = np.float32(0.0)
    for k in range(count):
        along[k] = taps[k] * np.float32(k - radius)
        square[k] = along[k] * np.float32(k - radius)
        spread += square[k]
    damping = np.float32(0.02) * spread
    # The window is symmetric: neighbours at equal distance on either side are added, or subtracted, first.
    # Vertical sums: weight × (1, y, y²), weighted value × (1, y), weighted square; then ten horizontal ones. Done in
    # tiles of columns, whose sums stay in the processor's nearest memory, and not where nothing has weight.
    columns = np.zeros((6, _TILE_COLUMNS + 2 * radius), dtype=np.float32)
    sums = np.zeros((10, _TILE_COLUMNS), dtype=np.float32)
    nothing = np.zeros(_TILE_COLUMNS + 2 * radius, dtype=np.float32)  # beyond the first and the last row
    for left in range(0, width, _TILE_COLUMNS):
        inner = min(_TILE_COLUMNS, width - left)
        first, last = max(0, left - radius), min(width, left + inner + radius)
        wide = last - first
        part = columns[:, first - left + radius : last - left + radius]
        columns[:] = np.float32(0.0)
        for i in range(height):
            w_line, d_line = weights[i, first:last], values[i, first:last]
            for j in range(wide):
                w = taps[radius] * w_line[j]
                d = w * d_line[j]
                part[0, j] = w
                part[1, j] = np.float32(0.0)
                part[2, j] = np.float32(0.0)
                part[3, j] = d
                part[4, j] = np.float32(0.0)
                part[5, j] = d * d_line[j]
            for k in range(1, radius + 1):
                t0, t1, t2 = taps[radius + k], along[radius + k], square[radius + k]
                above_w = weights[i - k, first:last] if i >= k else nothing[:wide]
                above = values[i - k, first:last] if i >= k else nothing[:wide]
                below_w = weights[i + k, first:last] if i + k < height else nothing[:wide]
                below = values[i + k, first:last] if i + k < height else nothing[:wide]
                for j in range(wide):
                    w, other_w = below_w[j], above_w[j]
                    d, other_d = w * below[j], other_w * above[j]
                    part[0, j] += t0 * (w + other_w)
                    part[1, j] += t1 * (w - other_w)
                    part[2, j] += t2 * (w + other_w)
                    part[3, j] += t0 * (d + other_d)
                    part[4, j] += t1 * (d - other_d)
                    part[5, j] += t0 * (d * below[j] + other_d * above[j])
            if part[0].max() <= np.float32(1e-9):
                continue
            centre = columns[:, radius : radius + inner]
            for j in range(inner):
                sums[0, j] = taps[radius] * centre[0, j]
                sums[1, j] = np.float32(0.0)
                sums[2, j] = np.float32(0.0)
                sums[3, j] = taps[radius] * centre[1, j]
                sums[4, j] = np.float32(0.0)
                sums[5, j] = taps[radius] * centre[2, j]
                sums[6, j] = taps[radius] * centre[3, j]
                sums[7, j] = np.float32(0.0)
                sums[8, j] = taps[radius] * centre[4, j]
                sums[9, j] = taps[radius] * centre[5, j]
            for k in range(1, radius + 1):
                t0, t1, t2 = taps[radius + k], along[radius + k], square[radius + k]
                after = columns[:, radius + k : radius + k + inner]
                before = columns[:, radius - k : radius - k + inner]
                for j in range(inner):
                    both = after[0, j] + before[0, j]
                    sums[0, j] += t0 * both
                    sums[1, j] += t1 * (after[0, j] - before[0, j])
                    sums[2, j] += t2 * both
                    sums[3, j] += t0 * (after[1, j] + before[1, j])
                    sums[4, j] += t1 * (after[1, j] - before[1, j])
                    sums[5, j] += t0 * (after[2, j] + before[2, j])
                    sums[6, j] += t0 * (after[3, j] + before[3, j])
                    sums[7, j] += t1 * (after[3, j] - before[3, j])
                    sums[8, j] += t0 * (after[4, j] + before[4, j])
                    sums[9, j] += t0 * (after[5, j] + before[5, j])
            for j in range(inner):
                m = sums[0, j]
                planes[4, i, left + j] = m
                if m <= np.float32(1e-9):
                    continue
                scale = np.float32(1.0) / m
                x, y, d = sums[1, j] * scale, sums[3, j] * scale, sums[6, j] * scale
                xx = sums[2, j] * scale - x * x + damping
                xy = sums[4, j] * scale - x * y
                yy = sums[5, j] * scale - y * y + damping
                dx = sums[7, j] * scale - d * x
                dy = sums[8, j] * scale - d * y
                determinant = xx * yy - xy * xy
                along_u = (dx * yy - dy * xy) / determinant
                along_v = (dy * xx - dx * xy) / determinant
                planes[0, i, left + j] = d - x * along_u - y * along_v
                planes[1, i, left + j] = along_u
                planes[2, i, left + j] = along_v
                scatter = sums[9, j] * scale - d * d - along_u * dx - along_v * dy
                planes[3, i, left + j] = max(scatter, np.float32(0.0))


@njit(cache=True, nogil=True)
def choose_windows(
    planes: Float32[Array, "5 h w"], values: Float32[Array, "h w"], reach: int, jump: float, least_mass: float
) -> UInt8[Array, "h w"]:
    """Beside a jump, the neighbouring window that lies on the pixel's own side: 0 is its own, 1 … 8 those around it.

    Only windows whose values scatter by more than `jump` about their plane are exchanged. Wanted is little scatter, and
    a plane that meets the pixel's own value.
    """
    height, width = values.shape
    choice = np.zeros((height, width), dtype=np.uint8)
    limit = np.float32(jump * jump)
    for i in range(height):
        for j in range(width):
            if planes[3, i, j] < limit or planes[4, i, j] < least_mass:
                continue
            least = _BETTER * planes[3, i, j]
            for option in range(1, 9):
                row = i + _OFFSETS[option, 0] * reach
                column = j + _OFFSETS[option, 1] * reach
                if row < 0 or row >= height or column < 0 or column >= width or planes[4, row, column] < least_mass:
                    continue
                plane = planes[0, row, column]
                plane -= np.float32(reach) * (
                    planes[1, row, column] * _OFFSETS[option, 1] + planes[2, row, column] * _OFFSETS[option, 0]
                )
                own = values[i, j] - plane
                cost = planes[3, row, column] + own * own
                if cost < least:
                    least = cost
                    choice[i, j] = option
    return choice


@njit(cache=True, nogil=True)
def evaluate_planes(planes: Float32[Array, "5 h w"], choice: UInt8[Array, "h w"], reach: int) -> Float32[Array, "h w"]:
    """Value at each pixel of the plane of the window chosen for it."""
    height, width = choice.shape
    out = planes[0].copy()
    for i in range(height):
        for j in range(width):
            option = choice[i, j]
            if option > 0:
                row = i + _OFFSETS[option, 0] * reach
                column = j + _OFFSETS[option, 1] * reach
                out[i, j] = planes[0, row, column] - np.float32(reach) * (
                    planes[1, row, column] * _OFFSETS[option, 1] + planes[2, row, column] * _OFFSETS[option, 0]
                )
    return out
