"""Agreement of a method of measurement with a reference method on the same subjects (paper 2.7).

Based on Bland and Altman, Lancet 327 (1986) 307 and Statistical Methods in Medical Research 8 (1999) 135, with exact
intervals of the limits by Carkeet, Optometry and Vision Science 92 (2015) e71. If a subject has several pairs, such as
both breasts of a woman, the form for multiple observations per individual is used (`study.repeated`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy  # scipy.stats, which takes half a second to import, is imported on first use

from mammometry.base.notices import Notice
from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Float64, Int64
from mammometry.study.icc import IntraclassCorrelation, intraclass_correlations
from mammometry.study.repeated import repeated_differences

LEAST_SUBJECTS = 3
"""Least number of subjects for regression and intervals."""
_Z95 = float(scipy.special.ndtri(0.975))
_ROUNDING = 1e-12  # spread, relative to the largest measurement, below which differences are equal


@value(eq=False)
class PairedMeasurements:
    """Two methods' measurements of the same subjects.

    Raises:
        ValueError: there are fewer than three subjects, lengths differ, or a value is not finite.
    """

    names: tuple[str, ...]
    """Names of the pairs."""
    reference: Float64[Array, " n"]
    """Results of the reference method."""
    measured: Float64[Array, " n"]
    """Results of the method under test."""
    reference_name: str
    measured_name: str
    unit: str
    """Unit of both. May be empty."""
    subjects: tuple[str, ...] = ()
    """Subject of each pair. Pairs of the same subject are not independent. Empty: all subjects are different."""
    notices: tuple[Notice, ...] = ()
    """Warnings about the table with the measurements."""

    def __post_init__(self) -> None:
        lengths = {len(self.names), len(self.reference), len(self.measured), len(self.subjects or self.names)}
        if len(lengths) > 1 or min(lengths) < LEAST_SUBJECTS:
            raise ValueError(f"{LEAST_SUBJECTS} or more pairs are needed, found lengths {sorted(lengths)}")
        if self.subjects and len(set(self.subjects)) < LEAST_SUBJECTS:
            raise ValueError(f"{LEAST_SUBJECTS} or more subjects are needed, found {len(set(self.subjects))}")
        if not (np.isfinite(self.reference).all() and np.isfinite(self.measured).all()):
            raise ValueError("measurements must be finite")

    @property
    def differences(self) -> Float64[Array, " n"]:
        """Measured minus reference."""
        return self.measured - self.reference

    @property
    def clusters(self) -> Int64[Array, " n"]:
        """Index of each pair's subject."""
        numbers = {name: place for place, name in enumerate(dict.fromkeys(self.subjects))}
        return np.array([numbers[name] for name in self.subjects] or range(len(self.names)), dtype=np.int64)

    @property
    def means(self) -> Float64[Array, " n"]:
        """Mean of both methods: the best estimate of the true value if neither is exact."""
        return (self.measured + self.reference) / 2


