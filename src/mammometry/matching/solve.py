"""Dense least squares on one pyramid level: both directions, smoothing between the steps (paper 2.3, Eq. 1).

Least squares with a free gain and offset maximises exactly the correlation of Eq. 1, and does it sub-pixel. The *shift*
of a direction is where its pixel is found in the other image: right = left + shift, so the left image's shift is minus
the disparity. Both directions obey the same code.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from mammometry.geometry.arrays import Array, Bool, Float32
from mammometry.matching.correlate import gaussian_taps, least_squares, warp_rows
from mammometry.matching.pyramid import Level, finer_field, finer_mask
from mammometry.matching.smooth import fill, response, smooth

_LARGEST_STEP_PX = 1.0
_AGREEMENT_PX = 1.0  # between the two directions, for a match to count in the smoothing
_START_DEVIATION_PX = 0.5  # of the semi-global start, pixels of its level
_LEAST_MASS = 0.3  # of the window inside both subjects
_DOUBTED_WEIGHT = 0.02  # of a match that failed, in the smoothing: it only bridges gaps
_LEAST_DEVIATION_PX = 0.01
_YIELDS_AT = 4.0  # times the coarser level's standard deviation: a finer match less certain than that is dropped
_HIGH_PASS = 4.0  # times the window's σ: slower shading goes into the offset anyhow, and costs float32 its digits
_DIFFERENCE_PX = 4.0  # Gaussian σ over which differences between smoothings are averaged


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Side:
    """One image of the pair on one level, prepared."""

    image: Float32[Array, "h w"]
    """High-passed luma."""
    coefficients: Float32[Array, "h w"]
    """Its cubic B-spline coefficients along the rows."""
    mask: Float32[Array, "h w"]
    """1 on the subject, else 0."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Estimate:
    """Least-squares result of one direction."""

    shift: Float32[Array, "h w"]
    """Field after the step, not smoothed; pixels of the level."""
    step: Float32[Array, "h w"]
    correlation: Float32[Array, "h w"]
    variance: Float32[Array, "h w"]
    """Of the shift, from the residual and the slope in the window, px²."""
    plausible: Bool[Array, "h w"]
    """Correlated, within the subject, small step."""


def prepare(level: Level, sigma_px: float) -> Side:
    """High-pass and spline coefficients of one image."""
    image = level.image - ndimage.gaussian_filter(level.image, _HIGH_PASS * sigma_px, mode="nearest", truncate=3)
    coefficients = ndimage.spline_filter1d(image, order=3, axis=1, mode="mirror", output=np.float32)
    return Side(image=image, coefficients=coefficients, mask=level.mask.astype(np.float32))


def step(
    sides: tuple[Side, Side],
    shifts: tuple[Float32[Array, "h w"], Float32[Array, "h w"]],
    sigma_px: float,
    least_correlation: float,
    flat_deviation: float,
    pool: ThreadPoolExecutor,
) -> tuple[Estimate, Estimate]:
    """One least-squares step of both directions from the given fields."""
    taps = gaussian_taps(sigma_px)

    def one(here: Side, there: Side, shift: Float32[Array, "h w"]) -> Estimate:
        value, slope, seen = warp_rows(there.coefficients, there.mask, shift)
        moved, correlation, mass, variance = least_squares(
            here.image, value, slope, here.mask * seen, taps, flat_deviation**2
        )
        plausible = (
            (here.mask > 0)
            & (seen > 0.5)
            & (mass > _LEAST_MASS)
            & (correlation > least_correlation)
            & (np.abs(moved) < _LARGEST_STEP_PX)
        )
        moved = np.clip(moved, -_LARGEST_STEP_PX, _LARGEST_STEP_PX)
        return Estimate(
            shift=shift + moved, step=moved, correlation=correlation, variance=variance, plausible=plausible
        )

    futures = [
        pool.submit(one, sides[0], sides[1], shifts[0]),
        pool.submit(one, sides[1], sides[0], shifts[1]),
    ]
    left, right = futures[0].result(), futures[1].result()
    return (
        replace(left, plausible=left.plausible & (disagreement(left.shift, right.shift) < _AGREEMENT_PX)),
        replace(right, plausible=right.plausible & (disagreement(right.shift, left.shift) < _AGREEMENT_PX)),
    )


def initial(
    shifts: tuple[Float32[Array, "h w"], Float32[Array, "h w"]], sides: tuple[Side, Side]
) -> tuple[Estimate, Estimate]:
    """The semi-global start as an estimate, for least squares to compete with."""
    made = [
        Estimate(
            shift=shifts[k],
            step=np.zeros_like(shifts[k]),
            correlation=np.zeros_like(shifts[k]),
            variance=np.full_like(shifts[k], _START_DEVIATION_PX**2),
            plausible=(sides[k].mask > 0) & (disagreement(shifts[k], shifts[1 - k]) < _AGREEMENT_PX),
        )
        for k in (0, 1)
    ]
    return made[0], made[1]


