"""Dense least squares on one pyramid level: both directions, smoothing between the steps (paper 2.3, Eq. 1).

Least squares with a free gain and offset maximises exactly the correlation of Eq. 1, and does it sub-pixel. The *shift*
of a direction is where its pixel is found in the other image: right = left + shift, so the left image's shift is minus
the disparity. Both directions obey the same code, each in a thread of its own (the kernels release the lock).
"""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any, TypeAlias, TypeVar

import numpy as np

from mammometry.geometry.arrays import Array, Bool, Float32
from mammometry.matching.belief import agreeing, compete, smoothing_weights
from mammometry.matching.pyramid import Level, finer_shift
from mammometry.matching.settings import MatchSettings
from mammometry.matching.smooth import adaptively_smooth, smooth
from mammometry.matching.step import Estimate, Side, prepare, step
from mammometry.matching.vertical import VerticalField, refine

AGREEMENT_PX = 1.0  # between the two directions, for a match to count in the smoothing
_START_DEVIATION_PX = 0.5  # of the semi-global start, pixels of its level
_YIELDS_AT = 4.0  # times the known match's standard deviation: a finer match less certain than that is dropped
_FIELD_REFINEMENTS = 2  # of the vertical field on each level, after its last steps
_SMALL_STEP_PX = 0.3  # a match that still moves by more says nothing about the rows
_LARGEST_VARIANCE_PX2 = np.float32(1.0)
_COARSE_SMOOTHING_PX, LAST_SMOOTHING_PX = 2.5, 4.5  # σ of the plane fits between the steps

_T = TypeVar("_T")
Both: TypeAlias = tuple[_T, _T]
"""Of the left image and of the right one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Known:
    """What a level starts from in one direction: the semi-global start, or the coarser level's matches."""

    shift: Float32[Array, "h w"]
    """Pixels of this level."""
    correlation: Float32[Array, "H W"]
    """c of Eq. 1, −1…1."""
    variance: Float32[Array, "H W"]
    """Of the shift, px² of this level."""
    plausible: Bool[Array, "H W"]
    """What the coarser level accepted."""
    halved: int
    """1 where all but the shift are the coarser level's pixels, else 0."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solved:
    """A level's result."""

    matches: Both[Estimate]
    """The last step's."""
    shifts: Both[Float32[Array, "h w"]]
    """Smoothed; on the finest level those that the last step started from."""
    field: VerticalField


def both(pool: Executor, function: Callable[..., _T], *pairs: Both[Any]) -> Both[_T]:
    """Call a function for the left and the right image side by side."""
    futures = [pool.submit(function, *(pair[k] for pair in pairs)) for k in (0, 1)]
    return futures[0].result(), futures[1].result()


def solve_level(
    images: Both[Level],
    level: int,
    known: Both[Known],
    field: VerticalField,
    settings: MatchSettings,
    pool: Executor,
    *,
    steps: int,
    last: bool,
) -> Solved:
    """Improve both directions' shifts on one level by some steps, each followed by smoothing.

    On the last level one step more is made, with wide windows, which only there pay: `finally_smoothed` follows it.
    """
    sigma = settings.window_px / np.sqrt(12)
    left, right = both(pool, prepare, (images[0], field.aligned(images[1], level)), (sigma, sigma))
    masks = (images[0].mask, images[1].mask)
    shifts = (known[0].shift, known[1].shift)
    scale = LAST_SMOOTHING_PX if last else _COARSE_SMOOTHING_PX

    def smoothed(found: Estimate, mask: Bool[Array, "h w"], before: Float32[Array, "h w"]) -> Float32[Array, "h w"]:
        return smooth(found.shift, smoothing_weights(found.variance, found.plausible, mask), scale, before)

    for index in range(steps):
        matches = _stepped((left, right), shifts, known, settings, pool, widely=not last)
        shifts = both(pool, smoothed, matches, masks, shifts)
        if index >= steps - _FIELD_REFINEMENTS:
            trusted = matches[0].plausible & (np.abs(matches[0].step) < _SMALL_STEP_PX)
            refined = refine(field, left.image, right.coefficients, shifts[0], trusted, level)
            if field.matters(level) or refined.matters(level):
                right = prepare(refined.aligned(images[1], level), sigma)
            field = refined
        if last or index < steps - 1:
            del matches  # before the next ones are made: they are what takes the memory
    if last:
        matches = _stepped((left, right), shifts, known, settings, pool, widely=True)
    return Solved(matches=matches, shifts=shifts, field=field)


