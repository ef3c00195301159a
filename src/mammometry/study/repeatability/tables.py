"""A repeatability study as sentences, tables, JSON and CSV, and its claim sheet."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from typing import Any

from mammometry.base.csv_cells import csv_text
from mammometry.study.agreement import IntervalEstimate
from mammometry.study.repeatability.design import ANOTHER_DAY, ANYBODY, SAME_DAY, Reading
from mammometry.study.repeatability.limits import RepeatedLimits
from mammometry.study.repeatability.plan import CapturePlan, ClaimCheck, plan
from mammometry.study.repeatability.study import MOVED_MM, RepeatabilityStudy, Repetition, SizeClass
from mammometry.study.tables import TextTable, number, p_words, plain

_WHO = {
    SAME_DAY: "the same person captures her again with the same device on the same day",
    ANOTHER_DAY: "the same person captures her again with the same device on another day",
    ANYBODY: "anybody of the study captures her again with any device of the study",
}
_FEW = 20  # degrees of freedom below which the interval is wider than about half the figure
_LEAST_WOMEN = 10  # fewest women in a study of conformance; a choice
_USUAL_WOMEN = 35  # women in a study of conformance, as in QIBA's profiles, if the plan gives no number
_PRECONDITIONS = (
    "same posture, stand or seat, and arm position at every capture",
    "captured at the end of a normal breath out",
    "the woman steps away and is placed anew before each capture",
    "nothing covers the breasts; hair and jewellery are away",
    "borders drawn or confirmed in the same way as in this study",
)
_VERDICTS = {
    "shown": "The study shows it.",
    "undecided": "The study does not show it, and does not contradict it: more captures decide.",
    "contradicted": "The study contradicts it.",
}


def repeatability_summary(found: RepeatabilityStudy, claim: ClaimCheck | None = None) -> list[str]:
    """The main results in sentences."""
    lines = [
        f"{found.readings} volumes of {found.breasts} breasts of {found.women} women from {found.captures} captures; "
        f"mean volume {number(found.mean_cc, '.0f')} cc."
    ]
    for one in found.repetitions:
        detectable = one.detectable_cc
        lines.append(
            f"If {_WHO[one.level]}, one volume scatters by {number(one.sem_cc.value, '.1f')} cc "
            f"({number(one.cv_percent.value, '.1f')} %). A change of more than "
            f"{number(math.ceil(detectable.value), '.0f')} cc ({_span(detectable, '.0f')} cc) is real "
            "with 95 % confidence."
        )
    if claim is not None:
        lines.append(
            f"Claim of {number(claim.claim_cc, '.0f')} cc: detectable change {number(claim.detectable_cc, '.1f')} cc, "
            f"at most {number(claim.upper_cc, '.1f')} cc with 95 % confidence. {_VERDICTS[claim.verdict]}"
        )
    if found.size_trend_p < 0.05:
        lines.append(
            f"Larger breasts scatter differently (Kendall, {p_words(found.size_trend_p)}): use the percentages, or the "
            "figures of the class of size."
        )
    if any(one.df < _FEW for one in found.repetitions):
        lines.append("The intervals are wide, because there are few repetitions.")
    if found.changes:
        women = len({change.woman for change in found.changes})
        lines.append(
            f"Posture, breath or arms differed between the captures of {women} of {found.women} women: see the table."
        )
    return lines


def repeatability_tables(found: RepeatabilityStudy) -> list[TextTable]:
    """Repetition, components, sizes, limits of agreement, and conditions that differed."""
    tables = [
        TextTable(
            title="Repeatability",
            columns=("what changes", "SEM, cc", "95 % interval", "SDC, cc", "95 % interval", "degrees of freedom"),
            rows=tuple(
                (
                    one.level,
                    number(one.sem_cc.value, ".2f"),
                    _span(one.sem_cc, ".2f"),
                    number(one.detectable_cc.value, ".1f"),
                    _span(one.detectable_cc, ".1f"),
                    number(one.df, ".0f"),
                )
                for one in found.repetitions
            ),
        ),
        TextTable(
            title="Repeatability in per cent, and correlation",
            columns=("what changes", "CV, %", "95 % interval", "SDC, %", "95 % interval", "ICC", "95 % interval"),
            rows=tuple(
                (
                    one.level,
                    number(one.cv_percent.value, ".2f"),
                    _span(one.cv_percent, ".2f"),
                    number(one.detectable_percent.value, ".1f"),
                    _span(one.detectable_percent, ".1f"),
                    number(one.icc.value, ".4f"),
                    _span(one.icc, ".4f"),
                )
                for one in found.repetitions
            ),
        ),
        TextTable(
            title="Components of variance",
            columns=("effect", "levels", "standard deviation, cc", "95 % interval", "variance, cc² (REML)",
                     "variance, cc² (ANOVA)", "share of the error, %"),
            rows=tuple(
                (
                    one.name,
                    str(one.levels),
                    number(one.sd_cc.value, ".1f"),
                    _span(one.sd_cc, ".1f"),
                    number(one.variance_cc2, ".1f"),
                    number(one.moments_cc2, ".1f"),
                    number(100 * one.share, ".0f"),
                )
                for one in found.components
            ),
        ),
        *_size_tables(found.sizes),
    ]  # fmt: skip
    for unit, limits in (("cc", found.limits), ("%", found.limits_percent)):
        if limits:
            tables.append(_limits_table(limits, unit))
    if found.changes:
        tables.append(
            TextTable(
                title="What differed between captures",
                columns=("woman", "what", "found"),
                rows=tuple((one.woman, one.condition, " … ".join(one.found)) for one in found.changes),
            )
        )
    return tables


def _size_tables(sizes: Sequence[SizeClass]) -> Iterator[TextTable]:
    def table(title: str, names: tuple[str, str], estimates: Iterable[tuple[IntervalEstimate, ...]]) -> TextTable:
        return TextTable(
            title=title,
            columns=("breast", "breasts and persons", names[0], "95 % interval", names[1], "95 % interval"),
            rows=tuple(
                (
                    _size(one),
                    str(one.breasts),
                    *(text for estimate in own for text in (number(estimate.value, ".1f"), _span(estimate, ".1f"))),
                )
                for one, own in zip(sizes, estimates, strict=True)
            ),
        )

    yield table("New captures by size", ("SEM, cc", "SDC, cc"), ((one.sem_cc, one.detectable_cc) for one in sizes))
    yield table(
        "New captures by size, per cent",
        ("CV, %", "SDC, %"),
        ((one.cv_percent, one.detectable_percent) for one in sizes),
    )


def _limits_table(limits: Sequence[RepeatedLimits], unit: str) -> TextTable:
    return TextTable(
        title=f"Limits of agreement of single measurements, {unit}",
        columns=("second less first", "breasts", f"bias, {unit}", "95 % interval", f"lower limit, {unit}",
                 "95 % interval", f"upper limit, {unit}", "95 % interval"),
        rows=tuple(
            (
                f"{one.what} {one.second} less {one.first}",
                str(one.breasts),
                *(text for estimate in (one.bias, one.lower, one.upper)
                  for text in (number(estimate.value, "+.1f"), _span(estimate, "+.1f"))),
            )
            for one in limits
        ),
    )  # fmt: skip


def claim_sheet(found: RepeatabilityStudy) -> list[tuple[str, str]]:
    """Parts of the claim sheet: claim, activities, assessment, conformance, as in QIBA's profiles."""
    one = found.repetitions[0]
    detectable, upper = one.detectable_cc, one.detectable_cc.interval[1]
    return [
        (
            "Claim",
            f"A measured change of more than {number(math.ceil(detectable.value), '.0f')} cc "
            f"({number(one.detectable_percent.value, '.0f')} %) of one breast is real with 95 % confidence. "
            f"95 % interval of this figure: {_span(detectable, '.0f')} cc.",
        ),
        ("It holds if", "; ".join(_PRECONDITIONS)),
        (
            "Where it was shown",
            f"{found.breasts} breasts of {found.women} women, {number(found.mean_cc, '.0f')} cc on average, "
            f"{found.captures} captures; {_WHO[one.level]}.",
        ),
        (
            "By size",
            "; ".join(f"{_size(size)}: {number(size.detectable_cc.value, '.0f')} cc" for size in found.sizes) + ".",
        ),
        (
            "Activities",
            "Device: passes its acceptance test and its check of the day. Person: trained on five women who are not in "
            "the study. Capture: protocol above. Measurement: the same version and settings of the software.",
        ),
        (
            "Assessment",
            f"SEM {number(one.sem_cc.value, '.1f')} cc ({_span(one.sem_cc, '.1f')} cc) on {number(one.df, '.0f')} "
            f"degrees of freedom; SDC = 1.96 √2 SEM = {number(detectable.value, '.1f')} cc.",
        ),
        (
            "Conformance",
            f"Another place conforms if the upper one-sided 95 % bound of its own SDC is at most "
            f"{number(math.ceil(upper), '.0f')} cc, from at least {_women_needed(one, math.ceil(upper))} women "
            "captured twice.",
        ),
    ]