def carried(
    estimate: Estimate, shift: Float32[Array, "h w"], agrees: Bool[Array, "h w"], shape_hw: tuple[int, int]
) -> Estimate:
    """A level's result in the pixels of the next finer level: its smoothed field, its uncertainty, what it accepted."""
    return Estimate(
        shift=2 * finer_field(shift, shape_hw),
        step=np.zeros(shape_hw, dtype=np.float32),
        correlation=finer_field(estimate.correlation, shape_hw),
        variance=4 * finer_field(estimate.variance, shape_hw),
        plausible=finer_mask(estimate.plausible & agrees, shape_hw),
    )


def competed(fine: Estimate, coarse: Estimate) -> Estimate:
    """Keep the coarser level's match where the finer one fails, or is far less certain: its windows hold more texture."""
    yields = coarse.plausible & (~fine.plausible | (_YIELDS_AT**2 * coarse.variance < fine.variance))

    def choose(name: str) -> Float32[Array, "h w"]:
        return np.where(yields, getattr(coarse, name), getattr(fine, name))

    return Estimate(
        shift=choose("shift"),
        step=choose("step"),
        correlation=choose("correlation"),
        variance=choose("variance"),
        plausible=fine.plausible | yields,
    )


def disagreement(ours: Float32[Array, "h w"], theirs: Float32[Array, "h w"]) -> Float32[Array, "h w"]:
    """How far a pixel lands from itself when it goes to the other image and back, pixels; large where it leaves it."""
    width = ours.shape[1]
    target = np.arange(width, dtype=np.float32) + ours
    inside = (target >= 0) & (target <= width - 1)
    column = np.clip(target.astype(np.int32), 0, width - 2)
    fraction = target - column
    back = (1 - fraction) * np.take_along_axis(theirs, column, axis=1) + fraction * np.take_along_axis(
        theirs, column + 1, axis=1
    )
    return np.where(inside, np.abs(ours + back), np.float32(width)).astype(np.float32)


def trust(
    estimates: tuple[Estimate, Estimate], sides: tuple[Side, Side], agreement_px: float
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"]]:
    """Weights of the matches in the smoothing: 1/variance; little for those that failed or disagree."""
    weights = []
    for here in (0, 1):
        estimate = estimates[here]
        agrees = disagreement(estimate.shift, estimates[1 - here].shift) < agreement_px
        share = _DOUBTED_WEIGHT + (estimate.plausible & agrees)
        weights.append(
            (sides[here].mask * share / (np.minimum(estimate.variance, 1.0) + _LEAST_DEVIATION_PX**2)).astype(
                np.float32
            )
        )
    return weights[0], weights[1]


def smoothed(
    estimates: tuple[Estimate, Estimate],
    weights: tuple[Float32[Array, "h w"], Float32[Array, "h w"]],
    sigma_px: float,
    pool: ThreadPoolExecutor,
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"]]:
    """Both fields after plane smoothing."""
    futures = [pool.submit(smooth, estimates[k].shift, weights[k], sigma_px) for k in (0, 1)]
    return futures[0].result(), futures[1].result()


def adaptively_smoothed(
    estimate: Estimate,
    weights: Float32[Array, "h w"],
    window_sigma_px: float,
    scales_px: tuple[float, ...],
    factor: float,
) -> Float32[Array, "h w"]:
    """Plane smoothing at several scales; from the coarsest, each finer one is added as far as it exceeds noise."""
    fields = [smooth(estimate.shift, weights, scale) for scale in scales_px]
    result = fields[-1]
    known = (weights > 0).astype(np.float32)
    mass = ndimage.gaussian_filter(known, _DIFFERENCE_PX, mode="constant", truncate=3) + np.float32(1e-6)
    variance = (
        ndimage.gaussian_filter(known * np.minimum(estimate.variance, 1.0), _DIFFERENCE_PX, mode="constant", truncate=3)
        / mass
    )
    for index in range(len(scales_px) - 2, -1, -1):
        difference = fields[index] - fields[index + 1]
        power = ndimage.gaussian_filter(known * difference**2, _DIFFERENCE_PX, mode="constant", truncate=3) / mass
        noise = _difference_noise(scales_px[index], scales_px[index + 1], window_sigma_px) * variance
        result = result + difference * np.maximum(0, 1 - factor * noise / np.maximum(power, 1e-12))
    return fill(result.astype(np.float32), known)


def _difference_noise(fine_px: float, coarse_px: float, window_sigma_px: float) -> float:
    """Variance of the difference of two smoothings of unit noise that has already the window's correlation."""

    def two_dimensional(row: Float32[Array, " n"]) -> Float32[Array, "n n"]:
        plane: Float32[Array, "n n"] = np.outer(row, row)
        return plane

    def twiced(scale: float) -> Float32[Array, "n n"]:
        once = two_dimensional(response(scale))
        return 2 * once - once**2

    window = two_dimensional(response(window_sigma_px)) ** 2
    gain = (twiced(fine_px) - twiced(coarse_px)) ** 2
    return float((gain * window).sum() / window.sum())
