"""Dense least squares on one pyramid level: both directions, smoothing between the steps (paper 2.3, Eq. 1).

Least squares with a free gain and offset maximises exactly the correlation of Eq. 1, and does it sub-pixel. The *shift*
of a direction is where its pixel is found in the other image: right = left + shift, so the left image's shift is minus
the disparity. Both directions obey the same code, each in a thread of its own (the kernels release the lock).
"""

from collections.abc import Iterable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any, TypeAlias, TypeVar

import numpy as np
from scipy import ndimage

from mammometry.geometry.arrays import Array, Bool, Float32, Int64
from mammometry.matching.correlate import least_squares, row_slope, warp_rows
from mammometry.matching.filters import blur, gaussian_taps, there_and_back
from mammometry.matching.layers import beside_jump, layered_least_squares
from mammometry.matching.pyramid import Level, finer_field, finer_mask, finer_shift
from mammometry.matching.settings import MatchSettings
from mammometry.matching.smooth import adaptively_smooth, smooth
from mammometry.matching.vertical import VerticalField, refine

_LARGEST_STEP_PX = 1.0
_AGREEMENT_PX = 1.0  # between the two directions, for a match to count in the smoothing
_START_DEVIATION_PX = 0.5  # of the semi-global start, pixels of its level
_LEAST_MASS = 0.3  # of the window inside both subjects
_DOUBTED_WEIGHT = 0.02  # of a match that failed, in the smoothing: it only bridges gaps
_LEAST_DEVIATION_PX = 0.01
_LARGEST_VARIANCE_PX2 = 1.0
_WIDER = 2.0  # times the window, where the ordinary one fails: weak texture, dark folds
_WIDE_YIELDS_AT = 3.0  # times the wide window's standard deviation
_DOUBTED_DEVIATION_PX = 0.3
_LEAST_STRETCH = 0.5  # of a row from one image to the other
_YIELDS_AT = 4.0  # times the coarser level's standard deviation: a finer match less certain than that is dropped
_HIGH_PASS = 4.0  # times the window's σ: slower shading goes into the offset anyhow, and costs float32 its digits
_FIELD_REFINEMENTS = 2  # of the vertical field on each level, after its last steps
_SMALL_STEP_PX = 0.3  # a match that still moves by more says nothing about the rows
_COARSE_SMOOTHING_PX, _FINEST_SMOOTHING_PX = 2.5, 4.5  # σ of the plane fits between the steps

_T = TypeVar("_T")
Both: TypeAlias = tuple[_T, _T]
"""Of the left image and of the right one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Side:
    """One image of the pair on one level, prepared."""

    image: Float32[Array, "h w"]
    """High-passed luma."""
    coefficients: Float32[Array, "h w"]
    """Its cubic B-spline coefficients along the rows."""
    slope: Float32[Array, "h w"]
    """Its derivative along the rows."""
    mask: Float32[Array, "h w"]
    """1 on the subject, else 0."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Estimate:
    """Matches of one direction, before smoothing."""

    shift: Float32[Array, "h w"]
    """Where each pixel is found in the other image, minus its own column; pixels of the level."""
    step: Float32[Array, "h w"]
    """The last change of it."""
    correlation: Float32[Array, "h w"]
    """c of Eq. 1 before that change, −1…1."""
    variance: Float32[Array, "h w"]
    """Of the shift, from the residual and the slope in the window, px²."""
    plausible: Bool[Array, "h w"]
    """On the subject in both images, correlated, a small step, both directions agree."""


def solve_level(
    images: Both[Level],
    level: int,
    shifts: Both[Float32[Array, "h w"]],
    carried_over: Both[Estimate],
    field: VerticalField,
    settings: MatchSettings,
    pool: Executor,
    *,
    steps: int,
    last: bool,
) -> tuple[Both[Estimate], Both[Float32[Array, "h w"]], Float32[Array, "h w"], VerticalField]:
    """Improve both directions' shifts on one level by some steps; on the last level the final smoothing follows.

    Returns the last step's matches, the smoothed shifts, the expected variance of the left one (of a single window's
    match before the last level, of the final smoothing's result on it) and the vertical field.
    """
    sigma = settings.window_px / np.sqrt(12)
    left = _prepare(images[0], sigma)
    sides = (left, _prepare(field.aligned(images[1], level), sigma))
    scales = [_FINEST_SMOOTHING_PX if last else _COARSE_SMOOTHING_PX] * steps
    for index, scale in enumerate(scales):
        estimates = carried_over  # lets go of the last step's before this one's are made
        estimates = _compete(_step(sides, shifts, sigma, settings, pool), carried_over)
        weights = (_weights(estimates[0], sides[0]), _weights(estimates[1], sides[1]))
        shifts = _smoothed(estimates, weights, scale, shifts, pool)
        if index >= steps - _FIELD_REFINEMENTS:
            trusted = estimates[0].plausible & (np.abs(estimates[0].step) < _SMALL_STEP_PX)
            refined = refine(field, left.image, sides[1].coefficients, sides[1].mask, shifts[0], trusted, level)
            if field.matters(level) or refined.matters(level):
                sides = (left, _prepare(refined.aligned(images[1], level), sigma))
            field = refined
    if last:
        estimates = carried_over
        estimates = _compete(_step(sides, shifts, sigma, settings, pool), carried_over)
        smoothed = _finally_smoothed(estimates, sides, shifts, sigma, settings, pool)
        return estimates, (smoothed[0][0], smoothed[1][0]), smoothed[0][1], field
    return estimates, shifts, estimates[0].variance, field


