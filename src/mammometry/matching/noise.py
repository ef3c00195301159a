"""How much noise a picture holds, measured in the picture itself."""

from collections.abc import Sequence

import numpy as np

from mammometry.geometry.arrays import Array, Float32
from mammometry.matching.filters import blur, gaussian_taps, pull
from mammometry.matching.pyramid import Level

_AROUND_PX = 4.0  # Gaussian σ over which noise is averaged, pixels of the level it is wanted on; chosen by eye
_FAR_WEIGHT = 1e-3  # of the subject's mean, where nothing of it is near; any small number


def checkerboard_residual(image: Float32[Array, "h w"]) -> Float32[Array, "h w"]:
    """Noise of a picture, free of what is smooth.

    The second difference along rows of that along columns, over 6: white noise keeps its variance. Whatever is smooth
    along either axis gives 0 (Immerkær 1996): optics leave little skin at that frequency. The outer pixels are 0.
    """
    residual = np.zeros_like(image)
    along = image[:, :-2] - 2 * image[:, 1:-1] + image[:, 2:]
    residual[1:-1, 1:-1] = (along[:-2] - 2 * along[1:-1] + along[2:]) / 6
    return residual


def noise_variance(finest: Level, decimations: Sequence[Float32[Array, " _"]]) -> Float32[Array, "H W"]:
    """Variance of the noise around each pixel.

    Measured on the finest level, given for a coarser one. The noise of a bright skin is another than that of a shaded
    one: it is measured in place. A picture that was compressed or put together from a colour mosaic has noise of larger
    grain as well, of which this sees less.

    Args:
        finest: where the noise still is what the sensor made it.
        decimations: taps of the filters between it and the level wanted; none: the finest itself.
    """
    inner = finest.mask
    for axis in (0, 1):  # residuals that reach beyond the subject are the backdrop's
        inner = inner & np.roll(inner, 1, axis) & np.roll(inner, -1, axis)
    squares, mass = checkerboard_residual(finest.image) ** 2, inner.astype(np.float32)
    for taps in decimations:
        squares, mass = pull(squares, mass)
        squares *= np.float32(np.sum(taps.astype(np.float64) ** 2) ** 2)
        mass *= np.float32(0.25)
    around = gaussian_taps(_AROUND_PX)
    wide = np.float32(_FAR_WEIGHT)
    mean = np.float32(np.average(squares, weights=mass)) if mass.any() else np.float32(0)
    squares *= mass
    variance = blur(squares, around)
    variance += wide * mean
    mass = blur(mass, around)
    mass += wide
    variance /= mass
    return variance
