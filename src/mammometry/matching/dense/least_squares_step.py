"""One least-squares step of one direction, and kernels that compare both directions.

The step works in bands of rows, to limit memory. Both directions must agree, a fine match competes with the coarse one,
and smoothing is weighted by certainty.
"""

from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

import numpy as np
from scipy import ndimage

from mammometry.base.machine.compiled import fast_kernel
from mammometry.geometry.arrays import Array, Bool, Float32, Int64
from mammometry.matching.correlation_kernels import least_squares, mean_slope, slope_ratio, warp_rows
from mammometry.matching.dense.depth_layers import beside_jump, layered_least_squares
from mammometry.matching.filters import blur, gaussian_taps
from mammometry.matching.pyramid import Level

_DOUBTED_WEIGHT = np.float32(0.02)  # relative weight of a failed match, which only fills gaps
_LEAST_VARIANCE_PX2 = np.float32(0.01**2)  # lower limit, so that no single match dominates
LARGEST_STEP_PX = 1.0  # the linear model of a window is not valid for larger steps
LARGEST_VARIANCE_PX2 = np.float32(LARGEST_STEP_PX**2)


@fast_kernel
def agreeing(ours: Float32[Array, "h w"], theirs: Float32[Array, "h w"], limit: float) -> Bool[Array, "h w"]:
    """Mask of the pixels that map to the other image and back to within the limit, pixels."""
    height, width = ours.shape
    out = np.zeros((height, width), dtype=np.bool_)
    largest = np.float32(limit)
    for i in range(height):
        back, row, going = theirs[i], out[i], ours[i]
        for j in range(width):
            target = np.float32(j) + going[j]
            if target < 0 or target > width - 1:
                continue
            column = min(int(target), width - 2)
            fraction = target - np.float32(column)
            returned = (np.float32(1.0) - fraction) * back[column] + fraction * back[column + 1]
            row[j] = abs(going[j] + returned) < largest
    return out


@fast_kernel
def _between(values, i, j, halved):  # type: ignore[no-untyped-def]
    """Interpolate a coarse field, halved 0 or 1 times, linearly at a finer pixel."""
    if halved == 0:
        return values[i, j]
    row, column = i >> 1, j >> 1
    other_row = min(max(row + 2 * (i & 1) - 1, 0), values.shape[0] - 1)
    other_column = min(max(column + 2 * (j & 1) - 1, 0), values.shape[1] - 1)
    near, far = np.float32(0.75), np.float32(0.25)
    return near * (near * values[row, column] + far * values[row, other_column]) + far * (
        near * values[other_row, column] + far * values[other_row, other_column]
    )


@fast_kernel
def compete(
    fine: tuple[
        Float32[Array, "h w"], Float32[Array, "h w"], Float32[Array, "h w"], Float32[Array, "h w"], Bool[Array, "h w"]
    ],
    shift: Float32[Array, "h w"],
    correlation: Float32[Array, "H W"],
    variance: Float32[Array, "H W"],
    plausible: Bool[Array, "H W"],
    halved: int,
    yields_at: float,
) -> None:
    """Replace a fine match by the known one where it fails or its deviation is `yields_at` times larger.

    `fine` are shift, step, correlation, variance and whether plausible, changed in place. The known values other than
    the shift are on a grid that is halved 0 or 1 times, and are interpolated.
    """
    fine_shift, fine_step, fine_correlation, fine_variance, fine_plausible = fine
    height, width = shift.shape
    factor = np.float32(yields_at * yields_at)
    for i in range(height):
        row = i >> halved
        for j in range(width):
            column = j >> halved
            if not plausible[row, column]:
                continue
            known_variance = _between(variance, i, j, halved)
            if fine_plausible[i, j] and factor * known_variance >= fine_variance[i, j]:
                continue
            fine_shift[i, j] = shift[i, j]
            fine_step[i, j] = np.float32(0.0)
            fine_correlation[i, j] = _between(correlation, i, j, halved)
            fine_variance[i, j] = known_variance
            fine_plausible[i, j] = True


