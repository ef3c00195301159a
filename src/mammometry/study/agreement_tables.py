"""An agreement study's figures laid out for people, and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from mammometry.study.agreement import Agreement, CheckedFigure, Estimate, PairedMeasurements
from mammometry.study.tables import Table, number, plain


def summary(data: PairedMeasurements, found: Agreement) -> list[str]:
    """What a reader wants to know first, in sentences."""
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
