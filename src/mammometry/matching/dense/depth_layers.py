"""Windows restricted to one layer of depth, for depth jumps and where ordinary windows fail.

A window across a depth jump mixes two surfaces: its match drifts and is rejected, and smoothing stretches skin across
the jump. Here sums include only neighbours whose shift continues the pixel's own. NumPy versions of the kernels are in
the tests.
"""

import numpy as np

from mammometry.base.machine.compiled import fast_kernel, kernel
from mammometry.geometry.arrays import Array, Bool, Float32, Int64
from mammometry.matching.correlation_kernels import shift_of_sums

_JUMP_PX = 1.5  # jump within 3 × 3 pixels; skin that steep is never matched; from prototypes on rendered captures
_FEWEST_CONNECTED = 10  # pixels; smaller jumps are noise
_SAME_LAYER_PX = np.float32(1.0)  # largest deviation of a neighbour on the same layer from the pixel's tangent
_SAME_LAYER_SLOPE = np.float32(0.12)  # … plus this per pixel of distance
_LANES = 8  # float32 numbers per vector instruction: window rows are read in multiples of it


def beside_jump(shift: Float32[Array, "h w"], mask: Bool[Array, "h w"], reach_px: int) -> Bool[Array, "h w"]:
    """Pixels in the mask within `reach_px` of a jump of the shift."""
    return discs(without_specks(jumps(shift, mask), _FEWEST_CONNECTED), reach_px)


@fast_kernel
def jumps(shift: Float32[Array, "h w"], mask: Bool[Array, "h w"]) -> Bool[Array, "h w"]:
    """Pixels whose 3 × 3 masked neighbours' shifts differ too much for one surface."""
    height, width = shift.shape
    out = np.zeros((height, width), dtype=np.bool_)
    limit, far = np.float32(_JUMP_PX), np.float32(1e9)
    # Lowest and highest shift of three masked neighbours along each of three rows.
    line = np.empty((2, width + 2), dtype=np.float32)
    lowest, highest = np.empty((3, width), dtype=np.float32), np.empty((3, width), dtype=np.float32)
    line[0], line[1] = far, -far
    for i in range(-1, height):
        if i + 1 < height:
            for j in range(width):
                line[0, j + 1] = shift[i + 1, j] if mask[i + 1, j] else far
                line[1, j + 1] = shift[i + 1, j] if mask[i + 1, j] else -far
            low, high = lowest[(i + 1) % 3], highest[(i + 1) % 3]
            for j in range(width):
                low[j] = min(line[0, j], min(line[0, j + 1], line[0, j + 2]))
                high[j] = max(line[1, j], max(line[1, j + 1], line[1, j + 2]))
        if i < 0:
            continue
        above, below = max(i - 1, 0) % 3, min(i + 1, height - 1) % 3
        for j in range(width):
            low_here = min(lowest[above, j], min(lowest[i % 3, j], lowest[below, j]))
            high_here = max(highest[above, j], max(highest[i % 3, j], highest[below, j]))
            out[i, j] = mask[i, j] and high_here - low_here > limit
    return out


@kernel
def without_specks(marks: Bool[Array, "h w"], fewest: int) -> Bool[Array, "h w"]:
    """Remove groups of fewer than `fewest` marks. Marks are connected at sides or corners."""
    height, width = marks.shape
    out = marks.copy()
    waiting = marks.copy()
    part = np.empty((np.count_nonzero(marks), 2), dtype=np.int32)
    for i in range(height):
        for j in range(width):
            if not waiting[i, j]:
                continue
            part[0, 0], part[0, 1] = i, j
            waiting[i, j] = False
            count, next_one = 1, 0
            while next_one < count:
                row, column = part[next_one]
                next_one += 1
                for a in range(max(row - 1, 0), min(row + 2, height)):
                    for b in range(max(column - 1, 0), min(column + 2, width)):
                        if waiting[a, b]:
                            waiting[a, b] = False
                            part[count, 0], part[count, 1] = a, b
                            count += 1
            if count < fewest:
                for k in range(count):
                    out[part[k, 0], part[k, 1]] = False
    return out


@kernel
def discs(seeds: Bool[Array, "h w"], radius: int) -> Bool[Array, "h w"]:
    """Pixels within `radius` of a seed."""
    height, width = seeds.shape
    out = np.zeros((height, width), dtype=np.bool_)
    for i in range(height):
        for j in range(width):
            if seeds[i, j]:
                for a in range(max(i - radius, 0), min(i + radius + 1, height)):
                    half = int(np.sqrt(radius * radius - (a - i) * (a - i)))
                    for b in range(max(j - half, 0), min(j + half + 1, width)):
                        out[a, b] = True
    return out


