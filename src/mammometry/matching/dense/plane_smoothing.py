"""Edge-preserving smoothing of disparity fields that keeps curvature and does not cross gaps.

Planes are fitted in windows; near a jump another window is chosen. The kernels work on C-contiguous float32 arrays,
release the GIL and have NumPy versions in the tests.
"""

import numpy as np

from mammometry.base.machine.compiled import fast_kernel, kernel
from mammometry.geometry.arrays import Array, Float32, Float64, UInt8
from mammometry.matching.filters import blur, double, from_blocks, gaussian_taps, pull, push

_TILE_COLUMNS = 128  # a tile's sums fit into the L1 cache
_DAMPING = np.float32(0.02)  # share of the window's spread added to that of the data: limits one-sided slopes
"""Damping of the plane fits. A tenth of it did not change the border (docs/decisions/0015, end of its second table)."""
# Vertical sums of w, wy, wy², wd, wdy, wd²; positions of their horizontal sums with 1, x and x² (−1: not needed).
_HORIZONTAL = ((0, 0, 1, 2), (1, 3, 4, -1), (2, 5, -1, -1), (3, 6, 7, -1), (4, 8, -1, -1), (5, 9, -1, -1))
_BETTER = np.float32(0.25)  # smallest gain, relative to a window's own scatter, for which another one is chosen
_OFFSETS = np.array([(0, 0), (-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)], dtype=np.int64)


@fast_kernel
def plane_fit(
    values: Float32[Array, "h w"],
    weights: Float32[Array, "h w"],
    taps: Float32[Array, " taps"],
    planes: Float32[Array, "5 h w"],
) -> None:
    """Fit a plane around each pixel, in the window `taps` ⊗ `taps` times `weights`.

    Writes to `planes` its value at the pixel, its slopes along u and v, the variance of the values about it, and the
    window's mass; all are 0 without weight. Slopes are damped, so that they stay small if the neighbours are on one
    side only.
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
    # The window is symmetric: neighbours at equal distances are added or subtracted first. Vertical sums come first:
    # weight × (1, y, y²), weighted value × (1, y), weighted square. Ten horizontal sums follow. They are computed in
    # tiles of columns, whose sums stay in the L1 cache; tiles without weight are skipped.
    columns = np.zeros((6, _TILE_COLUMNS + 2 * radius), dtype=np.float32)
    sums = np.zeros((10, _TILE_COLUMNS), dtype=np.float32)
    nothing = np.zeros(_TILE_COLUMNS + 2 * radius, dtype=np.float32)  # for rows outside the image
    for left in range(0, width, _TILE_COLUMNS):
        inner = min(_TILE_COLUMNS, width - left)
        first, last = max(0, left - radius), min(width, left + inner + radius)
        wide = last - first
        columns[:] = np.float32(0.0)
        # Separate rows are contiguous for the compiler, which then adds eight pixels at once.
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
            # Horizontal sums of each vertical one: plain, and weighted by the distance or its square.
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
            for j in range(_TILE_COLUMNS):  # the results overwrite sums that are no longer needed
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
    """Choose a window on the pixel's own side of a jump.

    0 is its own, 1 … 8 are those around it. Only windows whose values scatter by more than `jump` about their plane are
    replaced. The best one has little scatter and a plane that fits the pixel's own value.
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
    """Value at each pixel of its chosen window's plane."""
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


_JUMP_PX = 0.5  # scatter about the plane above which a window crosses a jump
_BAND_ROWS = 256  # limits memory
_WINDOW_MOVE = 2.0  # shift of a window in σ: at this distance it no longer contains the jump's other side
_NARROWEST_PX = 2.0  # σ from which samples at a distance of one pixel are enough (docs/decisions/0020: σ 4 on blocks)
_NOISE_PX = 4.0  # Gaussian σ over which variances are averaged
_ENOUGH_MASS = 1e-6  # smallest mass of a window, with weights scaled to a median of 1


def fill(values: Float32[Array, "h w"], weights: Float32[Array, "h w"]) -> Float32[Array, "h w"]:
    """Fill pixels of weight 0 from increasingly wide surroundings (push–pull)."""
    known = weights > 0
    if known.all() or not known.any():
        return values
    if min(values.shape) <= 2:
        return np.where(known, values, np.float32(np.average(values, weights=weights)))
    coarse, mass = pull(values, weights)
    return push(values, weights, fill(coarse, np.minimum(mass, np.float32(weights.max()))))


