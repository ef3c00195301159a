"""Where the skin has too little texture to be matched.

Such places are reported; nothing is invented there.
"""

import numpy as np

from mammometry.geometry.arrays import Array, Bool, Float32
from mammometry.matching.dense.least_squares_step import Estimate
from mammometry.matching.filters import blur, gaussian_taps
from mammometry.matching.noise import noise_variance
from mammometry.matching.pyramid import Level

_FEWEST_MATCHES = 100  # that tell the noise; chosen by eye
_SOUND_CORRELATION = 0.5  # of a match that tells the noise; chosen by eye
_MOST_DOUBT = 4.0  # times its variance: twice its standard deviation (docs/decisions/0015)
_LONG_WAVES = 4.0  # times the window's σ: slower shading is no texture; chosen by eye
_LOWEST_NOISE = 1e-4  # of luma 0…1: a tenth of an 8-bit step's rounding


def unexplained(level: Level, matches: Estimate, sigma_px: float) -> Float32[Array, "h w"]:
    """Factor on a match's variance, 1 … 4.

    1 where noise explains what gain and offset leave over. In weak texture a match is uncertain and yet right, and its
    variance says so. Where much more is left over than the noise of both pictures, they show different things: a
    surface half hidden, a gleam, a match that is off.

    Args:
        level: the finest one matched.
        matches: made on it.
        sigma_px: of the Gaussian window.
    """
    # In place: at full size each array takes a quarter of a picture's memory.
    ratio = np.square(np.minimum(matches.correlation, np.float32(1)))
    np.subtract(np.float32(1), ratio, out=ratio)
    ratio *= _spread(_high_passed(level, sigma_px), sigma_px)
    ratio /= 2 * np.maximum(noise_variance(level, []), np.float32(_LOWEST_NOISE**2))
    return np.clip(ratio, 1, _MOST_DOUBT, out=ratio)


def weak_texture(level: Level, matches: Estimate, sigma_px: float, limit_px: float) -> Bool[Array, "h w"]:
    """Subject pixels whose texture is too weak.

    A correct match around them would be less certain than `limit_px`, or holds only noise. A window's shift has the
    variance noise² Σw² / Σw·slope² (Cramér and Rao). The noise of both pictures together is the median, over the
    matches, of what the correlation leaves unexplained; the slope is the picture's own.

    Args:
        level: the finest one matched.
        matches: made on it.
        sigma_px: of the Gaussian window.
        limit_px: standard deviation, pixels of the level.
    """
    image = _high_passed(level, sigma_px)
    spread = _spread(image, sigma_px)
    sound = matches.plausible & (matches.correlation > _SOUND_CORRELATION)
    if np.count_nonzero(sound) < _FEWEST_MATCHES:
        return level.mask
    noise = max(float(np.median(spread[sound] * (1 - matches.correlation[sound] ** 2))), _LOWEST_NOISE**2)
    # Of the measured slope² a part is noise: that of central differences, one picture's.
    steep = np.zeros_like(image)
    np.subtract(image[:, 2:], image[:, :-2], out=steep[:, 1:-1])
    slope = blur(np.square(steep), gaussian_taps(sigma_px)) / 4 - np.float32(noise / 4)
    concentration = 1 / (4 * np.pi * sigma_px**2)
    by_chance = noise * np.sqrt(concentration)  # four standard deviations of slope² in a window of noise
    return np.asarray(level.mask & (slope < noise * concentration / limit_px**2 + by_chance))


def _high_passed(level: Level, sigma_px: float) -> Float32[Array, "h w"]:
    slow = blur(level.image, gaussian_taps(_LONG_WAVES * sigma_px))
    return np.subtract(level.image, slow, out=slow)


def _spread(image: Float32[Array, "h w"], sigma_px: float) -> Float32[Array, "h w"]:
    """Variance within the window around each pixel."""
    taps = gaussian_taps(sigma_px)
    spread = blur(np.square(image), taps)
    spread -= np.square(blur(image, taps))
    return spread
