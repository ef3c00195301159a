"""Compiled kernels of smoothing.

Planes are fitted in windows; beside a jump a window is chosen. As those of `correlate` they work on C-contiguous
float32 arrays, release the interpreter's lock and have NumPy twins in the tests.
"""

import numpy as np

from mammometry.base.machine.compiled import fast_kernel, kernel
from mammometry.geometry.arrays import Array, Float32, UInt8

_TILE_COLUMNS = 128  # a tile's sums fit a processor's nearest cache
_DAMPING = np.float32(0.02)  # of the window's own spread, added to that of the data: bounds one-sided slopes
"""Damping of the plane fits. A tenth of it left the rim unchanged (docs/decisions/0015, last lines of its second
table).
"""
# Vertical sums of w, wy, wy², wd, wdy, wd²; of each, where its horizontal sums with 1, x and x² go (−1: not wanted).
_HORIZONTAL = ((0, 0, 1, 2), (1, 3, 4, -1), (2, 5, -1, -1), (3, 6, 7, -1), (4, 8, -1, -1), (5, 9, -1, -1))
_BETTER = np.float32(0.25)  # of its own scatter: a window that gains less is not exchanged; chosen by eye
_OFFSETS = np.array([(0, 0), (-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)], dtype=np.int64)


@fast_kernel
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
    damping = _DAMPING * spread
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
        columns[:] = np.float32(0.0)
        # Rows taken one by one are contiguous to the compiler, which then adds eight pixels at once.
        start = first - left + radius
        c0, c1, c2 = columns[0, start:], columns[1, start:], columns[2, start:]
        c3, c4, c5 = columns[3, start:], columns[4, start:], columns[5, start:]
        for i in range(height):
            w_line, d_line = weights[i, first:last], values[i, first:last]
            for j in range(wide):
                w = taps[radius] * w_line[j]
                d = w * d_line[j]
                c0[j], c1[j], c2[j] = w, np.float32(0.0), np.float32(0.0)
                c3[j], c4[j], c5[j] = d, np.float32(0.0), d * d_line[j]
            for k in range(1, radius + 1):
                t0, t1, t2 = taps[radius + k], along[radius + k], square[radius + k]
                above_w = weights[i - k, first:last] if i >= k else nothing[:wide]
                above = values[i - k, first:last] if i >= k else nothing[:wide]
                below_w = weights[i + k, first:last] if i + k < height else nothing[:wide]
                below = values[i + k, first:last] if i + k < height else nothing[:wide]
                for j in range(wide):
                    w, other_w = below_w[j], above_w[j]
                    d, other_d = w * below[j], other_w * above[j]
                    c0[j] += t0 * (w + other_w)
                    c1[j] += t1 * (w - other_w)
                    c2[j] += t2 * (w + other_w)
                    c3[j] += t0 * (d + other_d)
                    c4[j] += t1 * (d - other_d)
                    c5[j] += t0 * (d * below[j] + other_d * above[j])
            if columns[0].max() <= np.float32(1e-9):
                continue
            # Of each vertical sum, its horizontal ones: plain, and weighted by the distance or by its square.
            for source, plain, first_moment, second_moment in _HORIZONTAL:
                line, total = columns[source], sums[plain]
                middle = line[radius:]
                for j in range(_TILE_COLUMNS):
                    total[j] = taps[radius] * middle[j]
                for k in range(1, radius + 1):
                    t0, before, after = taps[radius + k], line[radius - k :], line[radius + k :]
                    for j in range(_TILE_COLUMNS):
                        total[j] += t0 * (after[j] + before[j])
                if first_moment >= 0:
                    total = sums[first_moment]
                    total[:] = np.float32(0.0)
                    for k in range(1, radius + 1):
                        t1, before, after = along[radius + k], line[radius - k :], line[radius + k :]
                        for j in range(_TILE_COLUMNS):
                            total[j] += t1 * (after[j] - before[j])
                if second_moment >= 0:
                    total = sums[second_moment]
                    total[:] = np.float32(0.0)
                    for k in range(1, radius + 1):
                        t2, before, after = square[radius + k], line[radius - k :], line[radius + k :]
                        for j in range(_TILE_COLUMNS):
                            total[j] += t2 * (after[j] + before[j])
            for j in range(_TILE_COLUMNS):  # the results overwrite sums, whose place the loop has passed
                m = sums[0, j]
                known = m > np.float32(1e-9)
                scale = np.float32(1.0) / (m if known else np.float32(1.0))
                x, y, d = sums[1, j] * scale, sums[3, j] * scale, sums[6, j] * scale
                xx = sums[2, j] * scale - x * x + damping
                xy = sums[4, j] * scale - x * y
                yy = sums[5, j] * scale - y * y + damping
                dx = sums[7, j] * scale - d * x
                dy = sums[8, j] * scale - d * y
                inverse = np.float32(1.0) / (xx * yy - xy * xy if known else np.float32(1.0))
                along_u = (dx * yy - dy * xy) * inverse
                along_v = (dy * xx - dx * xy) * inverse
                scatter = max(sums[9, j] * scale - d * d - along_u * dx - along_v * dy, np.float32(0.0))
                sums[4, j] = m
                sums[0, j] = d - x * along_u - y * along_v if known else np.float32(0.0)
                sums[1, j] = along_u if known else np.float32(0.0)
                sums[2, j] = along_v if known else np.float32(0.0)
                sums[3, j] = scatter if known else np.float32(0.0)
            for q in range(5):
                for j in range(inner):
                    planes[q, i, left + j] = sums[q, j]


@kernel
def choose_windows(
    planes: Float32[Array, "5 h w"], values: Float32[Array, "h w"], reach: int, jump: float, least_mass: float
) -> UInt8[Array, "h w"]:
    """Beside a jump, choose a window on the pixel's own side.

    0 is its own, 1 … 8 those around it. Only windows whose values scatter by more than `jump` about their plane are
    exchanged. The best one has little scatter, and a plane that meets the pixel's own value.
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


@kernel
def evaluate_planes(planes: Float32[Array, "5 h w"], choice: UInt8[Array, "h w"], reach: int) -> Float32[Array, "h w"]:
    """Value at each pixel of the plane of its window."""
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
