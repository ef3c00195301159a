"""Scatter between observers as sentences, tables and JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from mammometry.study.icc import IntraclassCorrelation
from mammometry.study.observers import WHOLE, Apart, ObservedCurve, ObserverStudy, Scatter
from mammometry.study.tables import TextTable, number, plain

_KINDS = (("within", "same person"), ("between", "any person"))


def observers_summary(found: ObserverStudy) -> list[str]:
    """The main results of a study of observers, in sentences."""
    breasts, persons = (_counted(len(count), word) for count, word in
                        ((found.breasts, "breast"), (found.observers, "person")))  # fmt: skip
    lines = [f"{found.drawings} curves around {breasts} by {persons}; mean volume {number(found.mean_cc, '.0f')} cc."]
    for scatter, who in ((found.within, "Same person"), (found.between, "Any person")):
        if scatter is not None:
            lines.append(
                f"{who}: standard error of measurement {number(scatter.sem.value, '.1f')} cc "
                f"({number(scatter.percent, '.1f')} %). "
                f"A change of less than {number(scatter.mdc.value, '.0f')} cc may be due to the drawing."
            )
    worst = max(
        (
            (region, distances)
            for region, distances in (found.apart_between or found.apart_within).items()
            if region != WHOLE
        ),
        key=lambda pair: pair[1].mean_mm,
    )
    lines.append(
        f"The curves lie furthest apart at the {worst[0]} border: {number(worst[1].mean_mm, '.1f')} mm on average."
    )
    if found.icc_between is None and found.between is not None:
        lines.append(
            "There is no intraclass correlation between persons: it needs two breasts that the same two persons drew."
        )
    if found.between is not None and found.between.df < 5:
        lines.append("With so few drawings the results are uncertain: see the intervals.")
    return lines


def observers_tables(found: ObserverStudy, drawings: Sequence[ObservedCurve]) -> list[TextTable]:
    """Volumes, intraclass correlations, distances by region, and all drawings."""
    scatters = {"within": found.within, "between": found.between}
    tables = [
        TextTable(
            title="Volume",
            columns=("who draws", "standard error of measurement (SEM), cc", "95 % interval", "%",
                     "minimal detectable change (MDC) 95 %, cc", "95 % interval", "degrees of freedom"),
            rows=tuple(_scatter_row(words, scatter) for key, words in _KINDS if (scatter := scatters[key]) is not None),
        )
    ]  # fmt: skip
    correlations = [("between persons", found.icc_between)] if found.icc_between is not None else []
    correlations += [(f"repeats by {name}", correlation) for name, correlation in found.icc_within.items()]
    if correlations:
        tables.append(
            TextTable(
                title="Intraclass correlation of volumes",
                columns=("of", "form", "value", "95 % interval"),
                rows=tuple(_icc_row(words, correlation) for words, correlation in correlations),
            )
        )
    for title, apart in (
        ("Two curves of one person", found.apart_within),
        ("Curves of two persons", found.apart_between),
    ):
        if apart:
            tables.append(_apart_table(title, apart))
    tables.append(
        TextTable(
            title="Drawings",
            columns=("breast", "person", "drawing", "volume cc", "base cm²"),
            rows=tuple(
                (
                    drawing.breast,
                    drawing.observer,
                    drawing.repeat,
                    number(drawing.volume_cc, ".1f"),
                    number(drawing.base_cm2, ".1f"),
                )
                for drawing in drawings
            ),
        )
    )
    return tables


def observers_json(found: ObserverStudy, drawings: Sequence[ObservedCurve]) -> dict[str, Any]:
    """All results as data for JSON, with null for unknown ones."""

    def scatter(spread: Scatter | None) -> dict[str, Any] | None:
        return None if spread is None else {**asdict(spread), "mdc": asdict(spread.mdc)}

    table: dict[str, Any] = plain(
        {
            "breasts": found.breasts,
            "observers": found.observers,
            "mean_cc": found.mean_cc,
            "within": scatter(found.within),
            "between": scatter(found.between),
            "icc_between": None if found.icc_between is None else asdict(found.icc_between),
            "icc_within": {name: asdict(correlation) for name, correlation in found.icc_within.items()},
            "apart_within_mm": {region: asdict(distances) for region, distances in found.apart_within.items()},
            "apart_between_mm": {region: asdict(distances) for region, distances in found.apart_between.items()},
            "drawings": [
                {
                    "breast": drawing.breast,
                    "observer": drawing.observer,
                    "repeat": drawing.repeat,
                    "volume_cc": drawing.volume_cc,
                    "base_cm2": drawing.base_cm2,
                }
                for drawing in drawings
            ],
        }
    )
    return table


def _scatter_row(words: str, scatter: Scatter) -> tuple[str, ...]:
    spans = [
        f"{number(estimate.interval[0], '.1f')} … {number(estimate.interval[1], '.1f')}"
        for estimate in (scatter.sem, scatter.mdc)
    ]
    return (words, number(scatter.sem.value, ".2f"), spans[0], number(scatter.percent, ".2f"),
            number(scatter.mdc.value, ".1f"), spans[1], number(scatter.df, ".1f"))  # fmt: skip


def _icc_row(words: str, correlation: IntraclassCorrelation) -> tuple[str, ...]:
    span = f"{number(correlation.interval[0], '.4f')} … {number(correlation.interval[1], '.4f')}"
    return (words, correlation.shrout_fleiss, number(correlation.value, ".5f"), span)


def _apart_table(title: str, apart: Mapping[str, Apart]) -> TextTable:
    return TextTable(
        title=f"{title}: distance, mm",
        columns=("region", "mean", "95th percentile", "standard uncertainty of one curve", "pairs of curves"),
        rows=tuple(
            (region, number(distances.mean_mm, ".2f"), number(distances.q95_mm, ".1f"),
             number(distances.across_mm, ".2f"), str(distances.pairs))
            for region, distances in apart.items()
        ),
    )  # fmt: skip


def _counted(count: int, word: str) -> str:
    return f"{count} {word}{'' if count == 1 else 's'}"
