"""A validation as sentences, tables and JSON."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from mammometry.base.csv_cells import csv_text
from mammometry.study.agreement import IntervalEstimate
from mammometry.study.agreement_tables import agreement_json
from mammometry.study.tables import TextTable, number, plain
from mammometry.study.validation.study import ValidationStudy

_TRUTHS = {
    "water": "the specimen, by displaced water",
    "weight": "the specimen, by its weight and an assumed density",
    "segmentation": "a segmentation",
    "volume": "the volumes in the table",
}
_REMARKS = {
    "water": "Truth: displaced water at its temperature, plus the skin that the operation left on the woman: its area "
    "by its thickness, 1.44 ± 0.25 mm where the table gives none (doi 10.1118/1.4793257). Uncertainty of the "
    "displacement: 1 %, at least 3 cc, where the table gives none (assumed). A specimen that lacks the fat at the "
    "breast's edge is smaller than the breast.",
    "weight": "Truth: weight by density, plus the skin that the operation left. Density from the composition (fat "
    "0.93, gland 1.04 g/cc, assumed; ± 0.02), else from the age (0.96 ± 0.04 from 50 years on, 1.01 ± 0.08 below; "
    "Yi 2019), else 0.97 ± 0.04 g/cc.",
    "segmentation": "Truth: the volume inside the closed mesh, or that of the segment's voxels. The person who "
    "segmented the breast chose where it ends at the back. Most MRI is taken lying prone: the breast has the same "
    "volume, but its border may shift.",
    "volume": "Truth: as in the table.",
}


def validation_summary(found: ValidationStudy) -> list[str]:
    """The main results in sentences, one per definition."""
    lines = [f"{len(found.cases)} breasts of {found.women} women against {_TRUTHS[found.truth]}."]
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
        lines.append(
            "The definitions measure different things: compare the truth with the one that has the same back surface."
        )
    return lines


def validation_tables(found: ValidationStudy) -> list[TextTable]:
    """Agreement by definition, lines, offsets between definitions, all volumes."""
    tables = [
        TextTable(
            title="Measured less truth, by definition of the volume",
            columns=("definition", "breasts", "bias, cc", "95 % interval", "SD, cc", "of it the truth's own, cc",
                     "concordance"),
            rows=tuple(
                (
                    one.definition,
                    str(one.agreement.pairs),
                    number(one.agreement.mean_difference.value, "+.1f"),
                    _span(one.agreement.mean_difference, "+.1f"),
                    number(one.agreement.sd.value, ".1f"),
                    number(one.truth_sd_cc, ".1f"),
                    number(one.concordance, ".4f"),
                )
                for one in found.definitions
            ),
        ),
        TextTable(
            title="Limits of agreement, by definition of the volume",
            columns=("definition", "lower limit, cc", "95 % interval", "upper limit, cc", "95 % interval"),
            rows=tuple(
                (
                    one.definition,
                    *(text for limit in (one.agreement.lower_limit, one.agreement.upper_limit)
                      for text in (number(limit.value, "+.1f"), _span(limit, "+.1f"))),
                )
                for one in found.definitions
            ),
        ),
        TextTable(
            title="Proportional bias: measured = intercept + slope × truth",
            columns=("definition, line", "slope", "95 % interval", "intercept, cc", "95 % interval"),
            rows=tuple(
                (
                    f"{one.definition}, {name}",
                    number(line.slope.value, ".3f"),
                    _span(line.slope, ".3f"),
                    number(line.intercept.value, "+.1f"),
                    _span(line.intercept, "+.1f"),
                )
                for one in found.definitions
                for name, line in (("Deming", one.deming), ("Passing–Bablok", one.passing_bablok))
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
    tables.append(_volumes(found))
    return tables


def _volumes(found: ValidationStudy) -> TextTable:
    names = tuple(one.definition for one in found.definitions)
    return TextTable(
        title="Volumes, cc",
        columns=("breast", "truth", *names),
        rows=tuple(
            (
                case.breast,
                number(case.truth_cc, ".1f"),
                *(number(case.measured_cc.get(name, math.nan), ".1f") for name in names),
            )
            for case in found.cases
        ),
    )


def validation_csv(found: ValidationStudy) -> str:
    """All volumes, one row per breast. `read_truths` can read it."""
    names = tuple(one.definition for one in found.definitions)
    rows = (
        [
            case.woman,
            case.side,
            *(_cell(volume) for volume in (case.truth_cc, case.truth_sd_cc)),
            *(_cell(case.measured_cc.get(name, math.nan)) for name in names),
        ]
        for case in found.cases
    )
    columns = (f"{name.replace(' ', '_')}_cc" for name in names)
    return csv_text(("woman", "side", "truth_cc", "truth_sd_cc", *columns), rows)


def _cell(volume_cc: float) -> str:
    return "" if math.isnan(volume_cc) else f"{volume_cc:.3f}"


def validation_remarks(found: ValidationStudy) -> list[str]:
    """Origin of the truth, and how the lines were fitted."""
    return [
        _REMARKS[found.truth],
        f"Deming's line: errors in both, ratio of error variances {number(found.ratio, '.2f')} (measured by truth); "
        "intervals by the jackknife over women. Passing and Bablok's line: no assumption about the errors.",
        "Limits of agreement: the two breasts of a woman do not count as independent.",
        "Concordance: Lin's coefficient, 1 for equal values.",
    ]


def validation_json(found: ValidationStudy) -> dict[str, Any]:
    """All results as data for JSON. Unknown values are null."""
    return dict(
        plain(
            {
                "truth": found.truth,
                "women": found.women,
                "breasts": len(found.cases),
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
