"""Dense least squares on one pyramid level (paper 2.3, Eq. 1).

Both directions, with smoothing between the steps. Least squares with a free gain and offset maximises exactly the
correlation of Eq. 1, and does it sub-pixel. The *shift* of a direction is where its pixel is found in the other image:
right = left + shift, so the left image's shift is minus the disparity. Both directions obey the same code, each in a
thread of its own (the kernels release the lock).
"""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from mammometry.geometry.arrays import Array, Bool, Float32
from mammometry.matching.dense.least_squares_step import (
    Both,
    Estimate,
    Side,
    agreeing,
    compete,
    prepare,
    smoothing_weights,
    step,
)
from mammometry.matching.dense.levels import LevelWork
from mammometry.matching.dense.plane_smoothing import adaptively_smooth, smooth
from mammometry.matching.dense.vertical_disparity import LevelState, Vertical, aligned
from mammometry.matching.pyramid import Level, finer_shift
from mammometry.matching.settings import MatchSettings

SMOOTHING_PX = (2.5, 4.0, 6.4, 10.2)
"""Gaussian σ of the final plane fits, pixels of the finest level, fine to coarse. Each pixel takes a finer one as far
as noise allows."""
AGREEMENT_PX = 1.0  # between the two directions, for a match to count in the smoothing; chosen by eye
_START_DEVIATION_PX = 0.5  # of the semi-global start, pixels of its level; chosen by eye
_YIELDS_AT = 4.0  # times the known match's standard deviation: a finer match less certain is dropped; chosen by eye
_LARGEST_VARIANCE_PX2 = np.float32(1.0)  # as in `belief`: a step is never larger than 1 px
_COARSE_SMOOTHING_PX = 2.5  # σ of the plane fits between the steps: a window's own
LAST_SMOOTHING_PX = 4.5  # … on the last level; 3.5 px was worse on the torso by a twentieth (docs/decisions/0015)
_DETAIL_FACTOR = 2.75
"""Ratio to the noise variance of its difference from the next one, above which a finer final smoothing is used. 3, 4
and 6 measured worse (docs/decisions/0015)."""

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LevelStart:
    """What a level starts from in one direction. The semi-global start, or the coarser level's matches."""

    shift: Float32[Array, "h w"]
    """Pixels of this level."""
    correlation: Float32[Array, "H W"]
    """c of Eq. 1, −1…1."""
    variance: Float32[Array, "H W"]
    """Of the shift, px² of this level."""
    plausible: Bool[Array, "H W"]
    """What the coarser level accepted."""
    halved: int
    """1 if everything but the shift is at the coarser level's pixels, else 0."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solved:
    """A level's result."""

    matches: Both[Estimate]
    """The last step's."""
    shifts: Both[Float32[Array, "h w"]]
    """Smoothed. On the finest level those that the last step started from."""
    vertical: Vertical


def both(pool: Executor, function: Callable[..., _T], *pairs: Both[Any]) -> Both[_T]:
    """Call a function for the left and right image in parallel."""
    futures = [pool.submit(function, *(pair[k] for pair in pairs)) for k in (0, 1)]
    return futures[0].result(), futures[1].result()


def solve_level(
    images: Both[Level],
    work: LevelWork,
    known: Both[LevelStart],
    vertical: Vertical,
    settings: MatchSettings,
    pool: Executor,
) -> Solved:
    """Improve both directions' shifts on one level, with smoothing.

    On the last level one step more is made, with wide windows, which only there pay: `finally_smoothed` follows it.
    """
    sigma = settings.window_sigma_px
    left, right = both(pool, prepare, (images[0], aligned(vertical, images[1], work.level)), (sigma, sigma))
    masks = (images[0].mask, images[1].mask)
    shifts = (known[0].shift, known[1].shift)
    scale = LAST_SMOOTHING_PX if work.last else _COARSE_SMOOTHING_PX

    def smoothed(found: Estimate, mask: Bool[Array, "h w"], before: Float32[Array, "h w"]) -> Float32[Array, "h w"]:
        return smooth(found.shift, smoothing_weights(found.variance, found.plausible, mask), scale, before)

    for index in range(work.steps):
        matches = _stepped((left, right), shifts, known, settings, pool, widely=not work.last)
        shifts = both(pool, smoothed, matches, masks, shifts)
        if index >= work.steps - vertical.refinements:
            refined = vertical.refined(
                LevelState(level=work.level, sides=(left, right), matches=matches, shifts=shifts, smoothing_px=scale)
            )
            if vertical.matters(work.level) or refined.matters(work.level):
                right = prepare(aligned(refined, images[1], work.level), sigma)
            vertical = refined
        if work.last or index < work.steps - 1:
            del matches  # before the next ones are made: they are what takes the memory
    if work.last:
        matches = _stepped((left, right), shifts, known, settings, pool, widely=True)
    return Solved(matches=matches, shifts=shifts, vertical=vertical)