def initial(shifts: Both[Float32[Array, "h w"]], masks: Both[Bool[Array, "h w"]]) -> Both[Known]:
    """The semi-global start, for least squares to compete with."""

    def one(here: int) -> Known:
        shift = shifts[here]
        return Known(
            shift=shift,
            correlation=np.zeros_like(shift),
            variance=np.full_like(shift, _START_DEVIATION_PX**2),
            plausible=masks[here] & agreeing(shift, shifts[1 - here], AGREEMENT_PX),
            halved=0,
        )

    return one(0), one(1)


def handed_down(solved: Solved, agreement_px: float, shape_hw: tuple[int, int]) -> Both[Known]:
    """A level's result for the next finer level: its smoothed fields, their uncertainty, what it accepted."""
    (left, right), (ours, theirs) = solved.matches, solved.shifts
    return (
        carried(left, ours, agreeing(ours, theirs, agreement_px), shape_hw),
        carried(right, theirs, agreeing(theirs, ours, agreement_px), shape_hw),
    )


def carried(
    matches: Estimate, shift: Float32[Array, "h w"], agrees: Bool[Array, "h w"], shape_hw: tuple[int, int]
) -> Known:
    """The same of one direction, of a smoothed field that agrees with the other direction's where said."""
    return Known(
        shift=finer_shift(shift, shape_hw),
        correlation=matches.correlation,
        variance=4 * matches.variance,
        plausible=matches.plausible & agrees,
        halved=1,
    )


def _stepped(
    sides: Both[Side],
    shifts: Both[Float32[Array, "h w"]],
    known: Both[Known],
    settings: MatchSettings,
    pool: Executor,
    *,
    widely: bool,
) -> Both[Estimate]:
    """One least-squares step of both directions from the given fields; what fails yields to what is known."""
    sigma = settings.window_px / np.sqrt(12)

    def one(here: Side, there: Side, shift: Float32[Array, "h w"]) -> Estimate:
        return step(here, there, shift, sigma, settings, widely=widely)

    found = both(pool, one, sides, (sides[1], sides[0]), shifts)
    agree = both(
        pool, agreeing, (found[0].shift, found[1].shift), (found[1].shift, found[0].shift), (AGREEMENT_PX,) * 2
    )
    return both(pool, judged, found, agree, known)


def judged(ours: Estimate, agrees: Bool[Array, "h w"], known: Known) -> Estimate:
    """What fails, or disagrees with the other direction, yields to what is known. The arrays are changed in place."""
    plausible = np.logical_and(ours.plausible, agrees, out=agrees)
    fine = (ours.shift, ours.step, ours.correlation, ours.variance, plausible)
    compete(fine, known.shift, known.correlation, known.variance, known.plausible, known.halved, _YIELDS_AT)
    return replace(ours, plausible=plausible)


def finally_smoothed(
    found: Estimate, mask: Bool[Array, "h w"], before: Float32[Array, "h w"], settings: MatchSettings
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"]]:
    """A direction's shifts, at each pixel as finely as their noise allows, and their expected variances.

    `before` is what the last step started from.
    """
    return adaptively_smooth(
        found.shift,
        smoothing_weights(found.variance, found.plausible, mask),
        np.minimum(found.variance, _LARGEST_VARIANCE_PX2),
        settings.window_px / np.sqrt(12),
        settings.smoothing_px,
        settings.detail_factor,
        before,
    )