@fast_kernel
def smoothing_weights(
    variance: Float32[Array, "h w"], plausible: Bool[Array, "h w"], mask: Bool[Array, "h w"]
) -> Float32[Array, "h w"]:
    """Weights in the smoothing: 1/variance, small for failed matches, 0 outside the mask."""
    height, width = variance.shape
    out = np.empty((height, width), dtype=np.float32)
    for i in range(height):
        row, spread, good, inside = out[i], variance[i], plausible[i], mask[i]
        for j in range(width):
            share = _DOUBTED_WEIGHT + np.float32(good[j])
            weight = share / (min(spread[j], LARGEST_VARIANCE_PX2) + _LEAST_VARIANCE_PX2)
            row[j] = weight if inside[j] else np.float32(0.0)
    return out


LEAST_CORRELATION = 0.3
"""Correlation below which a match is rejected (c of Eq. 1). It shows the amount of noise, not the match's error:
accepted matches must also agree in both directions and be certain enough."""
LEAST_MASS = 0.3  # smallest part of the window inside both subjects
FLAT_DEVIATION = 0.002  # least SD of luma (0…1) in a window that can be matched: half a step of 8 bit
_BAND_ROWS = 192  # bounds memory: a full-size torso under a gigabyte (docs/decisions/0020)
_WIDER = 2.0  # width of the wide window, for weak texture and dark folds (docs/decisions/0015)
_WIDE_YIELDS_AT = 3.0  # ratio to the wide window's standard deviation above which the ordinary match is replaced
DOUBTED_DEVIATION_PX = 0.3  # expected deviation above which the wide window is used too (docs/decisions/0015)
_HIGH_PASS = 2.0  # σ of the high-pass in window σ; 3, 5 and 10 px were compared (docs/decisions/0015, Whitening)

