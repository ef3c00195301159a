"""Windows that hold one layer of depth, at chosen pixels: beside depth jumps, and where the ordinary window fails.

A window across a depth jump mixes two surfaces: its match drifts and is refused, and the smoothing stretches skin from
one side to the other. Here the sums are taken pixel by pixel over those neighbours whose shift continues the pixel's
own. The kernel has a NumPy twin in the tests, as those of `correlate` have.
"""

import numpy as np
from numba import njit
from scipy import ndimage

from mammometry.geometry.arrays import Array, Bool, Float32, Int64
from mammometry.matching.correlate import shift_of_sums

_JUMP_PX = 1.5  # within 3 × 3 pixels: as steep as skin is never matched
_FEWEST_CONNECTED = 10  # pixels; smaller jumps are noise
_SAME_LAYER_PX, _SAME_LAYER_SLOPE = (
    1.0,
    0.12,
)  # a neighbour may miss the pixel's tangent by so much, and so much a pixel


def jump_distance(shift: Float32[Array, "h w"], mask: Bool[Array, "h w"]) -> Float32[Array, "h w"]:
    """Distance of each pixel to the nearest jump of the shift inside the mask, pixels; infinite without one."""
    highest = ndimage.maximum_filter(np.where(mask, shift, -np.inf), 3)
    lowest = ndimage.minimum_filter(np.where(mask, shift, np.inf), 3)
    jump = mask & (highest - lowest > _JUMP_PX)
    labels, count = ndimage.label(jump, structure=np.ones((3, 3)))
    large = np.bincount(labels.ravel(), minlength=count + 1) >= _FEWEST_CONNECTED
    large[0] = False
    if not large.any():
        return np.full(shift.shape, np.inf, dtype=np.float32)
    return ndimage.distance_transform_edt(~large[labels]).astype(np.float32)


@njit(cache=True, nogil=True, inline="always")
def _tangent(layers, i, j):  # type: ignore[no-untyped-def]
    """Slopes of the shift at a pixel, along columns and rows, from the flatter side of each."""
    height, width = layers.shape
    here = layers[i, j]
    before = here - layers[i, j - 1] if j > 0 else layers[i, j + 1] - here
    after = layers[i, j + 1] - here if j < width - 1 else before
    above = here - layers[i - 1, j] if i > 0 else layers[i + 1, j] - here
    below = layers[i + 1, j] - here if i < height - 1 else above
    along = before if abs(before) < abs(after) else after
    across = above if abs(above) < abs(below) else below
    return along, across


@njit(cache=True, nogil=True, fastmath=True)
def layered_least_squares(
    pixels: tuple[Int64[Array, " n"], Int64[Array, " n"]],
    images: tuple[Float32[Array, "h w"], Float32[Array, "h w"], Float32[Array, "h w"], Float32[Array, "h w"]],
    layers: Float32[Array, "h w"],
    taps: Float32[Array, " taps"],
    floor: float,
) -> Float32[Array, "4 n"]:
    """`least_squares` at chosen pixels (rows, columns), over the neighbours on the pixel's own layer only.

    `images` are its first four arguments. `layers` is the shift that tells the layers apart: a neighbour belongs to the
    pixel's where it continues the pixel's tangent.

    Returns the shift, correlation, window's mass and shift's variance of each chosen pixel.
    """
    rows, columns = pixels
    here, there, slope, weight = images
    height, width = here.shape
    radius = taps.shape[0] // 2
    squares = np.float32(0.0)
    for k in range(taps.shape[0]):
        squares += taps[k] * taps[k]
    concentration = squares * squares
    out = np.empty((4, rows.shape[0]), dtype=np.float32)
    sums = np.empty(10, dtype=np.float32)
    for n in range(rows.shape[0]):
        i, j = rows[n], columns[n]
        along, across = _tangent(layers, i, j)
        sums[:] = 0.0
        for a in range(max(0, i - radius), min(height, i + radius + 1)):
            for b in range(max(0, j - radius), min(width, j + radius + 1)):
                w = weight[a, b]
                if w == 0:
                    continue
                off = layers[a, b] - layers[i, j] - along * np.float32(b - j) - across * np.float32(a - i)
                reach = np.float32(max(abs(a - i), abs(b - j)))
                if abs(off) > np.float32(_SAME_LAYER_PX) + np.float32(_SAME_LAYER_SLOPE) * reach:
                    continue
                w *= taps[a - i + radius] * taps[b - j + radius]
                l = here[a, b]  # noqa: E741
                r = there[a, b]
                g = slope[a, b]
                sums[0] += w
                sums[1] += w * r
                sums[2] += w * g
                sums[3] += w * r * r
                sums[4] += w * r * g
                sums[5] += w * g * g
                sums[6] += w * l
                sums[7] += w * l * r
                sums[8] += w * l * g
                sums[9] += w * l * l
        out[2, n] = sums[0]
        out[0, n], out[1, n], out[3, n] = shift_of_sums(sums, floor, concentration)
    return out