def _women_needed(one: Repetition, claim_cc: float) -> str:
    sizes = dict(plan(claim_cc, one.sem_cc.value).sizes) if one.sem_cc.value else {}
    return str(max(sizes[2], _LEAST_WOMEN) if 2 in sizes else _USUAL_WOMEN)


def plan_table(planned: CapturePlan) -> TextTable:
    """Women for each number of captures."""
    return TextTable(
        title=f"For a claim of {number(planned.claim_cc, 'g')} cc, if one volume scatters by "
        f"{number(planned.sem_cc, 'g')} cc",
        columns=("captures of each woman", "women", "captures in all"),
        rows=tuple((str(captures), str(women), str(captures * women)) for captures, women in planned.sizes),
    )


def repeatability_json(found: RepeatabilityStudy, claim: ClaimCheck | None = None) -> dict[str, Any]:
    """All results as data for JSON. Unknown values are null."""
    table = asdict(found)
    for one, row in zip(found.repetitions, table["repetitions"], strict=True):
        row["detectable_cc"] = asdict(one.detectable_cc)
    for size, row in zip(found.sizes, table["sizes"], strict=True):
        row["detectable_cc"] = asdict(size.detectable_cc)
    return dict(plain(table | {"claim": None if claim is None else asdict(claim)}))


