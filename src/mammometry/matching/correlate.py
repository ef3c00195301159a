"""Compiled kernels of matching, and only them; `match` composes them. Each has a plain NumPy twin in the tests.

All work on C-contiguous float32 arrays of one pyramid level and release the interpreter's lock, so that several may run
at once in threads. A GPU implementation can stand beside this module behind the same names.
"""

import numpy as np
from numba import njit

from mammometry.geometry.arrays import Array, Bool, Float32, UInt8

_BAND_ROWS = 64
_BETTER = np.float32(0.25)  # of its own scatter: a window that gains less is not exchanged
_OFFSETS = np.array([(0, 0), (-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)], dtype=np.int64)


def gaussian_taps(sigma_px: float) -> Float32[Array, " taps"]:
    """Sampled Gaussian out to 3 σ, of sum 1: the window of every local fit."""
    radius = max(1, int(np.ceil(3 * sigma_px)))
    taps = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma_px) ** 2)
    return (taps / taps.sum()).astype(np.float32)


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


@njit(cache=True, nogil=True, fastmath=True)
def plane_fit(
    values: Float32[Array, "h w"], weights: Float32[Array, "h w"], taps: Float32[Array, " taps"]
) -> Float32[Array, "5 h w"]:
    """Plane fitted around each pixel, window `taps` ⊗ `taps` times `weights`.

    Returns its value at the pixel, its slopes along u and v, the variance of the values about it, and the window's
    mass. Where the neighbours lie on one side only, the slopes are damped, so that the plane does not run away.
    """
    height, width = values.shape
    count = taps.shape[0]
    radius = count // 2
    planes = np.zeros((5, height, width), dtype=np.float32)
    first = np.empty(count, dtype=np.float32)
    second = np.empty(count, dtype=np.float32)
    spread = np.float32(0.0)
    for k in range(count):
        first[k] = taps[k] * np.float32(k - radius)
        second[k] = first[k] * np.float32(k - radius)
        spread += second[k]
    damping = np.float32(0.02) * spread
    # Vertical sums: weight × (1, y, y²), weighted value × (1, y), weighted square; then ten horizontal ones.
    columns = np.zeros((6, width + 2 * radius), dtype=np.float32)
    sums = np.zeros((10, width), dtype=np.float32)
    for i in range(height):
        for q in range(6):
            for j in range(width):
                columns[q, radius + j] = 0.0
        for k in range(max(0, radius - i), min(count, height + radius - i)):
            t0, t1, t2 = taps[k], first[k], second[k]
            weight_line = weights[i + k - radius]
            value_line = values[i + k - radius]
            for j in range(width):
                w = weight_line[j]
                d = w * value_line[j]
                columns[0, radius + j] += t0 * w
                columns[1, radius + j] += t1 * w
                columns[2, radius + j] += t2 * w
                columns[3, radius + j] += t0 * d
                columns[4, radius + j] += t1 * d
                columns[5, radius + j] += t0 * d * value_line[j]
        for q in range(10):
            for j in range(width):
                sums[q, j] = 0.0
        for k in range(count):
            t0, t1, t2 = taps[k], first[k], second[k]
            for j in range(width):
                sums[0, j] += t0 * columns[0, j + k]
                sums[1, j] += t1 * columns[0, j + k]
                sums[2, j] += t2 * columns[0, j + k]
                sums[3, j] += t0 * columns[1, j + k]
                sums[4, j] += t1 * columns[1, j + k]
                sums[5, j] += t0 * columns[2, j + k]
                sums[6, j] += t0 * columns[3, j + k]
                sums[7, j] += t1 * columns[3, j + k]
                sums[8, j] += t0 * columns[4, j + k]
                sums[9, j] += t0 * columns[5, j + k]
        for j in range(width):
            m = sums[0, j]
            planes[4, i, j] = m
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
            planes[0, i, j] = d - x * along_u - y * along_v
            planes[1, i, j] = along_u
            planes[2, i, j] = along_v
            planes[3, i, j] = max(sums[9, j] * scale - d * d - along_u * dx - along_v * dy, np.float32(0.0))
    return planes


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


