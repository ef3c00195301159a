"""Acceptance test as text, tables, JSON and CSV, and the history of a device."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from mammometry.base.csv_cells import csv_text
from mammometry.base.value import value
from mammometry.study.acceptance.artefacts import (
    BREAST_CC,
    KINDS,
    POSITIONS,
    QUANTITIES,
    TITLES,
    Artefact,
    Bar,
    Cast,
    Kind,
    Plane,
    Quantity,
    Sphere,
)
from mammometry.study.acceptance.evaluate import AcceptanceFinding, Decision, Outcome
from mammometry.study.tables import TextTable, number, signed

FORMAT = 1
"""Version of the results in JSON."""
QUANTITY_WORDS: Mapping[Quantity, str] = MappingProxyType(
    {
        "form": "probing error of form",
        "size": "probing error of size",
        "spacing": "sphere-spacing error",
        "length": "length error",
        "flatness": "flatness error",
        "volume": "volume error",
    }
)
DECISION_WORDS: Mapping[str, str] = MappingProxyType(
    {"accept": "accepted", "reject": "rejected", "undecided": "undecided"}
)
_HEADLINES: Mapping[Decision, str] = MappingProxyType(
    {
        "accept": "Accepted: every error is within its limit, with its uncertainty.",
        "reject": "Rejected: at least one error is beyond its limit, even with its uncertainty.",
        "undecided": "Undecided: nothing is beyond its limit for certain, but not everything is shown to be within.",
    }
)
_CSV = ("device", "date", "artefact", "position", "quantity", "unit", "measured", "reference", "error",
        "expanded_uncertainty", "limit", "decision", "effect_cc")  # fmt: skip


def unit_of(quantity: Quantity) -> str:
    """Unit of an error: mm, or cc for a volume."""
    return "cc" if quantity == "volume" else "mm"


def shown(quantity: Quantity, value: float, *, sign: bool = False) -> str:
    """A value with its unit, rounded to 0.01 mm or 0.1 cc."""
    digits = 1 if quantity == "volume" else 2
    return f"{signed(value, digits) if sign else number(value, f'.{digits}f')} {unit_of(quantity)}"


def headline(outcome: Outcome) -> str:
    """The decision in one sentence."""
    return _HEADLINES[outcome.decision]


def missing_sentences(outcome: Outcome) -> list[str]:
    """Sentences about missing positions, missing artefacts, and excluded points."""
    lines = []
    for kind, names in outcome.missing.items():
        words = {place.name: place.words for place in POSITIONS[kind]}
        if len(names) == len(words):
            lines.append(f"{TITLES[kind]}: none of the {len(words)} positions was measured.")
            continue
        listed = "; ".join(f"{name} ({words[name]})" for name in names)
        lines.append(f"{TITLES[kind]}: {len(names)} of {len(words)} positions missing: {listed}.")
    untested = [TITLES[kind].lower() for kind in KINDS if kind not in outcome.test.artefacts]
    if untested:
        lines.append(f"Not tested: {', '.join(untested)}.")
    lines += [
        f"{TITLES[result.kind]}, position {result.position}: {100 * result.share_left_out:.1f} % of the points are far "
        "from the surface and were left out. The rule allows 0.3 %."
        for result in outcome.left_out
    ]
    return lines


def meaning(finding: AcceptanceFinding) -> str:
    """An error, its uncertainty, limit and decision, and its effect on a breast of 400 cc."""
    spoken = shown(finding.quantity, finding.error, sign=finding.reference != 0)
    around = shown(finding.quantity, finding.expanded)
    name = QUANTITY_WORDS[finding.quantity]
    return (
        f"{TITLES[finding.kind]}, {name}: {spoken} ± {around} at position {finding.position} (the worst), limit "
        f"{shown(finding.quantity, finding.limit)}: {DECISION_WORDS[finding.decision]}. {effect_words(finding)}"
    )


def effect_words(finding: AcceptanceFinding) -> str:
    """Effect of an error on the volume of a breast of 400 cc, in one sentence."""
    error, cc = shown(finding.quantity, abs(finding.error)), number(abs(finding.effect_cc), ".1f")
    most = "at most" if finding.quantity in ("form", "flatness") else "about"
    return f"{error} here is {most} ± {cc} cc on a breast of {BREAST_CC:.0f} cc."


def reference_words(artefact: Artefact) -> str:
    """Reference values of an artefact, with standard uncertainties."""
    match artefact:
        case Sphere():
            return f"diameter {artefact.diameter_mm:g} mm (standard uncertainty {artefact.diameter_std_mm:g} mm)"
        case Bar():
            return (
                f"distance {artefact.distance_mm:g} mm ({artefact.distance_std_mm:g} mm), diameters "
                f"{artefact.diameter_mm:g} mm ({artefact.diameter_std_mm:g} mm)"
            )
        case Plane():
            return f"flat (standard uncertainty {artefact.flatness_std_mm:g} mm)"
        case Cast():
            return f"{artefact.volume_cc:g} cc (standard uncertainty {artefact.volume_std_cc:g} cc)"


def acceptance_tables(outcome: Outcome) -> tuple[TextTable, dict[Kind, TextTable]]:
    """Worst errors, and all errors for each artefact that was measured."""
    columns = ("error", "value ± 95 %", "limit", "decision", f"on a breast of {BREAST_CC:.0f} cc")
    worst = tuple(
        (f"{TITLES[one.kind]}: {QUANTITY_WORDS[one.quantity]}", *_cells(one)) for one in outcome.worst.values()
    )
    tables = {}
    for kind in outcome.test.artefacts:
        words = {place.name: place.words for place in POSITIONS[kind]}
        rows = tuple(
            (f"{one.position}: {words[one.position]}, {QUANTITY_WORDS[one.quantity]}", *_cells(one))
            for one in outcome.findings
            if one.kind == kind
        )
        if rows:
            title = f"{TITLES[kind]}: all positions"
            tables[kind] = TextTable(title=title, columns=("position", *columns[1:]), rows=rows)
    return TextTable(title="Worst error of each kind", columns=columns, rows=worst), tables


def _cells(one: AcceptanceFinding) -> tuple[str, ...]:
    error = number(one.error, "+.2f" if one.reference else ".2f")
    return (
        f"{error} ± {number(one.expanded, '.2f')} {unit_of(one.quantity)}",
        shown(one.quantity, one.limit),
        DECISION_WORDS[one.decision],
        f"± {number(abs(one.effect_cc), '.1f')} cc",
    )


def acceptance_json(outcome: Outcome) -> dict[str, Any]:
    """All results as data for JSON."""
    import mammometry

    test = outcome.test
    return {
        "format": FORMAT,
        "device": test.device,
        "date": test.date.isoformat(),
        "person": test.person,
        "software": test.software or f"mammometry {mammometry.__version__}",
        "evaluated_by": f"mammometry {mammometry.__version__}",
        "decision": outcome.decision,
        "missing": {kind: list(names) for kind, names in outcome.missing.items()},
        "not_tested": [kind for kind in KINDS if kind not in test.artefacts],
        "references": {
            kind: {"values": reference_words(artefact), "source": artefact.source}
            for kind, artefact in test.artefacts.items()
        },
        "findings": [_finding(one) for one in outcome.findings],
        "positions": [
            {
                "artefact": result.kind,
                "position": result.position,
                "points": sum(len(patch.points) for patch in result.patches),
                "share_seen": [round(patch.share_seen, 3) for patch in result.patches],
                "share_left_out": round(result.share_left_out, 5),
                "widest_mm": None if result.widest_mm is None else round(result.widest_mm, 4),
            }
            for result in outcome.results
        ],
    }


def _finding(one: AcceptanceFinding) -> dict[str, Any]:
    return {
        "artefact": one.kind,
        "position": one.position,
        "quantity": one.quantity,
        "unit": unit_of(one.quantity),
        "measured": round(one.measured, 4),
        "reference": round(one.reference, 4),
        "error": round(one.error, 4),
        "expanded_uncertainty": round(one.expanded, 4),
        "artefact_std": round(one.artefact_std, 4),
        "fit_std": round(one.fit_std, 4),
        "limit": round(one.limit, 4),
        "decision": one.decision,
        "effect_cc": round(one.effect_cc, 2),
    }


@value
class PastTest:
    """One earlier test of a device: its decision and its worst errors."""

    date: datetime.date
    decision: str
    worst: Mapping[str, tuple[float, float, float]]
    """``artefact/quantity`` → error, expanded uncertainty and limit at the decisive position, mm or cc."""


def worst_errors(test: PastTest) -> list[str]:
    """Worst errors of a test with their uncertainties and limits, one line each."""
    lines = []
    for kind in KINDS:
        for quantity in QUANTITIES[kind]:
            if (name := f"{kind}/{quantity}") in test.worst:
                error, expanded, limit = test.worst[name]
                around = f"{number(error, '+.2f')} ± {number(expanded, '.2f')} {unit_of(quantity)}"
                lines.append(f"{QUANTITY_WORDS[quantity]} {around} (limit {shown(quantity, limit)})")
    return lines


def as_past(outcome: Outcome) -> PastTest:
    """This test as an entry of the device's history."""
    return PastTest(
        date=outcome.test.date,
        decision=outcome.decision,
        worst={
            f"{kind}/{quantity}": (one.error, one.expanded, one.limit)
            for (kind, quantity), one in outcome.worst.items()
        },
    )


def acceptance_csv(outcome: Outcome) -> bytes:
    """All errors, one per row."""
    head = [outcome.test.device, outcome.test.date.isoformat()]
    table = (_finding(one) for one in outcome.findings)
    return csv_text(_CSV, ([*head, *(row[name] for name in _CSV[2:])] for row in table)).encode()


def history_csv(device: str, history: Sequence[PastTest]) -> bytes:
    """Worst errors of all tests of a device, one per row, oldest first."""
    columns = ("device", "date", "decision", "artefact", "quantity", "error", "expanded_uncertainty", "limit")
    rows = (
        [device, past.date.isoformat(), past.decision, *name.split("/"), *(round(part, 4) for part in values)]
        for past in history
        for name, values in past.worst.items()
    )
    return csv_text(columns, rows).encode()


def summary(outcome: Outcome) -> list[str]:
    """Decision, worst errors and missing measurements, in one or two sentences each."""
    return [headline(outcome), *map(meaning, outcome.worst.values()), *missing_sentences(outcome)]


def kinds_of(outcome: Outcome) -> tuple[Kind, ...]:
    """Artefacts that were measured."""
    return tuple(kind for kind in KINDS if any(result.kind == kind for result in outcome.results))
