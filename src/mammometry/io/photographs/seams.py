"""Damage that leaves a JPEG's codes valid, found by what it does to the picture.

A JPEG codes each block's brightness as its difference from the block before. One that is wrong shifts all that follow,
so the picture has a step along its blocks: from somewhere in a row to its right end, and one row lower up to there.
"""

from __future__ import annotations

import numpy as np

from mammometry.geometry.arrays import Array, Float32, UInt8
from mammometry.io.photographs.jpeg_stream import Layout

_LEAST_STEP = 8.0
"""Grey levels. A smaller one is less than two cameras of a rig may differ by."""
_LEAST_SHARE = 0.75
"""Share of a row's units that have the same step. Damage has 0.8 to 1, the 434 photographs of the shared data 0.14 at
most, a drawn figure 0.66."""
_SAME, _SAME_LEVELS = 0.2, 2.0  # by how much of the step, or how many grey levels, steps of the same size may differ
_LEAST_UNITS = 4  # on each side of the place where the damage begins
_PLACES = 24  # in a row that are tried: the median of the step hides the rest


def has_seam(pixels: UInt8[Array, "h w *c"], layout: Layout) -> bool:
    """Whether all blocks from some place on are brighter or darker than they were coded.

    Where restart markers are closer than two rows, such damage is too short to differ from an edge: False.

    Args:
        pixels: as decoded, not turned.
        layout: of its blocks.
    """
    if layout.interval and layout.interval < 2 * layout.units_across:
        return False
    planes = [pixels] if pixels.ndim == 2 else [pixels[..., 0], pixels[..., 2]]  # red and blue show both colour signals
    return any(_plane_has_seam(plane, layout) for plane in planes)


def _plane_has_seam(plane: UInt8[Array, "h w"], layout: Layout) -> bool:
    if plane.shape[1] // layout.unit_wh[0] < 2 * _LEAST_UNITS or plane.shape[0] < 4 * layout.unit_wh[1]:
        return False
    return _has_step(_steps(plane, layout))


def _steps(plane: UInt8[Array, "h w"], layout: Layout) -> Float32[Array, "m n"]:
    """Brightness that is gained across each unit's upper edge, beyond what its surroundings gain, grey levels.

    Args:
        plane: the picture.
        layout: of its blocks.
    """
    wide, high = layout.unit_wh
    across = plane.shape[1] // wide
    rows = np.arange(high, plane.shape[0] - 1, high)
    above, before, after, below = (plane[rows + offset, : across * wide].astype(np.int16) for offset in (-2, -1, 0, 1))
    twice = 3 * (after - before) - (below - above)
    return twice.reshape(len(rows), across, wide).sum(axis=2, dtype=np.int32).astype(np.float32) / np.float32(2 * wide)


def _has_step(steps: Float32[Array, "m n"]) -> bool:
    """Whether a row has one step from some place on, and the next row the same up to there."""
    across = steps.shape[1]
    typical = np.median(np.abs(steps), axis=1)  # one of the two rows has the step in half its length at least
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
