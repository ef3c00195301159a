"""A validation in sentences, tables and JSON."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from mammometry.study.agreement import IntervalEstimate
from mammometry.study.agreement_tables import agreement_json
from mammometry.study.tables import TextTable, number, plain
from mammometry.study.validation.study import DefinitionAgreement, ValidationStudy

_TRUTHS = {
    "water": "the specimen, by displaced water",
    "weight": "the specimen, by its weight and an assumed density",
    "segmentation": "a segmentation",
    "volume": "the volumes in the table",
}
_REMARKS = {
    "water": "Truth: displaced water at its temperature, plus the skin that the operation left on the woman: its area "
    "by its thickness, 1.45 ± 0.30 mm where the table gives none (Huang 2008). Uncertainty of the displacement: 1 %, "
    "at least 3 cc, where the table gives none. A specimen without its fat at the edges is smaller than the breast.",
    "weight": "Truth: weight by density, plus the skin that the operation left. Density from the composition (fat "
    "0.93, gland 1.04 g/cc; ± 0.02), else from the age (0.96 ± 0.04 from 50 years on, 1.01 ± 0.08 below; Yi 2019), "
    "else 0.97 ± 0.04 g/cc.",
    "segmentation": "Truth: the volume that the closed mesh encloses, or the voxels of the segment. Where its back is, "
    "is a choice of whoever segmented it. Women lie prone in most scanners: a breast's volume is the same, its border "
    "may not be.",
    "volume": "Truth: as in the table.",
}


def validation_summary(found: ValidationStudy) -> list[str]:
    """The main results in sentences, one for each definition."""
    lines = [f"{found.breasts} breasts of {found.women} women against {_TRUTHS[found.truth]}."]
    for one in found.definitions:
        bias, sizes = one.agreement.mean_difference, one.data.reference
        words = "" if not one.deming.proportional else " The difference grows with the size of the breast."
        lines.append(
            f"{_capital(one.definition)}: {number(bias.value, '+.1f')} cc ({_span(bias, '+.1f')} cc; "
            f"{number(100 * bias.value / float(sizes.mean()), '+.1f')} %); single breasts differ by "
            f"{number(one.agreement.lower_limit.value, '+.0f')} to {number(one.agreement.upper_limit.value, '+.0f')} "
            f"cc in 95 % of cases.{words}"
        )
    if len(found.definitions) > 1:
        lines.append("The definitions measure different things: compare a truth with the one that has the same back.")
    return lines


def validation_tables(found: ValidationStudy) -> list[TextTable]:
    """Agreement by definition, lines, offsets between definitions, all volumes."""
    tables = [
        TextTable(
            title="Measured less truth, by definition of the volume",
            columns=("definition", "breasts", "bias, cc", "95 % interval", "SD, cc", "of it the truth's own, cc",
                     "lower limit, cc", "95 % interval", "upper limit, cc", "95 % interval"),
            rows=tuple(
                (
                    one.definition,
                    str(one.agreement.pairs),
                    number(one.agreement.mean_difference.value, "+.1f"),
                    _span(one.agreement.mean_difference, "+.1f"),
                    number(one.agreement.sd.value, ".1f"),
                    number(one.truth_sd_cc, ".1f"),
                    *(text for limit in (one.agreement.lower_limit, one.agreement.upper_limit)
                      for text in (number(limit.value, "+.1f"), _span(limit, "+.1f"))),
                )
                for one in found.definitions
            ),
        ),
        TextTable(
            title="Proportional bias: measured = intercept + slope × truth",
            columns=("definition", "slope (Deming)", "95 % interval", "intercept, cc", "95 % interval",
                     "slope (Passing–Bablok)", "95 % interval", "intercept, cc", "95 % interval", "concordance"),
            rows=tuple(
                (
                    one.definition,
                    *(text for line in (one.deming, one.passing_bablok)
                      for text in (number(line.slope.value, ".3f"), _span(line.slope, ".3f"),
                                   number(line.intercept.value, "+.1f"), _span(line.intercept, "+.1f"))),
                    number(one.concordance, ".4f"),
                )
                for one in found.definitions
            ),
        ),
    ]  # fmt: skip
    if found.offsets:
        tables.append(
            TextTable(
                title="Offsets between definitions, for the same breasts",
                columns=("second less first", "breasts", "mean, cc", "%", "SD, cc", "concordance"),
                rows=tuple(
                    (
                        f"{one.second} less {one.first}",
                        str(one.breasts),
                        number(one.mean_cc, "+.1f"),
                        number(one.percent, "+.1f"),
                        number(one.sd_cc, ".1f"),
                        number(one.concordance, ".4f"),
                    )
                    for one in found.offsets
                ),
            )
        )
    tables.append(_volumes(found.definitions))
    return tables


def _volumes(definitions: tuple[DefinitionAgreement, ...]) -> TextTable:
    truth: dict[str, float] = {}
    measured: dict[str, dict[str, float]] = {}
    for one in definitions:
        for name, true, own in zip(one.data.names, one.data.reference, one.data.measured, strict=True):
            truth[name] = float(true)
            measured.setdefault(name, {})[one.definition] = float(own)
    columns = tuple(one.definition for one in definitions)
    return TextTable(
        title="Volumes, cc",
        columns=("breast", "truth", *columns),
        rows=tuple(
            (name, number(true, ".1f"), *(number(measured[name].get(column, math.nan), ".1f") for column in columns))
            for name, true in truth.items()
        ),
    )


def validation_remarks(found: ValidationStudy) -> list[str]:
    """Where the truth comes from, and how the lines were fitted."""
    return [
        _REMARKS[found.truth],
        f"Deming's line: errors in both, ratio of error variances {number(found.ratio, '.2f')} (measured by truth); "
        "intervals by the jackknife over women. Passing and Bablok's line: no assumption about the errors.",
        "Limits of agreement: both breasts of a woman are not counted as independent.",
        "Concordance: Lin's coefficient, 1 for equal values.",
    ]


def validation_json(found: ValidationStudy) -> dict[str, Any]:
    """All results as plain JSON-ready data. Unknown values are null."""
    return dict(
        plain(
            {
                "truth": found.truth,
                "women": found.women,
                "breasts": found.breasts,
                "ratio": found.ratio,
                "definitions": {
                    one.definition: {
                        "agreement": agreement_json(one.data, one.agreement),
                        "deming": asdict(one.deming),
                        "passing_bablok": asdict(one.passing_bablok),
                        "concordance": one.concordance,
                        "truth_sd_cc": one.truth_sd_cc,
                    }
                    for one in found.definitions
                },
                "offsets": [asdict(one) for one in found.offsets],
            }
        )
    )


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _span(estimate: IntervalEstimate, form: str) -> str:
    return " … ".join(number(bound, form) for bound in estimate.interval)
