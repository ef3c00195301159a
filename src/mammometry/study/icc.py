"""All forms of the intraclass correlation, with intervals.

By Shrout and Fleiss, Psychological Bulletin 86 (1979) 420. Mean squares, F tests and intervals are by McGraw and Wong,
Psychological Methods 1 (1996) 30. Two-way random and two-way mixed models have the same estimates.

k measurements with equal correlations ρ have a covariance matrix only if ρ ≥ −1/(k − 1) (Fisher, Statistical Methods
for Research Workers, 1925, section 38). Mean squares of few subjects may give a smaller value for absolute agreement,
so estimates and bounds of intervals are limited to it. At that limit, the mean of the k measurements is constant, and
its coefficient is −∞.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # scipy.stats, which takes half a second to import, is imported on first use

from mammometry.geometry.arrays import Array, Float64

_ROUNDING = 1e-12  # variance, relative to its largest value k, below which it is treated as 0


@dataclass(frozen=True, slots=True, kw_only=True)
class MeanSquares:
    """Analysis of variance of n subjects rated by k methods."""

    subjects: int
    methods: int
    between_subjects: float
    """MS_R, n − 1 degrees of freedom."""
    between_methods: float
    """MS_C, k − 1 degrees of freedom."""
    residual: float
    """MS_E, (n − 1)(k − 1) degrees of freedom."""
    within_subjects: float
    """MS_W, n(k − 1) degrees of freedom: methods and residual together."""


@dataclass(frozen=True, slots=True, kw_only=True)
class IntraclassCorrelation:
    """One form of the coefficient."""

    shrout_fleiss: str
    """Such as ``ICC(2,1)``."""
    mcgraw_wong: str
    """Such as ``ICC(A,1)``."""
    meaning: str
    """Model, error and measurement, as text."""
    value: float
    """NaN if nothing varies. −∞ for the mean of measurements if it does not vary."""
    interval: tuple[float, float]
    """Confidence interval. NaN if rows are not independent."""
    f: float
    """F statistic for the null hypothesis that the coefficient is 0."""
    df: tuple[float, float]
    p: float


def mean_squares(ratings: Float64[Array, "n k"]) -> MeanSquares:
    """Analysis of variance of ratings, one row per subject, one column per method.

    Raises:
        ValueError: fewer than two rows or columns, or a value that is not finite.
    """
    n, k = ratings.shape
    if n < 2 or k < 2 or not np.isfinite(ratings).all():
        raise ValueError(f"two or more finite ratings of two or more subjects are needed, found {n} × {k}")
    grand = ratings.mean()
    rows, columns = ratings.mean(axis=1), ratings.mean(axis=0)
    left = ratings - rows[:, None] - columns + grand
    return MeanSquares(
        subjects=n,
        methods=k,
        between_subjects=float(k * ((rows - grand) ** 2).sum() / (n - 1)),
        between_methods=float(n * ((columns - grand) ** 2).sum() / (k - 1)),
        residual=float((left**2).sum() / ((n - 1) * (k - 1))),
        within_subjects=float(((ratings - rows[:, None]) ** 2).sum() / (n * (k - 1))),
    )


def intraclass_correlations(
    ratings: Float64[Array, "n k"], *, confidence: float = 0.95
) -> tuple[IntraclassCorrelation, ...]:
    """The six forms of the intraclass correlation after Shrout and Fleiss, (1,1) … (3,k).

    Args:
        ratings: one row per subject, one column per method, without gaps.
        confidence: confidence level of the intervals.

    Raises:
        ValueError: see `mean_squares`.
    """
    ms = mean_squares(ratings)
    single = (_one_way(ms, confidence), _agreement(ms, confidence), _consistency(ms, confidence))
    return (*single, *(_of_the_mean(coefficient, ms.methods) for coefficient in single))


def _one_way(ms: MeanSquares, confidence: float) -> IntraclassCorrelation:
    n, k = ms.subjects, ms.methods
    return _by_ratio(
        ms.between_subjects,
        ms.within_subjects,
        (n - 1, n * (k - 1)),
        k,
        confidence,
        ("ICC(1,1)", "ICC(1)", "one-way random; every difference is error; one measurement"),
    )


def _consistency(ms: MeanSquares, confidence: float) -> IntraclassCorrelation:
    n, k = ms.subjects, ms.methods
    return _by_ratio(
        ms.between_subjects,
        ms.residual,
        (n - 1, (n - 1) * (k - 1)),
        k,
        confidence,
        ("ICC(3,1)", "ICC(C,1)", "two-way; consistency: a constant offset is no error; one measurement"),
    )


def _by_ratio(
    signal: float, noise: float, df: tuple[float, float], k: int, confidence: float, names: tuple[str, str, str]
) -> IntraclassCorrelation:
    """A form that depends only on the ratio of two mean squares."""
    f = _divided(signal, noise)
    upper = (1 + confidence) / 2
    low, high = f / scipy.stats.f.ppf(upper, *df), f * scipy.stats.f.ppf(upper, df[1], df[0])
    return IntraclassCorrelation(
        shrout_fleiss=names[0],
        mcgraw_wong=names[1],
        meaning=names[2],
        value=_from_ratio(f, k),
        interval=(_from_ratio(low, k), _from_ratio(high, k)),
        f=f,
        df=df,
        p=float(scipy.stats.f.sf(f, *df)),
    )


def _agreement(ms: MeanSquares, confidence: float) -> IntraclassCorrelation:
    """ICC(A,1), absolute agreement. Its interval uses Satterthwaite's degrees of freedom."""
    n, k = ms.subjects, ms.methods
    signal, methods, noise = ms.between_subjects, ms.between_methods, ms.residual
    value = _divided(signal - noise, signal + (k - 1) * noise + k * (methods - noise) / n)
    if value < 1:
        share = max(value, 0.0) / (1 - max(value, 0.0))  # weights of variances, which are not negative
        a, b = k * share / n * methods, (1 + k * share * (n - 1) / n) * noise
        parts = a**2 / (k - 1) + b**2 / ((n - 1) * (k - 1))
        df = (a + b) ** 2 / parts if parts else float((n - 1) * (k - 1))
        upper = (1 + confidence) / 2
        f_low, f_high = scipy.stats.f.ppf(upper, n - 1, df), scipy.stats.f.ppf(upper, df, n - 1)
        rest = k * methods + (k * n - k - n) * noise
        interval = (  # divided by quantiles, which may be infinite with few degrees of freedom
            float(n * (signal / f_low - noise) / (rest + n * signal / f_low)),
            float(n * (signal - noise / f_high) / (rest / f_high + n * signal)),
        )
    else:
        interval = (value, value)  # only the subjects vary, or nothing varies
    least = -1 / (k - 1)
    value, interval = max(value, least), (max(interval[0], least), max(interval[1], least))
    f, f_df = _divided(signal, noise), (n - 1, (n - 1) * (k - 1))
    return IntraclassCorrelation(
        shrout_fleiss="ICC(2,1)",
        mcgraw_wong="ICC(A,1)",
        meaning="two-way; absolute agreement: a constant offset is error; one measurement",
        value=value,
        interval=interval,
        f=f,
        df=f_df,
        p=float(scipy.stats.f.sf(f, *f_df)),
    )


def _of_the_mean(single: IntraclassCorrelation, k: int) -> IntraclassCorrelation:
    """The form for the mean of k measurements (Spearman–Brown), which increases with that for one."""

    def stepped(value: float) -> float:
        variance = 1 + (k - 1) * value  # variance of the mean, times k
        return -np.inf if variance <= _ROUNDING else float(k * value / variance)

    return IntraclassCorrelation(
        shrout_fleiss=single.shrout_fleiss.replace(",1)", ",k)"),
        mcgraw_wong="ICC(k)" if single.mcgraw_wong == "ICC(1)" else single.mcgraw_wong.replace(",1)", ",k)"),
        meaning=single.meaning.replace("one measurement", f"the mean of {k}"),
        value=stepped(single.value),
        interval=(stepped(single.interval[0]), stepped(single.interval[1])),
        f=single.f,
        df=single.df,
        p=single.p,
    )


def _from_ratio(f: float, k: int) -> float:
    return 1.0 if f == np.inf else float((f - 1) / (f + k - 1))


def _divided(a: float, b: float) -> float:
    if b == 0:
        return np.inf if a > 0 else np.nan
    return float(a / b)