_T = TypeVar("_T")
Both: TypeAlias = tuple[_T, _T]
"""Values of the left and the right image."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Side:
    """One image of the pair on one level, prepared for matching."""

    image: Float32[Array, "h w"]
    """High-passed luma."""
    coefficients: Float32[Array, "h w"]
    """Cubic B-spline coefficients along the rows."""
    mask: Bool[Array, "h w"]
    """The subject's pixels."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MatchEstimate:
    """Matches of one direction, before smoothing."""

    shift: Float32[Array, "h w"]
    """Column of each pixel's match in the other image minus its own. Pixels of the level."""
    step: Float32[Array, "h w"]
    """Change of the shift in the last step."""
    correlation: Float32[Array, "h w"]
    """c of Eq. 1 before that change, −1…1."""
    variance: Float32[Array, "h w"]
    """Variance of the shift, from the residual and the slope in the window, px²."""
    plausible: Bool[Array, "h w"]
    """On the subject in both images, correlated, a small step, and both directions agree."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Warp:
    """Values shared by the bands of one step."""

    here: Side
    there: Side
    shift: Float32[Array, "h w"]
    """Shift of the whole image before the step."""
    ratio: float
    """Factor by which the other image is steeper, see `slope_ratio`."""
    beside: Bool[Array, "h w"]
    """Pixels near a depth jump."""


def prepare_side(level: Level, sigma_px: float) -> Side:
    """High-pass an image for windows of σ `sigma_px`, and compute its spline."""
    image = blur(level.image, gaussian_taps(_HIGH_PASS * sigma_px))
    np.subtract(level.image, image, out=image)
    coefficients = ndimage.spline_filter1d(image, order=3, axis=1, mode="mirror", output=np.float32)
    return Side(image=image, coefficients=coefficients, mask=level.mask)


def step(here: Side, there: Side, shift: Float32[Array, "h w"], sigma_px: float, *, widely: bool) -> MatchEstimate:
    """Improve a direction's shifts by one least-squares step.

    Near depth jumps only neighbours on the pixel's own layer are used. With `widely`, a window of twice the width is
    also used where the match fails or is uncertain.
    """
    height, width = shift.shape
    warp = _Warp(
        here=here,
        there=there,
        shift=shift,
        ratio=slope_ratio(here.coefficients, here.mask, there.coefficients, there.mask, shift),
        beside=beside_jump(shift, here.mask, len(gaussian_taps(sigma_px)) // 2),
    )
    result = MatchEstimate(
        shift=np.empty((height, width), dtype=np.float32),
        step=np.empty((height, width), dtype=np.float32),
        correlation=np.empty((height, width), dtype=np.float32),
        variance=np.empty((height, width), dtype=np.float32),
        plausible=np.empty((height, width), dtype=bool),
    )
    for top in range(0, height, _BAND_ROWS):
        band = slice(top, min(top + _BAND_ROWS, height))
        found = _step_of_band(warp, band, sigma_px, widely=widely)
        for name in MatchEstimate.__dataclass_fields__:
            getattr(result, name)[band] = getattr(found, name)
    return result


def _step_of_band(warp: _Warp, band: slice, sigma_px: float, *, widely: bool) -> MatchEstimate:
    """`step` for the rows of a band."""
    here, there, shift = warp.here, warp.there, warp.shift
    taps, wide_taps = gaussian_taps(sigma_px), gaussian_taps(_WIDER * sigma_px)
    floor = FLAT_DEVIATION**2
    reach = len(wide_taps if widely else taps) // 2
    read = slice(max(0, band.start - reach), min(len(shift), band.stop + reach))
    inner = (band.start - read.start, band.stop - read.start)
    shifts = shift[read]
    value, slope, seen = warp_rows(there.coefficients[read], there.mask[read], shifts)
    mean_slope(slope, here.coefficients[read], shifts, warp.ratio)
    subject = here.mask[band] & (seen[slice(*inner)] > 0.5)
    seen *= here.mask[read]
    images = (here.image[read], value, slope, seen)

    def estimate(solved: Any, where: Any) -> MatchEstimate:
        change, correlation, mass, variance = solved
        plausible = (
            subject[where]
            & (mass > LEAST_MASS)
            & (correlation > LEAST_CORRELATION)
            & (np.abs(change) < LARGEST_STEP_PX)
        )
        np.clip(change, -LARGEST_STEP_PX, LARGEST_STEP_PX, out=change)
        return MatchEstimate(
            shift=shift[band][where] + change,
            step=change,
            correlation=correlation,
            variance=variance,
            plausible=plausible,
        )

    def in_windows(where: tuple[Int64[Array, " n"], Int64[Array, " n"]], window: Array) -> Float32[Array, "4 n"]:
        return layered_least_squares((where[0] + inner[0], where[1]), images, shifts, window, floor)

    solved = least_squares(*images, taps, floor, inner)
    jumping = _pixels(warp.beside[band] & subject)
    for whole, part in zip(solved, in_windows(jumping, taps), strict=True):
        whole[jumping] = part
    found = estimate(solved, (slice(None), slice(None)))
    if widely:
        doubted = _pixels(subject & (~found.plausible | (found.variance > DOUBTED_DEVIATION_PX**2)))
        _take_better(found, estimate(in_windows(doubted, wide_taps), doubted), doubted)
    return found


def _pixels(where: Bool[Array, "h w"]) -> tuple[Int64[Array, " n"], Int64[Array, " n"]]:
    rows, columns = np.nonzero(where)
    return rows, np.ascontiguousarray(columns)


def _take_better(found: MatchEstimate, wide: MatchEstimate, where: Any) -> None:
    """Replace ordinary matches by the wide window's where they fail or are much less certain."""
    better = wide.plausible & (~found.plausible[where] | (_WIDE_YIELDS_AT**2 * wide.variance < found.variance[where]))
    chosen = tuple(index[better] for index in where)
    for name in MatchEstimate.__dataclass_fields__:
        getattr(found, name)[chosen] = getattr(wide, name)[better]
