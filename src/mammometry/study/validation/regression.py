"""Straight lines with errors in both methods: Deming, and Passing and Bablok.

Deming's line uses the ratio of both error variances, with intervals by the jackknife: Linnet, Clinical Chemistry 39
(1993) 424. Passing and Bablok, Journal of Clinical Chemistry and Clinical Biochemistry 21 (1983) 709, make no
assumption about the distribution of errors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy  # scipy.stats, which takes half a second to import, is imported on first use

from mammometry.geometry.arrays import Array, Float64, Int64
from mammometry.study.agreement import IntervalEstimate


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """Measured = intercept + slope × truth. NaN if it cannot be determined."""

    slope: IntervalEstimate
    intercept: IntervalEstimate

    @property
    def proportional(self) -> bool:
        """Whether the interval of the slope excludes 1."""
        low, high = self.slope.interval
        return low > 1 or high < 1


def deming(
    truth: Float64[Array, " n"], measured: Float64[Array, " n"], women: Int64[Array, " n"], ratio: float = 1.0
) -> Line:
    """Fit Deming's line.

    Args:
        truth: values by the reference method.
        measured: values by the method under test.
        women: index of each row's woman, from 0. The jackknife leaves out one woman at a time.
        ratio: error variance of `measured` divided by that of `truth`.
    """
    whole = _deming(truth, measured, ratio)
    count = int(women.max()) + 1
    left_out = np.array([_deming(truth[women != woman], measured[women != woman], ratio) for woman in range(count)])
    single = count * whole - (count - 1) * left_out
    reach = float(scipy.stats.t.ppf(0.975, count - 1)) * single.std(axis=0, ddof=1) / math.sqrt(count)
    slope, intercept = (
        IntervalEstimate(value=float(centre), interval=(float(centre - half), float(centre + half)))
        for centre, half in zip(whole, reach, strict=True)
    )
    return Line(slope=slope, intercept=intercept)


def _deming(x: Float64[Array, " n"], y: Float64[Array, " n"], ratio: float) -> Float64[Array, " 2"]:
    (sxx, sxy), (_, syy) = np.cov(x, y)
    if not sxy:
        return np.full(2, np.nan)
    apart = syy - ratio * sxx
    root = math.sqrt(apart**2 + 4 * ratio * sxy**2)
    # in the form without cancellation
    slope = (apart + root) / (2 * sxy) if apart > 0 else 2 * ratio * sxy / (root - apart)
    return np.array([slope, y.mean() - slope * x.mean()])


def passing_bablok(truth: Float64[Array, " n"], measured: Float64[Array, " n"]) -> Line:
    """Fit Passing and Bablok's line. All rows are treated as independent."""
    n = len(truth)
    first, second = np.triu_indices(n, 1)
    across, up = truth[second] - truth[first], measured[second] - measured[first]
    kept = (across != 0) | (up != 0)
    with np.errstate(divide="ignore"):
        slopes = up[kept] / across[kept]
    slopes = np.sort(slopes[slopes != -1])
    shift, count = int((slopes < -1).sum()), len(slopes)
    if not count:
        nothing = IntervalEstimate(value=math.nan, interval=(math.nan, math.nan))
        return Line(slope=nothing, intercept=nothing)
    slope = (slopes[_at((count - 1) // 2 + shift, count)] + slopes[_at(count // 2 + shift, count)]) / 2
    spread = float(scipy.special.ndtri(0.975)) * math.sqrt(n * (n - 1) * (2 * n + 5) / 18)
    lowest = round((count - spread) / 2)
    low = float(slopes[_at(lowest + shift - 1, count)])
    high = float(slopes[_at(count - lowest + shift, count)])
    own = [float(np.median(measured - value * truth)) for value in (slope, high, low)]
    return Line(
        slope=IntervalEstimate(value=float(slope), interval=(low, high)),
        intercept=IntervalEstimate(value=own[0], interval=(own[1], own[2])),
    )


def _at(place: int, count: int) -> int:
    return min(max(place, 0), count - 1)


def concordance(first: Float64[Array, " n"], second: Float64[Array, " n"]) -> float:
    """Lin's concordance correlation coefficient. Biometrics 45 (1989) 255."""
    (own, common), (_, other) = np.cov(first, second, ddof=0)
    whole = own + other + (first.mean() - second.mean()) ** 2
    return float(2 * common / whole) if whole else math.nan
