"""Noise, sharpness and texture of an image, measured in the image itself.

Sharpness: on a level with details, neighbouring pixels differ about as much as on the next coarser level. On a blurred
level they differ half as much, so the power of the differences is a quarter. Noise hides this on the finest level, so
each level is assessed from the two coarser ones, on which most noise is gone.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy import ndimage

from mammometry.geometry.arrays import Array, Bool, Float32
from mammometry.matching.dense.least_squares_step import MatchEstimate
from mammometry.matching.filters import blur, gaussian_taps, pull
from mammometry.matching.pyramid import FAR_WEIGHT, Level, build, decimation

_PART_PX = 768  # side of the square at the subject's centre that is used
_RIM_PX = 3  # distance from the subject's border, outside which the image is extended
_FEWEST_PX = 400  # fewest pixels of a level for a decision
_SOFT = 0.5
"""A level is empty if the power of steps between pixels on the next coarser level, over that on the level after it, is
below this ratio: in-focus plaster has 0.73 to 0.80, torsos 0.85, a head 0.58; with a blur of 0.8, 1.4 and 3.6 px 0.46,
0.36 and 0.32 (docs/decisions/0015)."""


def empty_levels(image: Float32[Array, "h w"], mask: Bool[Array, "h w"]) -> int:
    """Number of the finest levels in which an image has no details of the subject.

    Args:
        image: luma, 0…1, of the rectified image.
        mask: the subject's pixels.
    """
    rows, columns = np.nonzero(mask)
    if len(rows) == 0:
        return 0
    corner = [max(0, int(np.median(place)) - _PART_PX // 2) for place in (rows, columns)]
    part = tuple(slice(start, start + _PART_PX) for start in corner)
    noise, steps = 0.0, []
    coarsest = int(np.log2(_PART_PX / np.sqrt(_FEWEST_PX)))
    for number, level in enumerate(build(image[part].copy(), mask[part].copy(), 0, coarsest)):
        inner = ndimage.binary_erosion(level.mask, iterations=_RIM_PX)
        if np.count_nonzero(inner) < _FEWEST_PX:
            break
        if number == 0:
            noise = float(np.mean(checkerboard_residual(level.image)[inner] ** 2))
        else:
            noise *= float(np.sum(decimation(number).astype(np.float64) ** 2) ** 2)
        along = np.diff(level.image, axis=1)[inner[:, 1:] & inner[:, :-1]]
        steps.append(max(float(np.mean(along**2)) - 2 * noise, 0.0))
    empty = 0
    for finer, coarser in pairwise(steps[1:]):
        if finer >= _SOFT * coarser:
            break
        empty += 1
    return empty


_AROUND_PX = 4.0  # Gaussian σ over which noise is averaged, pixels of the level for which it is computed


def checkerboard_residual(image: Float32[Array, "h w"]) -> Float32[Array, "h w"]:
    """Noise of an image without its smooth part.

    The second difference along rows of that along columns, over 6: white noise keeps its variance. Anything smooth
    along either axis gives 0 (Immerkær 1996), and optics leave little detail of skin at that frequency. Border pixels
    are 0.
    """
    residual = np.zeros_like(image)
    along = image[:, :-2] - 2 * image[:, 1:-1] + image[:, 2:]
    residual[1:-1, 1:-1] = (along[:-2] - 2 * along[1:-1] + along[2:]) / 6
    return residual


def noise_variance(finest: Level, decimations: Sequence[Float32[Array, " _"]]) -> Float32[Array, "H W"]:
    """Variance of the noise around each pixel, measured on the finest level and scaled to a coarser one.

    It is measured locally, since bright and shaded skin have different noise. Compression and demosaicing also cause
    noise of a coarser grain, which is underestimated.

    Args:
        finest: level on which the noise is still that of the sensor.
        decimations: taps of the filters between it and the wanted level. Empty: the finest level itself.
    """
    inner = finest.mask
    for axis in (0, 1):  # residuals across the subject's border are the background's
        inner = inner & np.roll(inner, 1, axis) & np.roll(inner, -1, axis)
    squares, mass = checkerboard_residual(finest.image) ** 2, inner.astype(np.float32)
    for taps in decimations:
        squares, mass = pull(squares, mass)
        squares *= np.float32(np.sum(taps.astype(np.float64) ** 2) ** 2)
        mass *= np.float32(0.25)
    around = gaussian_taps(_AROUND_PX)
    wide = np.float32(FAR_WEIGHT)
    mean = np.float32(np.average(squares, weights=mass)) if mass.any() else np.float32(0)
    squares *= mass
    variance = blur(squares, around)
    variance += wide * mean
    mass = blur(mass, around)
    mass += wide
    variance /= mass
    return variance


_FEWEST_MATCHES = 100  # fewest matches for a noise estimate
_SOUND_CORRELATION = 0.5  # smallest correlation of a match used for the noise estimate
_MOST_DOUBT = 4.0  # largest factor on a match's variance: twice its standard deviation (docs/decisions/0015)
_LONG_WAVES = 4.0  # σ of the high-pass, in window σ: slower shading is not texture
_LOWEST_NOISE = 1e-4  # least SD of luma, 0…1: a tenth of an 8-bit step's rounding


def unexplained(level: Level, matches: MatchEstimate, sigma_px: float) -> Float32[Array, "h w"]:
    """Factor on a match's variance, 1 … 4. It is 1 if noise explains the residual after gain and offset.

    In weak texture a match is uncertain but right, as its variance shows. If the residual is much larger than both
    images' noise, they show different things: a partly hidden surface, a highlight, a wrong match.

    Args:
        level: the finest matched level.
        matches: matches on this level.
        sigma_px: σ of the Gaussian window.
    """
    # In place: at full size each array needs a quarter of an image's memory.
    ratio = np.square(np.minimum(matches.correlation, np.float32(1)))
    np.subtract(np.float32(1), ratio, out=ratio)
    ratio *= _spread(_high_passed(level, sigma_px), sigma_px)
    ratio /= 2 * np.maximum(noise_variance(level, []), np.float32(_LOWEST_NOISE**2))
    return np.clip(ratio, 1, _MOST_DOUBT, out=ratio)


def weak_texture(level: Level, matches: MatchEstimate, sigma_px: float, limit_px: float) -> Bool[Array, "h w"]:
    """Subject pixels whose texture is too weak for a match with a standard deviation below `limit_px`.

    Pixels whose texture is only noise are included. A window's shift has the variance noise² Σw² / Σw·slope² (Cramér
    and Rao). The noise of both images together is the median, over the matches, of the residual; the slope is that of
    the image.

    Args:
        level: the finest matched level.
        matches: matches on this level.
        sigma_px: σ of the Gaussian window.
        limit_px: standard deviation, pixels of the level.
    """
    image = _high_passed(level, sigma_px)
    spread = _spread(image, sigma_px)
    sound = matches.plausible & (matches.correlation > _SOUND_CORRELATION)
    if np.count_nonzero(sound) < _FEWEST_MATCHES:
        return level.mask
    noise = max(float(np.median(spread[sound] * (1 - matches.correlation[sound] ** 2))), _LOWEST_NOISE**2)
    # Part of the measured slope² is noise: that of central differences in one image.
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
