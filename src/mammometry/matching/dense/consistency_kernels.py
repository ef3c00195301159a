"""Compiled kernels: left–right consistency and weights of matches.

Both directions must agree, a fine match competes with the coarse one, and the smoothing weighs by certainty. As those
of `correlate` they work on C-contiguous arrays, release the interpreter's lock and have NumPy twins in the tests.
"""

import numpy as np

from mammometry.base.machine.compiled import fast_kernel
from mammometry.geometry.arrays import Array, Bool, Float32

_DOUBTED_WEIGHT = np.float32(0.02)  # of a match that failed: it only bridges gaps; chosen by eye
_LEAST_VARIANCE_PX2 = np.float32(0.01**2)  # keeps one very sure match from outweighing all others; chosen by eye
_LARGEST_VARIANCE_PX2 = np.float32(1.0)  # a step is never larger than 1 px


@fast_kernel
def agreeing(ours: Float32[Array, "h w"], theirs: Float32[Array, "h w"], limit: float) -> Bool[Array, "h w"]:
    """Whether both directions agree at each pixel.

    A pixel that goes to the other image and back lands nearer to itself than the limit, pixels.
    """
    height, width = ours.shape
    out = np.zeros((height, width), dtype=np.bool_)
    largest = np.float32(limit)
    for i in range(height):
        back, row, going = theirs[i], out[i], ours[i]
        for j in range(width):
            target = np.float32(j) + going[j]
            if target < 0 or target > width - 1:
                continue
            column = min(int(target), width - 2)
            fraction = target - np.float32(column)
            returned = (np.float32(1.0) - fraction) * back[column] + fraction * back[column + 1]
            row[j] = abs(going[j] + returned) < largest
    return out


@fast_kernel
def _between(values, i, j, halved):  # type: ignore[no-untyped-def]
    """Interpolate a coarse field at a finer pixel.

    The field is halved 0 or 1 times; linear between its pixels.
    """
    if halved == 0:
        return values[i, j]
    row, column = i >> 1, j >> 1
    other_row = min(max(row + 2 * (i & 1) - 1, 0), values.shape[0] - 1)
    other_column = min(max(column + 2 * (j & 1) - 1, 0), values.shape[1] - 1)
    near, far = np.float32(0.75), np.float32(0.25)
    return near * (near * values[row, column] + far * values[row, other_column]) + far * (
        near * values[other_row, column] + far * values[other_row, other_column]
    )


@fast_kernel
def compete(
    fine: tuple[
        Float32[Array, "h w"], Float32[Array, "h w"], Float32[Array, "h w"], Float32[Array, "h w"], Bool[Array, "h w"]
    ],
    shift: Float32[Array, "h w"],
    correlation: Float32[Array, "H W"],
    variance: Float32[Array, "H W"],
    plausible: Bool[Array, "H W"],
    halved: int,
    yields_at: float,
) -> None:
    """Put the known match where the fine one fails.

    It also takes the place of a fine one whose deviation is `yields_at` times larger. `fine` are shift, step,
    correlation, variance and whether plausible, changed in place; of the known ones all but the shift lie on a grid
    that is halved so many times, 0 or 1, between whose pixels they are interpolated.
    """
    fine_shift, fine_step, fine_correlation, fine_variance, fine_plausible = fine
    height, width = shift.shape
    factor = np.float32(yields_at * yields_at)
    for i in range(height):
        row = i >> halved
        for j in range(width):
            column = j >> halved
            if not plausible[row, column]:
                continue
            known_variance = _between(variance, i, j, halved)
            if fine_plausible[i, j] and factor * known_variance >= fine_variance[i, j]:
                continue
            fine_shift[i, j] = shift[i, j]
            fine_step[i, j] = np.float32(0.0)
            fine_correlation[i, j] = _between(correlation, i, j, halved)
            fine_variance[i, j] = known_variance
            fine_plausible[i, j] = True


@fast_kernel
def smoothing_weights(
    variance: Float32[Array, "h w"], plausible: Bool[Array, "h w"], mask: Bool[Array, "h w"]
) -> Float32[Array, "h w"]:
    """Weights of the matches in the smoothing.

    1/variance, little for those that failed, 0 outside the mask.
    """
    height, width = variance.shape
    out = np.empty((height, width), dtype=np.float32)
    for i in range(height):
        row, spread, good, inside = out[i], variance[i], plausible[i], mask[i]
        for j in range(width):
            share = _DOUBTED_WEIGHT + np.float32(good[j])
            weight = share / (min(spread[j], _LARGEST_VARIANCE_PX2) + _LEAST_VARIANCE_PX2)
            row[j] = weight if inside[j] else np.float32(0.0)
    return out