def smooth(
    values: Float32[Array, "h w"],
    weights: Float32[Array, "h w"],
    sigma_px: float,
    near: Float32[Array, "h w"] | None = None,
) -> Float32[Array, "h w"]:
    """Fit a plane in a Gaussian window around each pixel, twice.

    The smoothed residual is added back, which restores curvature. A single smoothing pulls convex skin inwards (a bias
    of depth); the second pass leaves only fourth-order terms. Near a depth jump the window moves to the pixel's own
    side. Pixels without any weighted neighbour are filled from wider surroundings.

    Wide windows are fitted to means of blocks of pixels, in an eighth of the time. `near` is a smooth field close to
    the values: within a block only differences from it are averaged, so that unequal weights on slopes cause no bias.
    """
    if near is not None and sigma_px / 2 >= _NARROWEST_PX and min(values.shape) > 2:
        coarse_near, _ = pull(near, np.ones_like(near))
        means, mass = pull(values - near, weights)
        means += coarse_near
        coarse = smooth(means, mass, sigma_px / 2, coarse_near)
        return from_blocks(coarse, values.shape[0], values.shape[1], _JUMP_PX)
    taps = gaussian_taps(sigma_px)
    reach = max(1, round(_WINDOW_MOVE * sigma_px))
    enough = _ENOUGH_MASS * float(weights.max())
    height = values.shape[0]
    result = np.empty_like(values)
    known = np.empty(values.shape, dtype=np.float32)
    halo = 2 * (len(taps) // 2 + reach)
    for top in range(0, height, _BAND_ROWS):  # planes of the whole image would need five times its memory
        bottom = min(top + _BAND_ROWS, height)
        read = slice(max(0, top - halo), min(height, bottom + halo))
        inner = slice(top - read.start, bottom - read.start)
        band, band_weights = values[read], weights[read]
        planes = np.empty((5, *band.shape), dtype=np.float32)
        plane_fit(band, band_weights, taps, planes)
        choice = choose_windows(planes, band, reach, _JUMP_PX, enough)
        once = evaluate_planes(planes, choice, reach)
        plane_fit(band - once, band_weights, taps, planes)  # the masses are unchanged
        once += evaluate_planes(planes, choice, reach)
        result[top:bottom] = once[inner]
        known[top:bottom] = planes[4, inner] > enough
    return fill(result, known)


def adaptively_smooth(
    values: Float32[Array, "h w"],
    weights: Float32[Array, "h w"],
    variance: Float32[Array, "h w"],
    window_sigma_px: float,
    scales_px: tuple[float, ...],
    factor: float,
    near: Float32[Array, "h w"] | None = None,
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"]]:
    """`smooth` at several scales, each pixel as finely as its noise allows.

    From the coarsest scale on, a finer one is used to the extent that it exceeds noise. `variance` is that of `values`,
    whose noise is correlated over the Gaussian window of σ `window_sigma_px`. A finer smoothing differs from the next
    coarser by relief and noise; the share 1 − factor·noise/D² of the difference D is kept (a Wiener filter). D² is
    averaged over the coarser scale, since a narrower mean would contain too few independent values. Variances and
    shares vary slowly and are computed for blocks of 2 × 2 pixels.

    Returns the smoothed field and its expected variance: the remaining noise plus the part of the relief that is not
    kept.
    """
    height, width = values.shape
    known = (weights > 0).astype(np.float32)

    def around(image: Float32[Array, "h w"], scale_px: float) -> Float32[Array, "H W"]:
        taps = gaussian_taps(max(scale_px, _NOISE_PX) / 2)
        means, mass = pull(image, known)
        means *= mass
        return blur(means, taps) / (blur(mass, taps) + np.float32(1e-6))

    local = around(variance, _NOISE_PX)
    expected = np.float32(smoothed_noise(scales_px[-1], window_sigma_px)) * local
    coarse = smooth(values, weights, scales_px[-1], near)
    result = coarse.copy()
    for index in range(len(scales_px) - 2, -1, -1):
        fine = smooth(values, weights, scales_px[index], near)
        difference = np.subtract(fine, coarse, out=coarse)
        coarse = fine
        power = around(np.square(difference), scales_px[index + 1])
        noise = np.float32(difference_noise(scales_px[index], scales_px[index + 1], window_sigma_px)) * local
        share = np.maximum(0, 1 - np.float32(factor) * noise / np.maximum(power, 1e-12))
        expected += share**2 * noise
        expected += (1 - share) ** 2 * np.maximum(power - noise, 0)
        difference *= double(share, height, width, np.inf)
        result += difference
        del fine, difference
    return fill(result, known), double(expected, height, width, np.inf)


def smoothed_noise(scale_px: float, window_sigma_px: float) -> float:
    """Variance of smoothed noise of variance 1 that is correlated by the matching window."""
    return _noise(_smoothing_gain(scale_px), window_sigma_px)


def difference_noise(fine_px: float, coarse_px: float, window_sigma_px: float) -> float:
    """Variance of the difference of two smoothings of unit noise correlated by the matching window."""
    return _noise(_smoothing_gain(fine_px) - _smoothing_gain(coarse_px), window_sigma_px)


def _smoothing_gain(scale_px: float) -> Float64[Array, "n n"]:
    # With equal weights a plane fit is the Gaussian mean G; applied twice it is 2 G − G².
    mean = np.outer(_response(scale_px), _response(scale_px))
    return np.asarray(2 * mean - mean**2)


def _noise(gain: Float64[Array, "n n"], window_sigma_px: float) -> float:
    window = np.outer(_response(window_sigma_px), _response(window_sigma_px)) ** 2
    return float((gain**2 * window).sum() / window.sum())


def _response(sigma_px: float) -> Float64[Array, " n"]:
    """Fourier transform of the Gaussian window along a row, for frequencies of 0 … 1 cycle per pixel."""
    taps = gaussian_taps(sigma_px).astype(np.float64)
    radius = len(taps) // 2
    signal = np.zeros(256)
    signal[: radius + 1] = taps[radius:]
    signal[-radius:] += taps[:radius]
    return np.asarray(np.fft.fft(signal).real)