@fast_kernel
def _tangent(layers, i, j):  # type: ignore[no-untyped-def]
    """Slopes of the shift at a pixel, along columns and rows, each from the flatter side."""
    height, width = layers.shape
    here = layers[i, j]
    before = here - layers[i, j - 1] if j > 0 else layers[i, j + 1] - here
    after = layers[i, j + 1] - here if j < width - 1 else before
    above = here - layers[i - 1, j] if i > 0 else layers[i + 1, j] - here
    below = layers[i + 1, j] - here if i < height - 1 else above
    along = before if abs(before) < abs(after) else after
    across = above if abs(above) < abs(below) else below
    return along, across


@fast_kernel
def layered_least_squares(
    pixels: tuple[Int64[Array, " n"], Int64[Array, " n"]],
    images: tuple[Float32[Array, "h w"], Float32[Array, "h w"], Float32[Array, "h w"], Float32[Array, "h w"]],
    layers: Float32[Array, "h w"],
    taps: Float32[Array, " taps"],
    floor: float,
) -> Float32[Array, "4 n"]:
    """`least_squares` at chosen pixels (rows and columns), with weight only on the pixel's own layer.

    `images` are the first four arguments of `least_squares`. `layers` is the shift that distinguishes layers: a
    neighbour belongs to the pixel's layer if it continues the pixel's tangent.

    Returns the shift, correlation, window's mass and shift's variance of each chosen pixel.
    """
    rows, columns = pixels
    here, there, slope, weight = images
    height, width = here.shape
    count = taps.shape[0]
    radius = count // 2
    read = _LANES * ((count + _LANES - 1) // _LANES)
    # For each column of a window, and a few more without a tap: distance, tap, and largest allowed deviation.
    wide = radius + count + _LANES
    right = np.empty(wide, dtype=np.float32)
    along_row = np.empty(wide, dtype=np.float32)
    limits = np.empty((count, wide), dtype=np.float32)
    for b in range(wide):
        right[b], along_row[b] = b - radius, taps[b] if b < count else np.float32(0.0)
        for a in range(count):
            limits[a, b] = _SAME_LAYER_PX + _SAME_LAYER_SLOPE * np.float32(max(abs(a - radius), abs(b - radius)))
    squares = np.float32(0.0)
    for k in range(count):
        squares += taps[k] * taps[k]
    concentration = squares * squares
    flat = np.float32(floor)
    out = np.empty((4, rows.shape[0]), dtype=np.float32)
    for n in range(rows.shape[0]):
        i, j = rows[n], columns[n]
        along, across = _tangent(layers, i, j)
        first = max(0, j - radius)
        part = slice(first, min(width, first + read))
        window = slice(part.start - j + radius, part.stop - j + radius)
        x, column_taps = right[window], along_row[window]
        m = mr = mg = mrr = mrg = mgg = ml = mlr = mlg = mll = np.float32(0.0)
        top, bottom = max(0, i - radius), min(height, i + radius + 1)
        for a in range(top, bottom, 2):  # two rows at a time: a row's overhead is as large as its sums
            e = min(a + 1, height - 1)
            tap_a, tap_e = taps[a - i + radius], taps[a + 1 - i + radius] if a + 1 < bottom else np.float32(0.0)
            tangent_a = layers[i, j] + across * np.float32(a - i)
            limit_a, limit_e = limits[a - i + radius, window], limits[min(a + 1 - i + radius, count - 1), window]
            layer_a, layer_e, given_a, given_e = layers[a, part], layers[e, part], weight[a, part], weight[e, part]
            here_a, here_e, there_a, there_e = here[a, part], here[e, part], there[a, part], there[e, part]
            slope_a, slope_e = slope[a, part], slope[e, part]
            # No branch in this loop, and its sums in registers, so that it is vectorised.
            for b in range(x.shape[0]):
                tangent = tangent_a + along * x[b]
                w = given_a[b] * column_taps[b] * tap_a
                w = w if abs(layer_a[b] - tangent) <= limit_a[b] else np.float32(0.0)
                v = given_e[b] * column_taps[b] * tap_e
                v = v if abs(layer_e[b] - tangent - across) <= limit_e[b] else np.float32(0.0)
                l, r, g = here_a[b], there_a[b], slope_a[b]  # noqa: E741
                k, s, f = here_e[b], there_e[b], slope_e[b]
                wr, wg, wl = w * r, w * g, w * l
                vr, vg, vl = v * s, v * f, v * k
                m += w + v
                mr += wr + vr
                mg += wg + vg
                mrr += wr * r + vr * s
                mrg += wr * g + vr * f
                mgg += wg * g + vg * f
                ml += wl + vl
                mlr += wl * r + vl * s
                mlg += wl * g + vl * f
                mll += wl * l + vl * k
        out[2, n] = m
        out[0, n], out[1, n], out[3, n] = shift_of_sums(
            m, mr, mg, mrr, mrg, mgg, ml, mlr, mlg, mll, flat, concentration
        )
    return out
