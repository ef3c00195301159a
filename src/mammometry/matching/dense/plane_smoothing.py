"""Edge-preserving smoothing of disparity fields.

It neither flattens curvature nor leaks across unknown pixels.
"""

import numpy as np

from mammometry.geometry.arrays import Array, Float32, Float64
from mammometry.matching.dense.plane_kernels import choose_windows, evaluate_planes, plane_fit
from mammometry.matching.filters import blur, double, from_blocks, gaussian_taps, pull, push

_JUMP_PX = 0.5  # scatter about the plane above which a window is taken to straddle a jump; chosen by eye
_BAND_ROWS = 256  # bounds memory
_WINDOW_MOVE = 2.0  # times σ: where a moved window no longer holds the pixel's other side; chosen by eye
_NARROWEST_PX = 2.0  # σ of a window for which samples a pixel apart are enough (docs/decisions/0020: σ 4 on blocks)
_NOISE_PX = 4.0  # Gaussian σ over which variances are averaged; chosen by eye
_ENOUGH_MASS = 1e-6  # of a window whose full mass is that of unit weights scaled to a median of 1


def fill(values: Float32[Array, "h w"], weights: Float32[Array, "h w"]) -> Float32[Array, "h w"]:
    """Fill pixels of weight 0 from ever wider surroundings (push–pull)."""
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

    The smoothed residual is added back, which restores curvature. Plain smoothing pulls convex skin inwards (a bias of
    depth); the second pass removes all but the fourth order of it. Beside a jump of depth the window moves to the
    pixel's own side. Pixels without any weighted neighbour are filled from wider surroundings.

    Wide windows are fitted to the means of blocks of pixels, at an eighth of the work. `near` is a smooth field not far
    from the values: within a block only what differs from it is averaged, so that unequal weights on slopes do no harm.
    """
    if near is not None and sigma_px / 2 >= _NARROWEST_PX and min(values.shape) > 2:
        coarse_near, _ = pull(near, np.ones_like(near))
        means, mass = pull(values - near, weights)
        means += coarse_near
        coarse = smooth(means, mass, sigma_px / 2, coarse_near)
        return from_blocks(coarse, values.shape[0], values.shape[1], _JUMP_PX)
    taps = gaussian_taps(sigma_px)
    reach = max(1, round(_WINDOW_MOVE * sigma_px))
    enough = _ENOUGH_MASS * max(float(weights.max()), 1e-30)
    height = values.shape[0]
    result = np.empty_like(values)
    known = np.empty(values.shape, dtype=np.float32)
    halo = 2 * (len(taps) // 2 + reach)
    for top in range(0, height, _BAND_ROWS):  # the planes of the whole image would take five times its memory
        bottom = min(top + _BAND_ROWS, height)
        read = slice(max(0, top - halo), min(height, bottom + halo))
        inner = slice(top - read.start, bottom - read.start)
        band, band_weights = values[read], weights[read]
        planes = np.empty((5, *band.shape), dtype=np.float32)
        plane_fit(band, band_weights, taps, planes)
        choice = choose_windows(planes, band, reach, _JUMP_PX, enough)
        once = evaluate_planes(planes, choice, reach)
        plane_fit(band - once, band_weights, taps, planes)  # the masses stay what they were
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
    """`smooth` at several scales, as finely as noise allows.

    From the coarsest on, a finer one counts as far as it exceeds noise. `variance` is that of `values`, whose noise is
    correlated over the Gaussian window of σ `window_sigma_px`. A finer smoothing differs from the next coarser by
    relief and by noise; of the difference D the share 1 − factor·noise/D² is kept (a Wiener filter). D² is averaged
    over the coarser scale: a narrower mean would hold too few independent values. Variances and shares vary slowly:
    they are computed for blocks of 2 × 2 pixels.

    Returns the smoothed field and its expected variance: the noise that the smoothings let through, and of the relief
    the part that is not kept.
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
    """Variance of smoothed noise. The noise has variance 1 and is correlated by the matching window."""
    return _noise(_smoothing_gain(scale_px), window_sigma_px)


def difference_noise(fine_px: float, coarse_px: float, window_sigma_px: float) -> float:
    """Variance of the difference of two smoothings of noise.

    The noise has variance 1 and is correlated by the matching window.
    """
    return _noise(_smoothing_gain(fine_px) - _smoothing_gain(coarse_px), window_sigma_px)


def _smoothing_gain(scale_px: float) -> Float64[Array, "n n"]:
    # With equal weights a plane fit is the Gaussian mean G; twicing makes it 2 G − G².
    mean = np.outer(_response(scale_px), _response(scale_px))
    return np.asarray(2 * mean - mean**2)


def _noise(gain: Float64[Array, "n n"], window_sigma_px: float) -> float:
    window = np.outer(_response(window_sigma_px), _response(window_sigma_px)) ** 2
    return float((gain**2 * window).sum() / window.sum())


def _response(sigma_px: float, length: int = 256) -> Float64[Array, " n"]:
    """Fourier transform of the Gaussian window along a row. For the frequencies 0 … 1 cycle a pixel."""
    taps = gaussian_taps(sigma_px).astype(np.float64)
    radius = len(taps) // 2
    signal = np.zeros(length)
    signal[: radius + 1] = taps[radius:]
    signal[-radius:] += taps[:radius]
    return np.asarray(np.fft.fft(signal).real)
