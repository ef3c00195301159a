"""A study of agreement as sentences, tables and JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from mammometry.study.agreement import Agreement, CheckedFigure, IntervalEstimate, PairedMeasurements
from mammometry.study.icc import IntraclassCorrelation
from mammometry.study.tables import TextTable, number, p_words, plain, probability

_P = "p"  # format of probabilities


def summary(data: PairedMeasurements, found: Agreement) -> list[str]:
    """The main results of a study of agreement, in sentences."""
    unit = f" {data.unit}" if data.unit else ""
    bias, slope = found.mean_difference, found.trend.slope
    differs = "differs" if found.p < 0.05 else "does not differ significantly"
    repeated = found.pairs > found.subjects
    count = f"{found.pairs} pairs of {found.subjects} subjects" if repeated else f"{found.subjects} subjects"
    lines = [
        f"{data.measured_name} minus {data.reference_name}, {count}: mean difference "
        f"{number(bias.value, '+.2f')}{unit} ({_interval(bias, '+.2f')}), standard deviation "
        f"{number(found.sd.value, '.2f')}{unit}. "
        f"The mean {differs} from zero (t = {number(found.t, '.4f')}, {p_words(found.p)}).",
        f"A single difference is expected between {number(found.lower_limit.value, '.1f')} and "
        f"{number(found.upper_limit.value, '.1f')}{unit} in 95 % of {'pairs' if repeated else 'subjects'}.",
    ]
    if repeated:
        lines.append(
            "Some subjects have several pairs, which are not independent. Limits and intervals are those for several "
            "observations of a subject (Bland and Altman 2007, Zou 2013); slopes are of the subjects' means; "
            "intraclass correlations have no interval."
        )
    if found.trend.p < 0.05:
        lines.append(
            f"The difference depends on the size: slope {number(slope.value, '+.4f')} ({_interval(slope, '+.4f')}), "
            f"{p_words(found.trend.p)}. One bias for all sizes is then not sufficient."
        )
    if found.normality_p < 0.05:
        lines.append(
            f"The differences do not look normally distributed (Shapiro–Wilk {p_words(found.normality_p)}): "
            "use the limits with caution."
        )
    return lines


def agreement_tables(
    data: PairedMeasurements, found: Agreement, checked: Sequence[CheckedFigure] = ()
) -> list[TextTable]:
    """Figures, intraclass correlations, published figures if any, and the data."""
    unit = f", {data.unit}" if data.unit else ""
    slope, on_reference = found.trend, found.trend_on_reference
    repeated = found.pairs > found.subjects
    rows: list[tuple[str, float, IntervalEstimate | None, str]] = [
        (f"mean difference{unit}", found.mean_difference.value, found.mean_difference, ".3f"),
        (f"standard deviation (SD) of the differences{unit}", found.sd.value, found.sd, ".3f"),
        (f"standard error of the mean (SEM){'' if repeated else ', SD / √n'}{unit}", found.sem, None, ".3f"),
        (f"paired t, {found.df} degrees of freedom", found.t, None, ".4f"),
        ("p, two-sided", found.p, None, _P),
        ("Student threshold, two-sided 95 %", found.student_95, None, ".3f"),
        ("Student threshold, two-sided 99 %", found.student_99, None, ".3f"),
        (f"lower limit of agreement{unit}", found.lower_limit.value, found.lower_limit, ".2f"),
        (f"upper limit of agreement{unit}", found.upper_limit.value, found.upper_limit, ".2f"),
        ("proportional bias: slope on the mean", slope.slope.value, slope.slope, ".4f"),
        ("p of that slope", slope.p, None, _P),
        ("slope on the reference", on_reference.slope.value, on_reference.slope, ".4f"),
        ("p of that slope", on_reference.p, None, _P),
        (
            f"standard error of measurement, SD / √2{unit}",
            found.sem_of_measurement.value,
            found.sem_of_measurement,
            ".2f",
        ),
        (f"minimal detectable change (MDC, SDC) 95 %, 1.96 SD{unit}", found.mdc.value, found.mdc, ".1f"),
        ("Shapiro–Wilk p of the differences", found.normality_p, None, _P),
    ]
    tables = [
        TextTable(
            title="Agreement",
            columns=("figure", "value", "95 % interval"),
            rows=tuple(
                (
                    name,
                    probability(value) if form == _P else number(value, form),
                    "" if estimate is None else _interval(estimate, form),
                )
                for name, value, estimate, form in rows
            ),
        ),
        TextTable(
            title="Intraclass correlation",
            columns=("Shrout–Fleiss", "McGraw–Wong", "value", "95 % interval", "F (df)", "p", "meaning"),
            rows=tuple(
                (
                    icc.shrout_fleiss,
                    icc.mcgraw_wong,
                    number(icc.value, ".5f"),
                    *(("–", "–") if math.isnan(icc.f) else (_span(icc.interval, ".4f"), _f_test(icc))),
                    probability(icc.p),
                    icc.meaning,
                )
                for icc in found.icc
            ),
        ),
    ]
    if checked:
        tables.append(
            TextTable(
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
        TextTable(
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
    """All results as data for JSON. Unknown values are null."""
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
                | ({"cluster": data.subjects[place]} if data.subjects else {})
                for place, (name, reference, measured) in enumerate(
                    zip(data.names, data.reference, data.measured, strict=True)
                )
            ],
        }
    )
    return table


def _interval(estimate: IntervalEstimate, form: str) -> str:
    return _span(estimate.interval, form)


def _span(interval: tuple[float, float], form: str) -> str:
    return f"{number(interval[0], form)} … {number(interval[1], form)}"


def _f_test(icc: IntraclassCorrelation) -> str:
    return f"{number(icc.f, '.1f')} ({icc.df[0]:g}, {icc.df[1]:g})"