def initial(shifts: Both[Float32[Array, "h w"]], masks: Both[Bool[Array, "h w"]]) -> Both[Estimate]:
    """The semi-global start as matches, for least squares to compete with."""

    def one(here: int) -> Estimate:
        shift = shifts[here]
        return Estimate(
            shift=shift,
            step=np.zeros_like(shift),
            correlation=np.zeros_like(shift),
            variance=np.full_like(shift, _START_DEVIATION_PX**2),
            plausible=masks[here] & (disagreement(shift, shifts[1 - here]) < _AGREEMENT_PX),
        )

    return one(0), one(1)


def carried(
    estimates: Both[Estimate], shifts: Both[Float32[Array, "h w"]], agreement_px: float, shape_hw: tuple[int, int]
) -> Both[Estimate]:
    """A level's result in the pixels of the next finer level: its smoothed field, its uncertainty, what it accepted."""

    def one(here: int) -> Estimate:
        agrees = disagreement(shifts[here], shifts[1 - here]) < agreement_px
        return Estimate(
            shift=finer_shift(shifts[here], shape_hw),
            step=np.broadcast_to(np.float32(0), shape_hw),
            correlation=finer_field(estimates[here].correlation, shape_hw),
            variance=4 * finer_field(estimates[here].variance, shape_hw),
            plausible=finer_mask(estimates[here].plausible & agrees, shape_hw),
        )

    return one(0), one(1)


def disagreement(ours: Float32[Array, "h w"], theirs: Float32[Array, "h w"]) -> Float32[Array, "h w"]:
    """How far a pixel lands from itself when it goes to the other image and back, pixels; large where it leaves it."""
    return there_and_back(ours, theirs)


def _prepare(level: Level, sigma_px: float) -> Side:
    image = level.image - blur(level.image, gaussian_taps(_HIGH_PASS * sigma_px))
    coefficients = ndimage.spline_filter1d(image, order=3, axis=1, mode="mirror", output=np.float32)
    return Side(
        image=image, coefficients=coefficients, slope=row_slope(coefficients), mask=level.mask.astype(np.float32)
    )


