"""Dense least squares on one pyramid level (paper 2.3, Eq. 1).

Both directions, with smoothing between the steps. Least squares with a free gain and offset maximises exactly the
correlation of Eq. 1, and does it sub-pixel. The *shift* of a direction is where its pixel is found in the other image:
right = left + shift, so the left image's shift is minus the disparity. Both directions obey the same code, each in a
thread of its own (the kernels release the lock). `choose_levels` says which levels are matched, in how many steps.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from mammometry.base.errors import MatchingError
from mammometry.geometry.arrays import Array, Bool, Float32
from mammometry.matching.dense.least_squares_step import (
    LARGEST_VARIANCE_PX2,
    Both,
    Estimate,
    Side,
    agreeing,
    compete,
    prepare_side,
    smoothing_weights,
    step,
)
from mammometry.matching.dense.plane_smoothing import adaptively_smooth, smooth
from mammometry.matching.dense.vertical_disparity import LevelState, Vertical, aligned
from mammometry.matching.pyramid import Level, finer_shift
from mammometry.matching.semiglobal import span_px
from mammometry.matching.settings import MatchSettings

FINEST_SPAN_PX = 800.0
"""Subject size (root of its area, pixels) above which a level is not matched from both pictures: on the photograph's
own pixels optics leave little. One level coarser only left matches are made, which coarser right ones check. So
semi-global matching starts at half of it at most; at a quarter, folds and arms are taken for one surface."""

_FIRST_STEPS, _FURTHER_STEPS, _LAST_STEPS = 5, 4, 2
"""Least-squares steps on the coarsest, the middle and the last level solved from both pictures.

An error left on a coarse level is twice as many pixels on the next. Once it exceeds the texture's grain it stays
(docs/decisions/0015).
"""
_SMALLEST_SPAN_PX = 24  # about three windows; chosen by eye
_CALM_SPAN_PX = 230  # a larger subject starts a level coarser: the finest one's noise made plaster_b's start err (0015)
_SOFT_SPAN_PX = 150  # of a soft subject on its finest level: a smaller one's windows span too much of it; by eye
_FINEST_LEVEL = 1  # of a large subject: optics leave little on the photograph's own pixels


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelWork:
    """Work on one level that both pictures solve."""

    level: int
    """Halvings of the rectified pictures."""
    steps: int
    """Least-squares steps."""
    last: bool
    """Whether it is the last level solved from both pictures: it takes one step more, with wide windows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Levels:
    """Levels of one match, coarse to fine. Level 0 is the rectified picture, each next one half of it."""

    coarsest: int
    """The semi-global start is made here."""
    last_both: int
    """Finest level solved from both pictures. Below it, only the left one is refined."""
    finest: int

    def both(self) -> list[LevelWork]:
        """Work of the levels that both pictures solve."""
        return [
            LevelWork(level=level, steps=self._steps(level), last=level == self.last_both)
            for level in range(self.coarsest, self.last_both - 1, -1)
        ]

    def left_only(self) -> range:
        """Levels on which only the left picture is refined."""
        return range(self.last_both - 1, self.finest - 1, -1)

    def share_done(self, level: int) -> float:
        """Progress, 0…1, once a level finer than the coarsest is done."""
        return 0.9 - 0.6 * (level - self.finest) / (self.coarsest - self.finest)

    def _steps(self, level: int) -> int:
        if level == self.coarsest:
            return _FIRST_STEPS
        return _LAST_STEPS if level == self.last_both else _FURTHER_STEPS


def choose_levels(pair_name: str, masks: Sequence[Bool[Array, "h w"]], *, empty: int = 0) -> Levels:
    """Choose the levels by the size of the smaller subject and the sharpness of the softer picture.

    Args:
        pair_name: for the message.
        masks: the subject's pixels in both pictures.
        empty: finest levels in which one of the pictures holds no details (`sharpness`): only noise is there.

    Raises:
        MatchingError: a subject is too small to be matched.
    """
    span = min(span_px(mask) for mask in masks)
    if span < _SMALLEST_SPAN_PX:
        raise MatchingError(
            f"pair {pair_name}",
            found=f"a subject of {span:.0f} pixels across",
            expected=f"at least {_SMALLEST_SPAN_PX}",
            remedy="Check the foreground masks",
        )
    empty = max(0, min(empty, int(np.log2(span / _SOFT_SPAN_PX))))
    last_both = max(empty, int(np.ceil(np.log2(span / FINEST_SPAN_PX))))
    coarsest = last_both + int(span / 2**last_both > _CALM_SPAN_PX)
    return Levels(coarsest=coarsest, last_both=last_both, finest=max(empty, min(last_both, _FINEST_LEVEL)))


SMOOTHING_PX = (2.5, 4.0, 6.4, 10.2)
"""Gaussian σ of the final plane fits, pixels of the finest level, fine to coarse. Each pixel takes a finer one as far
as noise allows."""
AGREEMENT_PX = 1.0  # between the two directions, for a match to count in the smoothing; chosen by eye
_START_DEVIATION_PX = 0.5  # of the semi-global start, pixels of its level; chosen by eye
_YIELDS_AT = 4.0  # times the known match's standard deviation: a finer match less certain is dropped; chosen by eye
_COARSE_SMOOTHING_PX = 2.5  # σ of the plane fits between the steps: a window's own
LAST_SMOOTHING_PX = 4.5  # … on the last level; 3.5 px was worse on the torso by a twentieth (docs/decisions/0015)
_DETAIL_FACTOR = 2.75
"""Ratio to the noise variance of its difference from the next one, above which a finer final smoothing is used. 3, 4
and 6 measured worse (docs/decisions/0015)."""

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LevelStart:
    """Start of a level in one direction: semi-global, or the coarser level's matches."""

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
    left, right = both(pool, prepare_side, (images[0], aligned(vertical, images[1], work.level)), (sigma, sigma))
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
                right = prepare_side(aligned(refined, images[1], work.level), sigma)
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
        np.minimum(found.variance, LARGEST_VARIANCE_PX2),
        settings.window_sigma_px,
        SMOOTHING_PX,
        _DETAIL_FACTOR,
        before,
    )