@dataclass(frozen=True, slots=True, kw_only=True)
class IntervalEstimate:
    """A figure with its 95 % confidence interval."""

    value: float
    interval: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Trend:
    """Straight line through the differences. NaN if all abscissae are equal."""

    slope: IntervalEstimate
    intercept: float
    p: float
    """p value for the null hypothesis that the slope is 0."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """Agreement of two methods. Differences are measured minus reference, in the table's unit."""

    subjects: int
    pairs: int
    """Number of pairs, at least that of the subjects."""
    mean_difference: IntervalEstimate
    """The bias, with Student's interval."""
    sd: IntervalEstimate
    """Standard deviation of the differences (n − 1), with its χ² interval. With several pairs per subject, that of a
    single pair, between and within subjects together."""
    sem: float
    """Standard error of the mean difference, SD / √n."""
    t: float
    """Paired Student's t. NaN if all differences are 0, infinite if they are all equal."""
    df: int
    p: float
    """Two-sided p value."""
    student_95: float
    """Two-sided 95 % quantile of Student's t."""
    student_99: float
    """Two-sided 99 % quantile of Student's t."""
    lower_limit: IntervalEstimate
    """Lower limit of agreement, bias − 1.96 SD, with the exact interval of that percentile."""
    upper_limit: IntervalEstimate
    """Upper limit of agreement."""
    trend: Trend
    """Regression of the differences on the means of both methods (proportional bias)."""
    trend_on_reference: Trend
    """Regression of the differences on the reference. It is correct if the reference is exact."""
    sem_of_measurement: IntervalEstimate
    """Standard error of measurement, SD / √2: the error of one measurement if both methods are equally exact."""
    mdc: IntervalEstimate
    """Minimal (smallest) detectable change at 95 %: 1.96 √2 times the standard error of measurement, which is 1.96
    SD."""
    mdc_of_mean: float
    """1.96 √2 times the standard error of the *mean*. The paper gives it, but it is not a detectable change."""
    icc: tuple[IntraclassCorrelation, ...]
    """All forms. With several pairs per subject, they have no intervals and tests, which need independent rows."""
    normality_p: float
    """Shapiro and Wilk's p value for the differences, or for their means by subject: the limits assume a normal
    distribution. NaN if all are equal."""

    def figures(self) -> dict[str, float]:
        """Figures by name, for comparison with published ones."""
        named = {
            "subjects": float(self.subjects),
            "pairs": float(self.pairs),
            "mean_difference": self.mean_difference.value,
            "sd": self.sd.value,
            "sem": self.sem,
            "t": self.t,
            "p": self.p,
            "student_95": self.student_95,
            "student_99": self.student_99,
            "lower_limit": self.lower_limit.value,
            "upper_limit": self.upper_limit.value,
            "slope": self.trend.slope.value,
            "slope_on_reference": self.trend_on_reference.slope.value,
            "sem_of_measurement": self.sem_of_measurement.value,
            "mdc": self.mdc.value,
            "mdc_of_mean": self.mdc_of_mean,
        }
        return named | {_key(icc.shrout_fleiss): icc.value for icc in self.icc}


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedFigure:
    """One figure of a publication."""

    what: str
    """Name in the publication."""
    figure: str
    """Name in `Agreement.figures`."""
    published: str
    """Value as printed, with all its digits."""
    note: str = ""
    """Remark for the reader."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckedFigure:
    """A published figure and the recomputed one."""

    published: PublishedFigure
    recomputed: float
    follows: bool
    """Whether the recomputed figure rounds to the published one."""


def agreement(data: PairedMeasurements) -> Agreement:
    """Compute the agreement of two methods."""
    clusters = data.clusters
    pairs, subjects = len(clusters), int(clusters.max()) + 1
    if pairs > subjects:
        return _repeated(data, clusters)
    return _once(data)


def _once(data: PairedMeasurements) -> Agreement:
    """Agreement if each subject has one pair."""
    difference = data.differences
    n = len(difference)
    mean, sd = float(difference.mean()), float(difference.std(ddof=1))
    if sd <= _ROUNDING * float(np.abs(data.means).max()):
        sd = 0.0
    sem = sd / math.sqrt(n)
    df = n - 1
    chi_low, chi_high = (float(math.sqrt(df / scipy.stats.chi2.ppf(q, df))) for q in (0.975, 0.025))
    # The 97.5th percentile of a normal distribution is mean + s t′/√n, with t′ of the noncentral t distribution.
    near, far = (float(scipy.stats.nct.ppf(q, df, _Z95 * math.sqrt(n))) * sem for q in (0.025, 0.975))
    return _assembled(
        data,
        (data.means, data.reference, difference),
        mean=mean,
        sem=sem,
        spread=IntervalEstimate(value=sd, interval=(sd * chi_low, sd * chi_high)),
        limits=(mean - far, mean - near, mean + near, mean + far),
        icc=intraclass_correlations(np.stack([data.reference, data.measured], axis=1)),
    )


def _repeated(data: PairedMeasurements, clusters: Int64[Array, " n"]) -> Agreement:
    """Agreement if subjects have several pairs.

    Trends and Shapiro and Wilk's test are computed from the subjects' means, which are independent.
    """
    found = repeated_differences(data.differences, clusters)
    counts = np.bincount(clusters)
    by_subject = tuple(
        np.bincount(clusters, column) / counts for column in (data.means, data.reference, data.differences)
    )
    low, high = found.sd_interval
    mean, reach, sd = found.mean, found.df_quantile * found.sem, found.sd
    outward, inward = (math.hypot(reach, _Z95 * (bound - sd)) for bound in (high, low))
    rows = intraclass_correlations(np.stack([data.reference, data.measured], axis=1))
    nothing = (math.nan, math.nan)
    return _assembled(
        data,
        by_subject,
        mean=mean,
        sem=found.sem,
        spread=IntervalEstimate(value=sd, interval=(low, high)),
        limits=(
            mean - _Z95 * sd - outward,
            mean - _Z95 * sd + inward,
            mean + _Z95 * sd - inward,
            mean + _Z95 * sd + outward,
        ),
        icc=tuple(replace(form, interval=nothing, f=math.nan, df=nothing, p=math.nan) for form in rows),
    )


def _assembled(
    data: PairedMeasurements,
    independent: tuple[Float64[Array, " m"], ...],
    *,
    mean: float,
    sem: float,
    spread: IntervalEstimate,
    limits: tuple[float, float, float, float],
    icc: tuple[IntraclassCorrelation, ...],
) -> Agreement:
    """Compute all statistics from mean, standard error and spread.

    Args:
        data: all pairs.
        independent: mean of both methods, reference and difference, with one value of each per subject.
        mean: the bias.
        sem: its standard error.
        spread: standard deviation of one difference.
        limits: intervals of the lower and of the upper limit of agreement.
        icc: all forms of the intraclass correlation.
    """
    means, reference, difference = independent
    df = len(difference) - 1
    t = mean / sem if sem else (math.copysign(math.inf, mean) if mean else math.nan)
    student = float(scipy.stats.t.ppf(0.975, df))
    sd = spread.value
    varies = float(np.ptp(difference)) > _ROUNDING * float(np.abs(means).max())
    return Agreement(
        subjects=len(difference),
        pairs=len(data.names),
        mean_difference=IntervalEstimate(value=mean, interval=(mean - student * sem, mean + student * sem)),
        sd=spread,
        sem=sem,
        t=t,
        df=df,
        p=float(2 * scipy.stats.t.sf(abs(t), df)),
        student_95=student,
        student_99=float(scipy.stats.t.ppf(0.995, df)),
        lower_limit=IntervalEstimate(value=mean - _Z95 * sd, interval=limits[:2]),
        upper_limit=IntervalEstimate(value=mean + _Z95 * sd, interval=limits[2:]),
        trend=_trend(means, difference),
        trend_on_reference=_trend(reference, difference),
        sem_of_measurement=_scaled(spread, 1 / math.sqrt(2)),
        mdc=_scaled(spread, _Z95),
        mdc_of_mean=_Z95 * math.sqrt(2) * sem,
        icc=icc,
        normality_p=float(scipy.stats.shapiro(difference).pvalue) if varies else math.nan,
    )


def check_published(found: Agreement, published: Sequence[PublishedFigure]) -> tuple[CheckedFigure, ...]:
    """Compare published figures with recomputed ones.

    Raises:
        ValueError: a name is not in `Agreement.figures`, or a published value is not a number.
    """
    figures = found.figures()
    checked = []
    for study in published:
        if study.figure not in figures:
            raise ValueError(f"no figure is called {study.figure!r}; there are {', '.join(figures)}")
        digits = len(study.published.partition(".")[2])
        recomputed = figures[study.figure]
        follows = abs(recomputed - float(study.published)) <= 0.5 * 10.0**-digits * (1 + 1e-9)
        checked.append(CheckedFigure(published=study, recomputed=recomputed, follows=follows))
    return tuple(checked)


def _trend(abscissae: Float64[Array, " n"], differences: Float64[Array, " n"]) -> Trend:
    """Least-squares line, with Student's interval for the slope."""
    centred = abscissae - abscissae.mean()
    total = float(centred @ centred)
    if total <= (1e-9 * float(np.abs(abscissae).max())) ** 2:
        nothing = IntervalEstimate(value=math.nan, interval=(math.nan, math.nan))
        return Trend(slope=nothing, intercept=math.nan, p=math.nan)
    slope = float(centred @ differences) / total
    intercept = float(differences.mean() - slope * abscissae.mean())
    df = len(differences) - 2
    left = differences - intercept - slope * abscissae
    error = math.sqrt(float(left @ left) / df / total)
    reach = float(scipy.stats.t.ppf(0.975, df)) * error
    p = float(2 * scipy.stats.t.sf(abs(slope) / error, df)) if error else math.nan
    return Trend(slope=IntervalEstimate(value=slope, interval=(slope - reach, slope + reach)), intercept=intercept, p=p)


def _scaled(estimate: IntervalEstimate, factor: float) -> IntervalEstimate:
    low, high = estimate.interval
    return IntervalEstimate(value=factor * estimate.value, interval=(factor * low, factor * high))


def _key(form: str) -> str:
    """``ICC(2,1)`` → ``icc_2_1``."""
    return form.lower().replace("(", "_").replace(",", "_").rstrip(")")
