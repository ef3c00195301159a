"""Find JPEG damage that leaves the codes valid, by its effect on the image.

Each block's brightness is coded as the difference from the previous block. A wrong difference shifts all following
blocks, so the image has a step along the blocks: from a point in a row to its right end, and in the next row up to that
point.
"""

from __future__ import annotations

import numpy as np

from mammometry.geometry.arrays import Array, Float32, UInt8
from mammometry.io.photographs.jpeg_stream import Layout

_LEAST_STEP = 8.0
"""Least step, grey levels. Smaller ones are within the difference between two cameras of a rig."""
_LEAST_SHARE = 0.75
"""Least share of a row's units with the same step. With damage it is 0.8 to 1. It is at most 0.14 in the 434
photographs of the shared data, and 0.66 in a drawn figure."""
_SAME, _SAME_LEVELS = 0.2, 2.0  # largest difference of equal steps, as a share of the step and in grey levels
_LEAST_UNITS = 4  # fewest units on either side of the damage's start
_PLACES = 24  # starts tested per row; those in between do not affect the median of the step


def has_seam(pixels: UInt8[Array, "h w *c"], layout: Layout) -> bool:
    """Whether all blocks from some point on are brighter or darker than they should be.

    False if restart markers are less than two rows apart: such damage is too short to be distinguished from an edge.

    Args:
        pixels: decoded pixels, not rotated.
        layout: layout of the blocks.
    """
    if layout.interval and layout.interval < 2 * layout.units_across:
        return False
    planes = [pixels] if pixels.ndim == 2 else [pixels[..., 0], pixels[..., 2]]  # these depend on both chroma channels
    return any(_plane_has_seam(plane, layout) for plane in planes)


def _plane_has_seam(plane: UInt8[Array, "h w"], layout: Layout) -> bool:
    if plane.shape[1] // layout.unit_wh[0] < 2 * _LEAST_UNITS or plane.shape[0] < 4 * layout.unit_wh[1]:
        return False
    return _has_step(_steps(plane, layout))


def _steps(plane: UInt8[Array, "h w"], layout: Layout) -> Float32[Array, "m n"]:
    """Change of brightness across each unit's upper edge, beyond that of its surroundings, grey levels.

    Args:
        plane: the picture.
        layout: layout of the blocks.
    """
    wide, high = layout.unit_wh
    across = plane.shape[1] // wide
    rows = np.arange(high, plane.shape[0] - 1, high)
    above, before, after, below = (plane[rows + offset, : across * wide].astype(np.int16) for offset in (-2, -1, 0, 1))
    twice = 3 * (after - before) - (below - above)
    return twice.reshape(len(rows), across, wide).sum(axis=2, dtype=np.int32).astype(np.float32) / np.float32(2 * wide)


def _has_step(steps: Float32[Array, "m n"]) -> bool:
    """Whether a row has one step from some point on, and the next row has the same step up to that point."""
    across = steps.shape[1]
    typical = np.median(np.abs(steps), axis=1)  # in one of the two rows, the step covers at least half the length
    rows = np.flatnonzero(np.maximum(typical[:-1], typical[1:]) >= _LEAST_STEP)
    places = np.unique(np.linspace(_LEAST_UNITS, across - _LEAST_UNITS, _PLACES).astype(int))
    for row in rows.tolist():
        for place in places.tolist():
            right, left = steps[row, place:], steps[row + 1, :place]
            both = np.concatenate([right, left])
            step = float(np.median(both))
            same = max(_SAME * abs(step), _SAME_LEVELS)
            if (
                abs(step) >= _LEAST_STEP
                and np.mean(np.abs(both - step) <= same) >= _LEAST_SHARE
                and max(abs(float(np.median(part)) - step) for part in (right, left)) <= same
            ):
                return True
    return False
