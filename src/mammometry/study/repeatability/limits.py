"""Limits of agreement between two raters or devices whose measurements are repeated.

Bland and Altman, Statistical Methods in Medical Research 8 (1999) 135, section 5.2: the true value of a breast is
constant, and the numbers of repetitions may differ. Intervals are by MOVER: Zou, Statistical Methods in Medical
Research 22 (2013) 630.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # scipy.stats, which takes half a second to import, is imported on first use

from mammometry.geometry.arrays import Array, Float64
from mammometry.study.agreement import IntervalEstimate
from mammometry.study.repeatability.components import chi_square_bounds

_Z95 = float(scipy.special.ndtri(0.975))
_LEAST = 3  # fewest breasts that both measured


@dataclass(frozen=True, slots=True, kw_only=True)
class RepeatedLimits:
    """Agreement of single measurements by two raters, devices or readers: second minus first.

    In the unit of the measurements, or in per cent of the first one.
    """

    what: str
    """``rater``, ``device`` or ``reader``."""
    first: str
    second: str
    breasts: int
    """Number of breasts that both measured."""
    bias: IntervalEstimate
    sd: IntervalEstimate
    """Standard deviation of the difference between two single measurements."""
    lower: IntervalEstimate
    """Lower limit of agreement. 95 % of single differences are between the limits."""
    upper: IntervalEstimate


def repeated_limits(
    first: Mapping[str, Sequence[float]],
    second: Mapping[str, Sequence[float]],
    women: int,
    *,
    names: tuple[str, str, str],
) -> RepeatedLimits | None:
    """Limits of agreement of two methods with repeated measurements.

    Args:
        first: breast → its measurements by the first method.
        second: the same for the second method.
        women: number of women with breasts that both methods measured. A woman's breasts are not independent.
        names: what is compared, and the names of both.

    Returns:
        None if both methods measured fewer than three breasts or two women.
    """
    common = [breast for breast in first if breast in second]
    n = len(common)
    if n < _LEAST or women < 2:
        return None
    own = [[np.asarray(method[breast], dtype=np.float64) for breast in common] for method in (first, second)]
    differences = np.array([two.mean() - one.mean() for one, two in zip(*own, strict=True)])
    df = min(women, n) - 1
    terms = [(float(differences.var(ddof=1)), float(df))]
    for method in own:
        within, own_df, share = _within(method)
        if share > 0:
            terms.append((share * within, own_df))
    variance = sum(term for term, _ in terms)
    below, above = (
        math.sqrt(sum((term * (chi_square_bounds(term_df)[side] - 1)) ** 2 for term, term_df in terms))
        for side in (0, 1)
    )
    sd = math.sqrt(variance)
    low, high = math.sqrt(max(variance - below, 0.0)), math.sqrt(variance + above)
    bias = float(differences.mean())
    reach = float(scipy.stats.t.ppf(0.975, df)) * math.sqrt(terms[0][0] / n)
    outward, inward = (math.hypot(reach, _Z95 * (bound - sd)) for bound in (high, low))
    return RepeatedLimits(
        what=names[0],
        first=names[1],
        second=names[2],
        breasts=n,
        bias=IntervalEstimate(value=bias, interval=(bias - reach, bias + reach)),
        sd=IntervalEstimate(value=sd, interval=(low, high)),
        lower=IntervalEstimate(
            value=bias - _Z95 * sd, interval=(bias - _Z95 * sd - outward, bias - _Z95 * sd + inward)
        ),
        upper=IntervalEstimate(
            value=bias + _Z95 * sd, interval=(bias + _Z95 * sd - inward, bias + _Z95 * sd + outward)
        ),
    )


def _within(own: Sequence[Float64[Array, " m"]]) -> tuple[float, float, float]:
    """Variance within breasts, its degrees of freedom, and 1 − mean of 1/m."""
    df = float(sum(len(values) - 1 for values in own))
    if not df:
        return 0.0, 0.0, 0.0
    squares = sum(float(((values - values.mean()) ** 2).sum()) for values in own)
    return squares / df, df, 1.0 - float(np.mean([1 / len(values) for values in own]))