@njit(cache=True, nogil=True, fastmath=True)
def matching_costs(
    here: Float32[Array, "h w 9"],
    there: Float32[Array, "h w 9"],
    here_mask: Bool[Array, "h w"],
    there_mask: Bool[Array, "h w"],
    lowest: int,
    count: int,
    outside: float,
) -> Float32[Array, "h w d"]:
    """1 − correlation of the 3 × 3 neighbourhoods (unit vectors) for the shifts lowest … lowest + count − 1.

    `outside` is the cost of a partner that is not the subject.
    """
    height, width = here_mask.shape
    costs = np.empty((height, width, count), dtype=np.float32)
    for i in range(height):
        for j in range(width):
            for d in range(count):
                partner = j + lowest + d
                if not here_mask[i, j]:
                    costs[i, j, d] = 0.0
                elif partner < 0 or partner >= width or not there_mask[i, partner]:
                    costs[i, j, d] = outside
                else:
                    total = np.float32(0.0)
                    for k in range(9):
                        total += here[i, j, k] * there[i, partner, k]
                    costs[i, j, d] = np.float32(1.0) - total
    return costs


@njit(cache=True, nogil=True, fastmath=True)
def aggregate(
    costs: Float32[Array, "h w d"], mask: Bool[Array, "h w"], small_step: float, large_step: float
) -> Float32[Array, "h w d"]:
    """Sum of the costs along eight paths that end at each pixel (semi-global matching, Hirschmüller 2008).

    A change of the shift by one pixel costs `small_step`, by more `large_step`. Paths do not cross what is not masked.
    """
    height, width, count = costs.shape
    total = np.zeros((height, width, count), dtype=np.float32)
    p1 = np.float32(small_step)
    p2 = np.float32(large_step)
    far = np.float32(1e6)
    for backward in range(2):
        # Paths from the row above (left, middle, right) and from the pixel before; padded by one disparity each side.
        above = np.full((3, width + 2, count + 2), far, dtype=np.float32)
        above_least = np.full((3, width + 2), np.float32(-1.0), dtype=np.float32)
        current = np.full((3, width + 2, count + 2), far, dtype=np.float32)
        current_least = np.full((3, width + 2), np.float32(-1.0), dtype=np.float32)
        before = np.full(count + 2, far, dtype=np.float32)
        updated = np.full(count + 2, far, dtype=np.float32)
        for ii in range(height):
            i = height - 1 - ii if backward else ii
            before_least = np.float32(-1.0)
            for jj in range(width):
                j = width - 1 - jj if backward else jj
                if not mask[i, j]:
                    before_least = np.float32(-1.0)
                    for path in range(3):
                        current_least[path, jj + 1] = np.float32(-1.0)
                    continue
                for path in range(4):
                    if path < 3:
                        previous = above[path, jj + path]
                        least = above_least[path, jj + path]
                        target = current[path, jj + 1]
                    else:
                        previous = before
                        least = before_least
                        target = updated
                    smallest = far
                    if least < 0:
                        for d in range(count):
                            value = costs[i, j, d]
                            target[d + 1] = value
                            total[i, j, d] += value
                            smallest = min(smallest, value)
                    else:
                        jump = least + p2
                        for d in range(count):
                            value = min(min(previous[d], previous[d + 2]) + p1, min(previous[d + 1], jump))
                            value += costs[i, j, d] - least
                            target[d + 1] = value
                            total[i, j, d] += value
                            smallest = min(smallest, value)
                    if path < 3:
                        current_least[path, jj + 1] = smallest
                    else:
                        before_least = smallest
                before, updated = updated, before
            above, current = current, above
            above_least, current_least = current_least, above_least
    return total


@njit(cache=True, nogil=True, fastmath=True)
def cheapest(
    total: Float32[Array, "h w d"], mask: Bool[Array, "h w"], lowest: int
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"]]:
    """Shift of least cost seen from this image and, along the diagonals of the same volume, from the other one.

    Sub-pixel by a parabola for this image; NaN-free: where nothing competes the shift is that of the range's middle.
    """
    height, width, count = total.shape
    middle = np.float32(lowest + count // 2)
    ours = np.full((height, width), middle, dtype=np.float32)
    theirs = np.full((height, width), -middle, dtype=np.float32)
    for i in range(height):
        best = np.full(width, np.float32(1e9), dtype=np.float32)
        for j in range(width):
            if not mask[i, j]:
                continue
            least = np.float32(1e9)
            at = 0
            for d in range(count):
                value = total[i, j, d]
                if value < least:
                    least = value
                    at = d
                partner = j + lowest + d
                if 0 <= partner < width and value < best[partner]:
                    best[partner] = value
                    theirs[i, partner] = -np.float32(lowest + d)
            offset = np.float32(0.0)
            if 0 < at < count - 1:
                low, high = total[i, j, at - 1], total[i, j, at + 1]
                bend = low + high - np.float32(2.0) * least
                if bend > np.float32(1e-6):
                    offset = np.float32(0.5) * (low - high) / bend
            ours[i, j] = np.float32(lowest + at) + offset
    return ours, theirs