def readings_csv(readings: Sequence[Reading]) -> str:
    """All volumes, one per row. `read_repeated` can read it."""
    conditions = tuple(dict.fromkeys(name for one in readings for name, _ in one.conditions))
    columns = ("woman", "side", "device", "rater", "day", "capture", "reader", "reading")
    used = [column for column in columns if any(getattr(one, column) for one in readings)]
    rows = []
    for one in readings:
        known = dict(one.conditions)
        own = [getattr(one, column) for column in used]
        rows.append([*own, f"{one.volume_cc:.3f}", *(known.get(name, "") for name in conditions)])
    return csv_text((*used, "volume_cc", *conditions), rows)


def repeatability_remarks(found: RepeatabilityStudy) -> list[str]:
    """How the figures were computed, and what they do not include."""
    lines = [
        "SEM, standard error of measurement: square root of the sum of the variances of all effects that change. "
        "Components by restricted maximum "
        "likelihood; intervals from the mean squares of the analysis of variance (Graybill and Wang 1980). "
        + (
            "The table is balanced: the analysis of variance gives the same components where none is negative."
            if found.balanced
            else "The table is not balanced, so that there is no closed form to compare with."
        ),
        "SDC, smallest detectable change: 1.96 √2 SEM. CV, coefficient of variation, and percentages are of the "
        "logarithms of the volumes.",
        "ICC, intraclass correlation: absolute agreement of single measurements, all effects random, ICC(A,1); for a "
        "new capture by the same person, ICC(1).",
        "Limits of agreement are for single measurements of breasts that were measured repeatedly (Bland and Altman "
        "1999, section 5.2; intervals after Zou 2013). Two captures by one person have the limits ± SDC.",
        f"Lengths are listed if they spread by more than {number(MOVED_MM, 'g')} mm in one woman.",
    ]
    lines += [f"This design cannot separate {name} from {same}." for name, same in found.merged]
    return lines


def _size(one: SizeClass) -> str:
    if math.isinf(one.to_cc):
        return f"{number(one.from_cc, '.0f')} cc and more"
    return f"{number(one.from_cc, '.0f')} to {number(one.to_cc, '.0f')} cc"


def _span(estimate: IntervalEstimate, form: str) -> str:
    return " … ".join(number(bound, form) for bound in estimate.interval)
