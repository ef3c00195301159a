"""Dense least squares on one pyramid level (paper 2.3, Eq. 1).

In both directions, with smoothing between the steps. Least squares with a free gain and offset maximises exactly the
correlation of Eq. 1, with sub-pixel resolution. The *shift* of a direction is the match's column in the other image
minus the pixel's own: right = left + shift, so the left image's shift is minus the disparity. Both directions use the
same code, each in its own thread (kernels release the GIL). `choose_levels` chooses which levels are matched, in how
many steps.
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
    MatchEstimate,
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
"""Subject size (square root of its area, pixels) above which a level is not matched from both images: at full
resolution optics leave little detail. One level coarser, only left matches are computed and checked by coarser right
ones. So semi-global matching starts at half of this size at most; at a quarter, folds and arms would be matched as one
surface."""

_FIRST_STEPS, _FURTHER_STEPS, _LAST_STEPS = 5, 4, 2
"""Least-squares steps on the coarsest, the middle and the last level matched from both images.

An error remaining on a coarse level has twice as many pixels on the next. Once it exceeds the texture's grain it
remains (docs/decisions/0015).
"""
_SMALLEST_SPAN_PX = 24  # about three windows
_CALM_SPAN_PX = 230  # larger subjects start one level coarser, because of the finest level's noise
_SOFT_SPAN_PX = 150  # smallest size of a blurred subject on its finest level: windows cover too much of smaller ones
_FINEST_LEVEL = 1  # finest level of a large subject: optics leave little detail at full resolution


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelWork:
    """Work on one level that is matched from both images."""

    level: int
    """Halvings of the rectified images."""
    steps: int
    """Least-squares steps."""
    last: bool
    """Whether it is the last level matched from both images: it has one more step, with wide windows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Levels:
    """Levels of one match, coarse to fine. Level 0 is the rectified image, the next have half the size."""

    coarsest: int
    """Level of the semi-global start."""
    last_both: int
    """Finest level matched from both images. Finer ones are refined from the left one only."""
    finest: int

    def both(self) -> list[LevelWork]:
        """Work of the levels that are matched from both images."""
        return [
            LevelWork(level=level, steps=self._steps(level), last=level == self.last_both)
            for level in range(self.coarsest, self.last_both - 1, -1)
        ]

    def left_only(self) -> range:
        """Levels on which only the left image is refined."""
        return range(self.last_both - 1, self.finest - 1, -1)

    def share_done(self, level: int) -> float:
        """Progress, 0…1, when a level finer than the coarsest is done."""
        return 0.9 - 0.6 * (level - self.finest) / (self.coarsest - self.finest)

    def _steps(self, level: int) -> int:
        if level == self.coarsest:
            return _FIRST_STEPS
        return _LAST_STEPS if level == self.last_both else _FURTHER_STEPS


