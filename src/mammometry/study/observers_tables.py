"""An observer study's figures laid out for people, and as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from mammometry.study.icc import IntraclassCorrelation
from mammometry.study.observers import Apart, Drawing, ObserverStudy, Scatter
from mammometry.study.tables import Table, number, plain

_KINDS = (("within", "one person again"), ("between", "whoever draws"))


def observers_summary(found: ObserverStudy) -> list[str]:
    """What a reader wants to know first, in sentences."""
    breasts, persons = (_counted(len(each), word) for each, word in
                        ((found.breasts, "breast"), (found.observers, "person")))  # fmt: skip
    said = [f"{found.drawings} curves around {breasts} by {persons}; mean volume {number(found.mean_cc, '.0f')} cc."]
    for each, who in ((found.within, "One person who draws again"), (found.between, "Whoever draws")):
        if each is not None:
            said.append(
                f"{who}: one volume scatters by {number(each.sem.value, '.1f')} cc ({number(each.percent, '.1f')} %). "
                f"A change of less than {number(each.mdc.value, '.0f')} cc may be drawing alone."
            )
    worst = max(
        (
            (region, each)
            for region, each in (found.apart_between or found.apart_within).items()
            if region != "whole curve"
        ),
        key=lambda pair: pair[1].mean_mm,
    )
    said.append(
        f"The curves lie furthest apart at the {worst[0]} border: {number(worst[1].mean_mm, '.1f')} mm on average."
    )
    if found.icc_between is None and found.between is not None:
        said.append(
            "There is no intraclass correlation between persons: it compares breasts, and takes two that the same two "
            "persons drew."
        )
    if found.between is not None and found.between.df < 5:
        said.append("So few drawings tell little: see the intervals.")
    return said


def observers_tables(found: ObserverStudy, drawings: Sequence[Drawing]) -> list[Table]:
    """Volumes, intraclass correlations, distances by region, and all drawings."""
    scatters = {"within": found.within, "between": found.between}
    tables = [
        Table(
            title="Volume",
            columns=("who draws", "standard error of measurement (SEM), cc", "95 % interval", "%",
                     "minimal detectable change (MDC) 95 %, cc", "95 % interval", "degrees of freedom"),
            rows=tuple(_scatter_row(words, each) for key, words in _KINDS if (each := scatters[key]) is not None),
        )
    ]  # fmt: skip
    correlations = [("between persons", found.icc_between)] if found.icc_between is not None else []
    correlations += [(f"repeats by {name}", each) for name, each in found.icc_within.items()]
    if correlations:
        tables.append(
            Table(
                title="Intraclass correlation of volumes",
                columns=("of", "form", "value", "95 % interval"),
                rows=tuple(_icc_row(words, each) for words, each in correlations),
            )
        )
    for title, apart in (
        ("Two curves of one person", found.apart_within),
        ("Curves of two persons", found.apart_between),
    ):
        if apart:
            tables.append(_apart_table(title, apart))
    tables.append(
        Table(
            title="Drawings",
            columns=("breast", "person", "drawing", "volume cc", "base cm²"),
            rows=tuple(
                (each.breast, each.observer, each.repeat, number(each.volume_cc, ".1f"), number(each.base_cm2, ".1f"))
                for each in drawings
            ),
        )
    )
    return tables


def observers_json(found: ObserverStudy, drawings: Sequence[Drawing]) -> dict[str, Any]:
    """Everything as plain JSON-ready data. What is not known is null."""

    def scatter(each: Scatter | None) -> dict[str, Any] | None:
        return None if each is None else {**asdict(each), "mdc": asdict(each.mdc)}

    table: dict[str, Any] = plain(
        {
            "breasts": found.breasts,
            "observers": found.observers,
            "mean_cc": found.mean_cc,
            "within": scatter(found.within),
            "between": scatter(found.between),
            "icc_between": None if found.icc_between is None else asdict(found.icc_between),
            "icc_within": {name: asdict(each) for name, each in found.icc_within.items()},
            "apart_within_mm": {region: asdict(each) for region, each in found.apart_within.items()},
            "apart_between_mm": {region: asdict(each) for region, each in found.apart_between.items()},
            "drawings": [
                {
                    "breast": each.breast,
                    "observer": each.observer,
                    "repeat": each.repeat,
                    "volume_cc": each.volume_cc,
                    "base_cm2": each.base_cm2,
                }
                for each in drawings
            ],
        }
    )
    return table


def _scatter_row(words: str, each: Scatter) -> tuple[str, ...]:
    spans = [f"{number(one.interval[0], '.1f')} … {number(one.interval[1], '.1f')}" for one in (each.sem, each.mdc)]
    return (words, number(each.sem.value, ".2f"), spans[0], number(each.percent, ".2f"), number(each.mdc.value, ".1f"),
            spans[1], number(each.df, ".1f"))  # fmt: skip


def _icc_row(words: str, each: IntraclassCorrelation) -> tuple[str, ...]:
    span = f"{number(each.interval[0], '.4f')} … {number(each.interval[1], '.4f')}"
    return (words, each.shrout_fleiss, number(each.value, ".5f"), span)


def _apart_table(title: str, apart: Mapping[str, Apart]) -> Table:
    return Table(
        title=f"{title}: distance, mm",
        columns=("region", "mean", "95 % are less", "standard uncertainty of one curve", "pairs of curves"),
        rows=tuple(
            (region, number(each.mean_mm, ".2f"), number(each.q95_mm, ".1f"), number(each.across_mm, ".2f"),
             str(each.pairs))
            for region, each in apart.items()
        ),
    )  # fmt: skip


def _counted(count: int, word: str) -> str:
    return f"{count} {word}{'' if count == 1 else 's'}"
