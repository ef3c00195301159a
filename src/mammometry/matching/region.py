"""The part of a cluttered scene that is worth matching finely, and the levels cut down to it."""

import numpy as np
from scipy import ndimage

from mammometry.geometry.arrays import Array, Bool
from mammometry.matching.pyramid import Level, finer_mask
from mammometry.matching.solve import Both, Solved
from mammometry.matching.step import Estimate
from mammometry.matching.vertical import VerticalField

_REACH_PX = 8  # around what the coarsest level matched, its pixels
_CERTAIN_PX = 0.3  # expected deviation, coarsest level's pixels, of a match that is believed
_SMALLEST_PART = 0.05  # of the largest matched part; the rest is clutter
_MOSTLY = 0.6  # matched share of the masks above which nothing is cut: a subject, not a scene

Window = tuple[slice, slice]
"""Rows and columns."""


def worth_matching(matches: Both[Estimate], masks: Both[Bool[Array, "h w"]]) -> tuple[Both[Bool[Array, "h w"]], Window]:
    """Masks of the coarsest level kept for the finer ones, and the rows and columns that hold them.

    Where both pictures show one subject, these are the masks themselves. In a cluttered scene most pixels have no
    partner; there only the surroundings of those that found one are kept.
    """
    kept = [
        mask & match.plausible & (match.variance < _CERTAIN_PX**2) for match, mask in zip(matches, masks, strict=True)
    ]
    whole = (slice(0, masks[0].shape[0]), slice(0, masks[0].shape[1]))
    if sum(np.count_nonzero(k) for k in kept) > _MOSTLY * sum(np.count_nonzero(mask) for mask in masks):
        return masks, whole
    wide = [
        mask & ndimage.binary_dilation(_large_parts(ndimage.binary_opening(k, iterations=2)), iterations=_REACH_PX)
        for k, mask in zip(kept, masks, strict=True)
    ]
    if not (wide[0].any() and wide[1].any()):
        return masks, whole
    both = wide[0] | wide[1]
    rows, columns = np.nonzero(both.any(axis=1))[0], np.nonzero(both.any(axis=0))[0]
    window = (
        slice(max(int(rows[0]) - _REACH_PX, 0), int(rows[-1]) + 1 + _REACH_PX),
        slice(max(int(columns[0]) - _REACH_PX, 0), int(columns[-1]) + 1 + _REACH_PX),
    )
    return (wide[0], wide[1]), window


def _large_parts(mask: Bool[Array, "h w"]) -> Bool[Array, "h w"]:
    labels, count = ndimage.label(mask)
    if count == 0:
        return mask
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    large: Bool[Array, "h w"] = (sizes >= _SMALLEST_PART * sizes.max())[labels]
    return large


def at_level(window: Window, steps: int, shape_hw: tuple[int, int]) -> Window:
    """The same window in the pixels of the level `steps` finer, whose image has the given shape."""
    return (
        slice(window[0].start << steps, min(window[0].stop << steps, shape_hw[0])),
        slice(window[1].start << steps, min(window[1].stop << steps, shape_hw[1])),
    )


def cut_levels(levels: list[Level], mask: Bool[Array, "h w"], window: Window) -> list[Level]:
    """The levels finer than the one of the mask, fine to coarse, with that mask imposed on all, cut to the window."""
    made: list[Level] = []
    for index in range(len(levels) - 1, -1, -1):
        level = levels[index]
        mask = finer_mask(mask, level.mask.shape)
        part = at_level(window, len(levels) - index, level.mask.shape)
        made.insert(
            0,
            Level(image=np.ascontiguousarray(level.image[part]), mask=np.ascontiguousarray((level.mask & mask)[part])),
        )
    return made


def cut_solved(solved: Solved, window: Window, field: VerticalField) -> Solved:
    """A level's results within the window; both images are cut alike, so the shifts stay as they are."""

    def one(match: Estimate) -> Estimate:
        return Estimate(
            **{name: np.ascontiguousarray(getattr(match, name)[window]) for name in Estimate.__dataclass_fields__}
        )

    return Solved(
        matches=(one(solved.matches[0]), one(solved.matches[1])),
        shifts=(np.ascontiguousarray(solved.shifts[0][window]), np.ascontiguousarray(solved.shifts[1][window])),
        field=field,
    )


def pasted(values: Array, window: Window, shape_hw: tuple[int, int]) -> Array:
    """The window's values in an array of the whole image, 0 elsewhere."""
    if values.shape == shape_hw:
        return values
    whole = np.zeros(shape_hw, dtype=values.dtype)
    whole[window] = values
    return whole