def choose_levels(pair_name: str, masks: Sequence[Bool[Array, "h w"]], *, empty: int = 0) -> Levels:
    """Choose the levels by the size of the smaller subject and the sharpness of the more blurred image.

    Args:
        pair_name: name of the pair, for messages.
        masks: the subject's pixels in both images.
        empty: number of finest levels in which an image has no details (`sharpness`), only noise.

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
"""Gaussian σ of the final plane fits, pixels of the finest level, fine to coarse. Each pixel uses the finest that its
noise allows."""
AGREEMENT_PX = 1.0  # largest difference between the directions for a match to be used in smoothing
_START_DEVIATION_PX = 0.5  # standard deviation of the semi-global start, pixels of its level
_YIELDS_AT = 4.0  # ratio to the coarser match's standard deviation above which a finer match is replaced by it
_COARSE_SMOOTHING_PX = 2.5  # σ of the plane fits between the steps: that of a window
LAST_SMOOTHING_PX = 4.5  # … on the last level; 3.5 px was 5 % worse on the torso (docs/decisions/0015)
_DETAIL_FACTOR = 2.75
"""A finer final smoothing is used where the square of its difference from the next coarser one exceeds the noise
variance by this factor. 3, 4 and 6 gave worse results (docs/decisions/0015)."""

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LevelStart:
    """Start of a level in one direction: the semi-global result or the coarser level's matches."""

    shift: Float32[Array, "h w"]
    """Pixels of this level."""
    correlation: Float32[Array, "H W"]
    """c of Eq. 1, −1…1."""
    variance: Float32[Array, "H W"]
    """Variance of the shift, px² of this level."""
    plausible: Bool[Array, "H W"]
    """Accepted on the coarser level."""
    halved: int
    """1 if everything but the shift is on the coarser level's pixels, otherwise 0."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LevelResult:
    """Result of a level."""

    matches: Both[MatchEstimate]
    """Matches of the last step."""
    shifts: Both[Float32[Array, "h w"]]
    """Smoothed. On the finest level: the start of the last step."""
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
) -> LevelResult:
    """Improve both directions' shifts on one level, with smoothing.

    The last level has one more step with wide windows, followed by `finally_smoothed`.
    """
    sigma = settings.window_sigma_px
    left, right = both(pool, prepare_side, (images[0], aligned(vertical, images[1], work.level)), (sigma, sigma))
    masks = (images[0].mask, images[1].mask)
    shifts = (known[0].shift, known[1].shift)
    scale = LAST_SMOOTHING_PX if work.last else _COARSE_SMOOTHING_PX

    def smoothed(
        found: MatchEstimate, mask: Bool[Array, "h w"], before: Float32[Array, "h w"]
    ) -> Float32[Array, "h w"]:
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
            del matches  # freed before the next ones are computed: they are large
    if work.last:
        matches = _stepped((left, right), shifts, known, settings, pool, widely=True)
    return LevelResult(matches=matches, shifts=shifts, vertical=vertical)


def initial(shifts: Both[Float32[Array, "h w"]], masks: Both[Bool[Array, "h w"]]) -> Both[LevelStart]:
    """The semi-global start, with which least squares competes."""

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


def upsampled(solved: LevelResult, agreement_px: float, shape_hw: tuple[int, int]) -> Both[LevelStart]:
    """A level's result for the next finer level: smoothed fields, their uncertainty, accepted matches."""
    (left, right), (ours, theirs) = solved.matches, solved.shifts
    return (
        upsampled_start(left, ours, agreeing(ours, theirs, agreement_px), shape_hw),
        upsampled_start(right, theirs, agreeing(theirs, ours, agreement_px), shape_hw),
    )


def upsampled_start(
    matches: MatchEstimate, shift: Float32[Array, "h w"], agrees: Bool[Array, "h w"], shape_hw: tuple[int, int]
) -> LevelStart:
    """One direction's result for the next finer level. `agrees`: the other one confirms `shift`."""
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
) -> Both[MatchEstimate]:
    """One least-squares step of both directions. Failed matches are replaced by known ones."""
    sigma = settings.window_sigma_px

    def one(here: Side, there: Side, shift: Float32[Array, "h w"]) -> MatchEstimate:
        return step(here, there, shift, sigma, widely=widely)

    found = both(pool, one, sides, (sides[1], sides[0]), shifts)
    agree = both(
        pool, agreeing, (found[0].shift, found[1].shift), (found[1].shift, found[0].shift), (AGREEMENT_PX,) * 2
    )
    return both(pool, judged, found, agree, known)


def judged(ours: MatchEstimate, agrees: Bool[Array, "h w"], known: LevelStart) -> MatchEstimate:
    """Replace failed or disagreeing matches by known ones. The arrays are changed in place."""
    plausible = np.logical_and(ours.plausible, agrees, out=agrees)
    fine = (ours.shift, ours.step, ours.correlation, ours.variance, plausible)
    compete(fine, known.shift, known.correlation, known.variance, known.plausible, known.halved, _YIELDS_AT)
    return replace(ours, plausible=plausible)


def finally_smoothed(
    found: MatchEstimate, mask: Bool[Array, "h w"], before: Float32[Array, "h w"], settings: MatchSettings
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"]]:
    """A direction's smoothed shifts and their expected variances.

    Each pixel is smoothed as finely as its noise allows. `before` is the start of the last step.
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
