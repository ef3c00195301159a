"""How fine the details are that a picture holds, by the texture and the blur that it has.

On a level that holds details the picture changes from pixel to pixel about as much as on the next coarser one. Where it
is blurred it changes half as much, and its power a quarter. Noise hides that on the finest level, so that each level is
judged by the two that follow it, where most noise is gone.
"""

from itertools import pairwise

import numpy as np
from scipy import ndimage

from mammometry.geometry.arrays import Array, Bool, Float32
from mammometry.matching.noise import checkerboard_residual
from mammometry.matching.pyramid import build, decimation

_PART_PX = 768  # side of the square in the subject's middle that is looked at
_MOST = 3  # levels that may be empty
_RIM_PX = 3  # off the subject's rim, where the picture is continued
_FEWEST_PX = 400  # of a level; fewer tell nothing
_SOFT = 0.5
"""Power of the steps between pixels, on the level after the one judged over that on the next, below which a level is
empty: sharp plaster has .73 to .80, torsos .85, a head .58; with a blur of .8, 1.4 and 3.6 px .46, .36 and .32
(docs/decisions/0015)."""


def empty_levels(image: Float32[Array, "h w"], mask: Bool[Array, "h w"]) -> int:
    """Number of the finest levels in which a picture holds no details of the subject.

    Args:
        image: luma, 0…1, of the rectified picture.
        mask: the subject's pixels.
    """
    rows, columns = np.nonzero(mask)
    if len(rows) == 0:
        return 0
    corner = [max(0, int(np.median(place)) - _PART_PX // 2) for place in (rows, columns)]
    part = tuple(slice(start, start + _PART_PX) for start in corner)
    noise, steps = 0.0, []
    for number, level in enumerate(build(image[part].copy(), mask[part].copy(), 0, _MOST + 1)):
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
