"""Agreement of a method of measurement with a reference (paper 2.7).

Both are applied once to the same subjects. Bland and Altman, Lancet 327 (1986) 307 and Statistical Methods in Medical
Research 8 (1999) 135; exact intervals of the limits after Carkeet, Optometry and Vision Science 92 (2015) e71.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import scipy  # it imports scipy.stats, which takes half a second, when that is used

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Float64
from mammometry.study.icc import IntraclassCorrelation, intraclass_correlations
from mammometry.study.tables import Table, number, plain

LEAST_SUBJECTS = 3
"""With fewer there is no regression and no interval worth the name."""
_Z95 = float(scipy.special.ndtri(0.975))


@value(eq=False)
class PairedMeasurements:
    """Two methods' measurements of the same subjects.

    Raises:
        ValueError: fewer than three subjects, different lengths, or a value that is not finite.
    """

    names: tuple[str, ...]
    """Of the subjects."""
    reference: Float64[Array, " n"]
    """By the method compared with."""
    measured: Float64[Array, " n"]
    """By the method under test."""
    reference_name: str
    measured_name: str
    unit: str
    """Unit of both. It may be empty."""

    def __post_init__(self) -> None:
        lengths = {len(self.names), len(self.reference), len(self.measured)}
        if len(lengths) > 1 or min(lengths) < LEAST_SUBJECTS:
            raise ValueError(f"{LEAST_SUBJECTS} or more pairs are needed, found lengths {sorted(lengths)}")
        if not (np.isfinite(self.reference).all() and np.isfinite(self.measured).all()):
            raise ValueError("measurements must be finite")

    @property
    def differences(self) -> Float64[Array, " n"]:
        """Measured less reference."""
        return self.measured - self.reference

    @property
    def means(self) -> Float64[Array, " n"]:
        """Mean of both methods. It is the best guess of the true value if neither is exact."""
        return (self.measured + self.reference) / 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A figure with its 95 % confidence interval."""

    value: float
    interval: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Trend:
    """A straight line through the differences. NaN if the abscissae are all equal."""

    slope: Estimate
    intercept: float
    p: float
    """Of the null hypothesis that there is no slope."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """Agreement of two methods. Differences are measured less reference, in the table's unit."""

    subjects: int
    mean_difference: Estimate
    """The bias, with Student's interval."""
    sd: Estimate
    """Standard deviation of the differences (n − 1), with its χ² interval."""
    sem: float
    """Standard error of the mean difference, SD / √n: how well the bias is known, not a subject."""
    t: float
    """Paired Student's t. NaN if all differences are 0, infinite if they are all equal."""
    df: int
    p: float
    """Two-sided."""
    student_95: float
    """Two-sided 95 % threshold of Student's t."""
    student_99: float
    """Two-sided 99 % threshold."""
    lower_limit: Estimate
    """Lower limit of agreement, bias − 1.96 SD, with the exact interval of that percentile."""
    upper_limit: Estimate
    """Upper limit of agreement."""
    trend: Trend
    """Regression of the differences on the means of both methods: proportional bias."""
    trend_on_reference: Trend
    """Regression on the reference: the right one where the reference is exact."""
    sem_of_measurement: Estimate
    """Standard error of measurement, SD / √2: the error of one measurement if both methods were equally exact."""
    mdc: Estimate
    """Minimal (smallest) detectable change at 95 %: 1.96 √2 times the standard error of measurement, so 1.96 SD."""
    mdc_of_mean: float
    """1.96 √2 times the standard error of the *mean*: not a detectable change, but what the paper's text leads to."""
    icc: tuple[IntraclassCorrelation, ...]
    """All forms."""
    normality_p: float
    """Shapiro and Wilk's p of the differences, on whose normality the limits rest. NaN if all are equal."""

    def figures(self) -> dict[str, float]:
        """Every figure by name, for comparison with published ones."""
        named = {
            "subjects": float(self.subjects),
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
    """One figure as a publication states it."""

    what: str
    """In the publication's words."""
    figure: str
    """Its name in `Agreement.figures`."""
    published: str
    """As printed. The digits show how exactly."""
    note: str = ""
    """A remark for the reader."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckedFigure:
    """A published figure beside the recomputed one."""

    published: PublishedFigure
    recomputed: float
    follows: bool
    """Whether the recomputed one rounds to the published one."""


def agreement(data: PairedMeasurements) -> Agreement:
    """Work out everything about the agreement of two methods."""
    difference = data.differences
    n = len(difference)
    mean, sd = float(difference.mean()), float(difference.std(ddof=1))
    if sd <= 1e-12 * float(np.abs(data.means).max()):
        sd = 0.0  # rounding of equal differences
    sem = sd / math.sqrt(n)
    df = n - 1
    t = mean / sem if sem else (math.copysign(math.inf, mean) if mean else math.nan)
    student = float(scipy.stats.t.ppf(0.975, df))
    chi_low, chi_high = (float(math.sqrt(df / scipy.stats.chi2.ppf(q, df))) for q in (0.975, 0.025))
    spread = Estimate(value=sd, interval=(sd * chi_low, sd * chi_high))
    # The 97.5th percentile of a normal distribution lies at mean + s t′/√n, t′ of the noncentral t distribution.
    near, far = (float(scipy.stats.nct.ppf(q, df, _Z95 * math.sqrt(n))) * sem for q in (0.025, 0.975))
    return Agreement(
        subjects=n,
        mean_difference=Estimate(value=mean, interval=(mean - student * sem, mean + student * sem)),
        sd=spread,
        sem=sem,
        t=t,
        df=df,
        p=float(2 * scipy.stats.t.sf(abs(t), df)),
        student_95=student,
        student_99=float(scipy.stats.t.ppf(0.995, df)),
        lower_limit=Estimate(value=mean - _Z95 * sd, interval=(mean - far, mean - near)),
        upper_limit=Estimate(value=mean + _Z95 * sd, interval=(mean + near, mean + far)),
        trend=_trend(data.means, difference),
        trend_on_reference=_trend(data.reference, difference),
        sem_of_measurement=_scaled(spread, 1 / math.sqrt(2)),
        mdc=_scaled(spread, _Z95),
        mdc_of_mean=_Z95 * math.sqrt(2) * sem,
        icc=intraclass_correlations(np.stack([data.reference, data.measured], axis=1)),
        normality_p=float(scipy.stats.shapiro(difference).pvalue) if sd else math.nan,
    )


def check_published(found: Agreement, published: Sequence[PublishedFigure]) -> tuple[CheckedFigure, ...]:
    """Put published figures beside the recomputed ones.

    Raises:
        ValueError: a name that is none of `Agreement.figures`, or a published value that is no number.
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
    """Ordinary least squares with Student's interval of the slope."""
    centred = abscissae - abscissae.mean()
    total = float(centred @ centred)
    if total <= (1e-9 * float(np.abs(abscissae).max())) ** 2:
        nothing = Estimate(value=math.nan, interval=(math.nan, math.nan))
        return Trend(slope=nothing, intercept=math.nan, p=math.nan)
    slope = float(centred @ differences) / total
    intercept = float(differences.mean() - slope * abscissae.mean())
    df = len(differences) - 2
    left = differences - intercept - slope * abscissae
    error = math.sqrt(float(left @ left) / df / total)
    reach = float(scipy.stats.t.ppf(0.975, df)) * error
    p = float(2 * scipy.stats.t.sf(abs(slope) / error, df)) if error else math.nan
    return Trend(slope=Estimate(value=slope, interval=(slope - reach, slope + reach)), intercept=intercept, p=p)


def _scaled(estimate: Estimate, factor: float) -> Estimate:
    low, high = estimate.interval
    return Estimate(value=factor * estimate.value, interval=(factor * low, factor * high))


def _key(form: str) -> str:
    """``ICC(2,1)`` → ``icc_2_1``."""
    return form.lower().replace("(", "_").replace(",", "_").rstrip(")")


def summary(data: PairedMeasurements, found: Agreement) -> list[str]:
    """The main results of a study of agreement, in sentences."""
    unit = f" {data.unit}" if data.unit else ""
    bias, slope = found.mean_difference, found.trend.slope
    differs = "differs" if found.p < 0.05 else "does not differ significantly"
    lines = [
        f"{data.measured_name} less {data.reference_name}, {found.subjects} subjects: mean difference "
        f"{number(bias.value, '+.2f')}{unit} ({_interval(bias, '+.2f')}), standard deviation "
        f"{number(found.sd.value, '.2f')}{unit}. "
        f"The mean {differs} from zero (t = {number(found.t, '.4f')}, p = {number(found.p, '.4f')}).",
        f"A single difference is expected between {number(found.lower_limit.value, '.1f')} and "
        f"{number(found.upper_limit.value, '.1f')}{unit} in 95 % of subjects.",
    ]
    if found.trend.p < 0.05:
        lines.append(
            f"The difference depends on the size: slope {number(slope.value, '+.4f')} ({_interval(slope, '+.4f')}), "
            f"p = {number(found.trend.p, '.4f')}. One bias for all sizes is then not the whole story."
        )
    if found.normality_p < 0.05:
        lines.append(
            f"The differences do not look normally distributed (Shapiro–Wilk p = {number(found.normality_p, '.4f')}): "
            "take the limits with caution."
        )
    return lines


def agreement_tables(data: PairedMeasurements, found: Agreement, checked: Sequence[CheckedFigure] = ()) -> list[Table]:
    """Figures, intraclass correlations, published figures where there are any, and the data."""
    unit = f", {data.unit}" if data.unit else ""
    slope, on_reference = found.trend, found.trend_on_reference
    rows: list[tuple[str, float, Estimate | None, str]] = [
        (f"mean difference{unit}", found.mean_difference.value, found.mean_difference, ".3f"),
        (f"standard deviation (SD) of the differences{unit}", found.sd.value, found.sd, ".3f"),
        (f"standard error of the mean (SEM), SD / √n{unit}", found.sem, None, ".3f"),
        (f"paired t, {found.df} degrees of freedom", found.t, None, ".4f"),
        ("p, two-sided", found.p, None, ".4f"),
        ("Student threshold, two-sided 95 %", found.student_95, None, ".3f"),
        ("Student threshold, two-sided 99 %", found.student_99, None, ".3f"),
        (f"lower limit of agreement{unit}", found.lower_limit.value, found.lower_limit, ".2f"),
        (f"upper limit of agreement{unit}", found.upper_limit.value, found.upper_limit, ".2f"),
        ("proportional bias: slope on the mean", slope.slope.value, slope.slope, ".4f"),
        ("p of that slope", slope.p, None, ".4f"),
        ("slope on the reference", on_reference.slope.value, on_reference.slope, ".4f"),
        ("p of that slope", on_reference.p, None, ".4f"),
        (
            f"standard error of measurement, SD / √2{unit}",
            found.sem_of_measurement.value,
            found.sem_of_measurement,
            ".2f",
        ),
        (f"minimal detectable change (MDC, SDC) 95 %, 1.96 SD{unit}", found.mdc.value, found.mdc, ".1f"),
        ("Shapiro–Wilk p of the differences", found.normality_p, None, ".3f"),
    ]
    tables = [
        Table(
            title="Agreement",
            columns=("figure", "value", "95 % interval"),
            rows=tuple(
                (name, number(value, form), "" if estimate is None else _interval(estimate, form))
                for name, value, estimate, form in rows
            ),
        ),
        Table(
            title="Intraclass correlation",
            columns=("Shrout–Fleiss", "McGraw–Wong", "value", "95 % interval", "F (df)", "p", "meaning"),
            rows=tuple(
                (
                    icc.shrout_fleiss,
                    icc.mcgraw_wong,
                    number(icc.value, ".5f"),
                    f"{number(icc.interval[0], '.4f')} … {number(icc.interval[1], '.4f')}",
                    f"{number(icc.f, '.1f')} ({icc.df[0]:g}, {icc.df[1]:g})",
                    number(icc.p, ".2g"),
                    icc.meaning,
                )
                for icc in found.icc
            ),
        ),
    ]
    if checked:
        tables.append(
            Table(
                title="Published figures",
                columns=("figure", "published", "recomputed", "follows", "remark"),
                rows=tuple(
                    (
                        check.published.what,
                        check.published.published,
                        number(check.recomputed, f".{max(2, len(check.published.published.partition('.')[2]))}f"),
                        "yes" if check.follows else "no",
                        check.published.note,
                    )
                    for check in checked
                ),
            )
        )
    tables.append(
        Table(
            title="Measurements",
            columns=(
                "subject",
                f"{data.reference_name}{unit}",
                f"{data.measured_name}{unit}",
                f"difference{unit}",
                "%",
            ),
            rows=tuple(
                (
                    name,
                    number(reference, ".2f"),
                    number(measured, ".2f"),
                    number(measured - reference, "+.2f"),
                    number(100 * (measured / reference - 1), "+.2f") if reference else "–",
                )
                for name, reference, measured in zip(data.names, data.reference, data.measured, strict=True)
            ),
        )
    )
    return tables


def agreement_json(data: PairedMeasurements, found: Agreement, checked: Sequence[CheckedFigure] = ()) -> dict[str, Any]:
    """All results as plain JSON-ready data. Unknown values are null."""
    table: dict[str, Any] = plain(
        {
            "reference": data.reference_name,
            "measured": data.measured_name,
            "unit": data.unit,
            **asdict(found),
            "published": [
                {**asdict(check.published), "recomputed": check.recomputed, "follows": check.follows}
                for check in checked
            ],
            "measurements": [
                {"subject": name, "reference": float(reference), "measured": float(measured)}
                for name, reference, measured in zip(data.names, data.reference, data.measured, strict=True)
            ],
        }
    )
    return table


def _interval(estimate: Estimate, form: str) -> str:
    return f"{number(estimate.interval[0], form)} … {number(estimate.interval[1], form)}"
