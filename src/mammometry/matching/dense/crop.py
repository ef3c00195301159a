"""Crop a cluttered scene to the part that is matched finely."""

import numpy as np
from scipy import ndimage

from mammometry.geometry.arrays import Array, Bool
from mammometry.matching.dense.least_squares import LevelResult
from mammometry.matching.dense.least_squares_step import DOUBTED_DEVIATION_PX, Both, MatchEstimate
from mammometry.matching.foreground.block_segmentation import large_parts
from mammometry.matching.pyramid import Level, finer_mask

_REACH_PX = 8  # margin around the matches of the coarsest level, in its pixels: one window
_SMALLEST_PART = 0.05  # smallest part, as a share of the largest matched one; the rest is clutter
_MOSTLY = 0.6  # matched share of the masks above which nothing is cropped: it is a subject, not a scene

Window = tuple[slice, slice]
"""Rows and columns."""


def worth_matching(
    matches: Both[MatchEstimate], masks: Both[Bool[Array, "h w"]]
) -> tuple[Both[Bool[Array, "h w"]], Window]:
    """Masks of the coarsest level that are kept for finer levels, and their rows and columns.

    If both images show one subject, these are the masks themselves. In a cluttered scene most pixels have no match;
    then only the surroundings of matched pixels are kept.
    """
    kept = [
        mask & match.plausible & (match.variance < DOUBTED_DEVIATION_PX**2)
        for match, mask in zip(matches, masks, strict=True)
    ]
    whole = whole_window(masks[0])
    if sum(np.count_nonzero(k) for k in kept) > _MOSTLY * sum(np.count_nonzero(mask) for mask in masks):
        return masks, whole
    parts = [large_parts(ndimage.binary_opening(k, iterations=2), _SMALLEST_PART) for k in kept]
    wide = [mask & ndimage.binary_dilation(part, iterations=_REACH_PX) for part, mask in zip(parts, masks, strict=True)]
    if not (wide[0].any() and wide[1].any()):
        return masks, whole
    both = wide[0] | wide[1]
    rows, columns = np.nonzero(both.any(axis=1))[0], np.nonzero(both.any(axis=0))[0]
    window = (
        slice(max(int(rows[0]) - _REACH_PX, 0), int(rows[-1]) + 1 + _REACH_PX),
        slice(max(int(columns[0]) - _REACH_PX, 0), int(columns[-1]) + 1 + _REACH_PX),
    )
    return (wide[0], wide[1]), window


def at_level(window: Window, steps: int, shape_hw: tuple[int, int]) -> Window:
    """A window in the pixels of a level that is `steps` finer and whose image has the given shape."""
    return (
        slice(window[0].start << steps, min(window[0].stop << steps, shape_hw[0])),
        slice(window[1].start << steps, min(window[1].stop << steps, shape_hw[1])),
    )


def whole_window(mask: Bool[Array, "h w"]) -> Window:
    """All rows and columns."""
    return slice(0, mask.shape[0]), slice(0, mask.shape[1])


def cut_levels(
    images: tuple[Both[Level], ...], kept: Both[Bool[Array, "h w"]], window: Window
) -> tuple[Both[Level], ...]:
    """Crop both images' levels to a window of the coarsest one, fine to coarse.

    The masks kept on the coarsest level apply to all levels.
    """
    made: list[Both[Level]] = []
    for steps, (left, right) in enumerate(reversed(images)):
        if steps > 0:
            kept = finer_mask(kept[0], left.mask.shape), finer_mask(kept[1], right.mask.shape)
        part = at_level(window, steps, left.mask.shape)
        made.insert(0, (_cut(left, kept[0], part), _cut(right, kept[1], part)))
    return tuple(made)


def _cut(level: Level, mask: Bool[Array, "h w"], part: Window) -> Level:
    return Level(image=np.ascontiguousarray(level.image[part]), mask=np.ascontiguousarray((level.mask & mask)[part]))


def cut_solved(solved: LevelResult, window: Window, level: int) -> LevelResult:
    """A level's results within a window. Both images have the same crop, so shifts are unchanged."""

    def one(match: MatchEstimate) -> MatchEstimate:
        return MatchEstimate(
            **{name: np.ascontiguousarray(getattr(match, name)[window]) for name in MatchEstimate.__dataclass_fields__}
        )

    return LevelResult(
        matches=(one(solved.matches[0]), one(solved.matches[1])),
        shifts=(np.ascontiguousarray(solved.shifts[0][window]), np.ascontiguousarray(solved.shifts[1][window])),
        vertical=solved.vertical.cut(window, level),
    )


def pasted(values: Array, window: Window, shape_hw: tuple[int, int]) -> Array:
    """The window's values in an array of the whole image, 0 elsewhere."""
    if values.shape == shape_hw:
        return values
    whole = np.zeros(shape_hw, dtype=values.dtype)
    whole[window] = values
    return whole