def _step(
    sides: Both[Side], shifts: Both[Float32[Array, "h w"]], sigma_px: float, settings: MatchSettings, pool: Executor
) -> Both[Estimate]:
    """One least-squares step of both directions from the given fields."""
    floor = settings.flat_deviation**2
    taps, wide_taps = gaussian_taps(sigma_px), gaussian_taps(_WIDER * sigma_px)

    def one(here: Side, there: Side, shift: Float32[Array, "h w"]) -> Estimate:
        value, slope, seen = warp_rows(there.coefficients, there.mask, shift)
        weight = here.mask * seen
        images = (here.image, value, _mean_slope(here, slope, shift, weight), weight)
        subject = (here.mask > 0) & (seen > 0.5)

        def estimate(solved: Iterable[Array], where: Any) -> Estimate:
            step, correlation, mass, variance = solved
            plausible = (
                subject[where]
                & (mass > _LEAST_MASS)
                & (correlation > settings.least_correlation)
                & (np.abs(step) < _LARGEST_STEP_PX)
            )
            step = np.clip(step, -_LARGEST_STEP_PX, _LARGEST_STEP_PX)
            return Estimate(
                shift=shift[where] + step, step=step, correlation=correlation, variance=variance, plausible=plausible
            )

        del value, slope
        solved = least_squares(*images, taps, floor)
        beside = _pixels(subject & beside_jump(shift, here.mask > 0, len(taps) // 2))
        for whole, part in zip(solved, layered_least_squares(beside, images, shift, taps, floor), strict=True):
            whole[beside] = part
        found = estimate(solved, (slice(None), slice(None)))
        doubted = _pixels(subject & (~found.plausible | (found.variance > _DOUBTED_DEVIATION_PX**2)))
        wide = layered_least_squares(doubted, images, shift, wide_taps, floor)
        return _where_better(found, estimate(wide, doubted), doubted)

    futures = (
        pool.submit(one, sides[0], sides[1], shifts[0]),
        pool.submit(one, sides[1], sides[0], shifts[1]),
    )
    left, right = futures[0].result(), futures[1].result()
    return (
        replace(left, plausible=left.plausible & (disagreement(left.shift, right.shift) < _AGREEMENT_PX)),
        replace(right, plausible=right.plausible & (disagreement(right.shift, left.shift) < _AGREEMENT_PX)),
    )


def _pixels(where: Bool[Array, "h w"]) -> tuple[Int64[Array, " n"], Int64[Array, " n"]]:
    rows, columns = np.nonzero(where)
    return rows, columns


def _mean_slope(
    here: Side, slope: Float32[Array, "h w"], shift: Float32[Array, "h w"], weight: Float32[Array, "h w"]
) -> Float32[Array, "h w"]:
    """The mean of both images' slopes: less noise than one's, and no bias towards the other image's grid."""
    own = here.slope / np.clip(1 + np.gradient(shift, axis=1), _LEAST_STRETCH, 1 / _LEAST_STRETCH)
    power = [float(np.einsum("ij,ij,ij->", weight, each, each, optimize=False)) for each in (slope, own)]
    own *= np.float32(np.sqrt(power[0] / max(power[1], 1e-30)))
    own += slope
    own *= np.float32(0.5)
    mean: Float32[Array, "h w"] = own
    return mean


def _where_better(found: Estimate, wide: Estimate, where: Any) -> Estimate:
    """Take the wide window's matches at the given pixels where the ordinary ones fail or are far less certain."""
    better = wide.plausible & (~found.plausible[where] | (_WIDE_YIELDS_AT**2 * wide.variance < found.variance[where]))
    chosen = tuple(index[better] for index in where)
    for name in ("shift", "step", "correlation", "variance", "plausible"):
        getattr(found, name)[chosen] = getattr(wide, name)[better]
    return found


def _compete(fine: Both[Estimate], coarse: Both[Estimate]) -> Both[Estimate]:
    """Keep the coarser level's match where the finer one fails, or is far less certain: its windows hold more."""

    def one(ours: Estimate, other: Estimate) -> Estimate:
        yields = other.plausible & (~ours.plausible | (_YIELDS_AT**2 * other.variance < ours.variance))
        for name in ("shift", "step", "correlation", "variance"):
            np.copyto(getattr(ours, name), getattr(other, name), where=yields)  # in place: memory is what limits here
        return replace(ours, plausible=ours.plausible | yields)

    return one(fine[0], coarse[0]), one(fine[1], coarse[1])


def _weights(estimate: Estimate, side: Side) -> Float32[Array, "h w"]:
    """Weights of the matches in the smoothing: 1/variance, little for those that failed."""
    share = _DOUBTED_WEIGHT + estimate.plausible.astype(np.float32)
    variance = np.minimum(estimate.variance, _LARGEST_VARIANCE_PX2) + _LEAST_DEVIATION_PX**2
    return (side.mask * share / variance).astype(np.float32)


def _smoothed(
    estimates: Both[Estimate],
    weights: Both[Float32[Array, "h w"]],
    scale_px: float,
    before: Both[Float32[Array, "h w"]],
    pool: Executor,
) -> Both[Float32[Array, "h w"]]:
    futures = [pool.submit(smooth, estimates[k].shift, weights[k], scale_px, before[k]) for k in (0, 1)]
    return futures[0].result(), futures[1].result()


def _finally_smoothed(
    estimates: Both[Estimate],
    sides: Both[Side],
    before: Both[Float32[Array, "h w"]],
    sigma_px: float,
    settings: MatchSettings,
    pool: Executor,
) -> Both[tuple[Float32[Array, "h w"], Float32[Array, "h w"]]]:
    def one(here: int) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"]]:
        variance = np.minimum(estimates[here].variance, _LARGEST_VARIANCE_PX2)
        return adaptively_smooth(
            estimates[here].shift,
            _weights(estimates[here], sides[here]),
            variance,
            sigma_px,
            settings.smoothing_px,
            settings.detail_factor,
            before[here],
        )

    futures = [pool.submit(one, here) for here in (0, 1)]
    return futures[0].result(), futures[1].result()