def initial(shifts: Both[Float32[Array, "h w"]], masks: Both[Bool[Array, "h w"]]) -> Both[LevelStart]:
    """The semi-global start, for least squares to compete with."""

    def one(here: int) -> LevelStart:
        shift = shifts[here]
        return LevelStart(
            shift=shift,
            correlation=np.zeros_like(shift),
            variance=np.full_like(shift, _START_DEVIATION_PX**2),
            plausible=masks[here] & agreeing(shift, shifts[1 - here], AGREEMENT_PX),
            halved=0,
        )

    return one(0), one(1)


def upsampled(solved: Solved, agreement_px: float, shape_hw: tuple[int, int]) -> Both[LevelStart]:
    """A level's result for the next finer level. Its smoothed fields, their uncertainty, what it accepted."""
    (left, right), (ours, theirs) = solved.matches, solved.shifts
    return (
        upsampled_start(left, ours, agreeing(ours, theirs, agreement_px), shape_hw),
        upsampled_start(right, theirs, agreeing(theirs, ours, agreement_px), shape_hw),
    )


def upsampled_start(
    matches: Estimate, shift: Float32[Array, "h w"], agrees: Bool[Array, "h w"], shape_hw: tuple[int, int]
) -> LevelStart:
    """One direction's result for the next finer level.

    `agrees` says where the other direction confirms `shift`.
    """
    return LevelStart(
        shift=finer_shift(shift, shape_hw),
        correlation=matches.correlation,
        variance=4 * matches.variance,
        plausible=matches.plausible & agrees,
        halved=1,
    )


def _stepped(
    sides: Both[Side],
    shifts: Both[Float32[Array, "h w"]],
    known: Both[LevelStart],
    settings: MatchSettings,
    pool: Executor,
    *,
    widely: bool,
) -> Both[Estimate]:
    """One least-squares step of both directions. What fails yields to what is known."""
    sigma = settings.window_sigma_px

    def one(here: Side, there: Side, shift: Float32[Array, "h w"]) -> Estimate:
        return step(here, there, shift, sigma, widely=widely)

    found = both(pool, one, sides, (sides[1], sides[0]), shifts)
    agree = both(
        pool, agreeing, (found[0].shift, found[1].shift), (found[1].shift, found[0].shift), (AGREEMENT_PX,) * 2
    )
    return both(pool, judged, found, agree, known)


def judged(ours: Estimate, agrees: Bool[Array, "h w"], known: LevelStart) -> Estimate:
    """Replace what fails, or disagrees, by what is known. The arrays are changed in place."""
    plausible = np.logical_and(ours.plausible, agrees, out=agrees)
    fine = (ours.shift, ours.step, ours.correlation, ours.variance, plausible)
    compete(fine, known.shift, known.correlation, known.variance, known.plausible, known.halved, _YIELDS_AT)
    return replace(ours, plausible=plausible)


def finally_smoothed(
    found: Estimate, mask: Bool[Array, "h w"], before: Float32[Array, "h w"], settings: MatchSettings
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"]]:
    """A direction's shifts and their expected variances.

    Smoothed at each pixel as finely as noise allows. `before` is what the last step started from.
    """
    return adaptively_smooth(
        found.shift,
        smoothing_weights(found.variance, found.plausible, mask),
        np.minimum(found.variance, _LARGEST_VARIANCE_PX2),
        settings.window_sigma_px,
        SMOOTHING_PX,
        _DETAIL_FACTOR,
        before,
    )
