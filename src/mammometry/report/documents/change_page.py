"""Comparison of two dates of one patient: page, document, numbers, pictures."""

from __future__ import annotations

import datetime
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mammometry.base.notices import Notice
from mammometry.base.notices.words import NAMES, words_at
from mammometry.base.rounding import at_95, half_width, rounded_words
from mammometry.geometry.arrays import Array, Float64
from mammometry.measure.change import BreastChange, Change, LengthChange
from mammometry.report.content import DISCLAIMER, Fact, sentence
from mammometry.report.documents import paper
from mammometry.report.documents.pages import STYLE, embed, render, viewer_program
from mammometry.report.figures import change as change_figures
from mammometry.report.figures.change import Dated
from mammometry.report.models import change_scene
from mammometry.report.pictures import encoded
from mammometry.report.scene import SCENE, to_json
from mammometry.report.words.describe import versions
from mammometry.report.words.volumes import change_sentence, measured_words, span_words, term_words
from mammometry.study.tables import TextTable

PAGE, DOCUMENT, NUMBERS = "compare.html", "compare.pdf", "compare.json"
FILES = (PAGE, DOCUMENT, NUMBERS, SCENE, "change.png", "sections.png")
_FORMAT = 1  # version of compare.json


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChangeReport:
    """All text, pictures and values of a comparison."""

    title: str
    subtitle: str
    """The dates as text."""
    subject: str | None = None
    """Identifier of the subject if both dates have it, otherwise None."""
    keys: tuple[str, str]
    """For each date, the digest of its report's content, which shows later whether the page is current."""
    change: Change
    dates: tuple[Dated, Dated]
    """The earlier date first. Both are in its world frame."""
    frame: Float64[Array, "3 3"]
    """Rows: right, up and towards the viewer of the front view. World frame of the earlier date."""
    notices: tuple[Notice, ...]
    """Warnings, worst first, and remarks on the comparison."""
    contains: str
    """Personal data on the page."""
    settings: tuple[Fact, ...]
    """Settings that differ from the defaults."""
    before: datetime.date | None = None
    """The earlier date, if the page may name it."""
    at_one_date: Mapping[str, str] = field(default_factory=dict)
    """Breast → ``earlier`` or ``later``, if only that date has a volume."""

    @property
    def warnings(self) -> list[str]:
        """The warnings as text."""
        return words_at("warning", self.notices)

    @property
    def remarks(self) -> list[str]:
        """Remarks on the comparison, as text."""
        return words_at("note", self.notices)


@dataclass(frozen=True, slots=True, kw_only=True)
class BreastCard:
    """One breast's change, as text."""

    title: str
    change: str
    interval: str
    verdict: str
    facts: tuple[Fact, ...]


def change_files(report: ChangeReport) -> dict[str, bytes]:
    """Page, document, numbers and pictures: file name → content."""
    from markupsafe import Markup

    change = report.change
    pictures = {
        "change.png": change_figures.change_map(report.frame, report.dates, change),
        "sections.png": change_figures.change_sections(report.frame, report.dates, change),
    }
    cards = [breast_card(breast, report.before) for breast in change.breasts]
    tables = length_tables(change.lengths)
    scene = to_json(change_scene(report.frame, report.dates, change_figures.limit_mm(change)))
    page = render(
        "compare.html.j2",
        styles=(STYLE, "viewer.css"),
        report=report,
        cards=cards,
        trunk=trunk_facts(change),
        definitions=definitions(change),
        tables=tables,
        pictures=[embed(png) for png in pictures.values()],
        versions=versions(),
        disclaimer=DISCLAIMER,
        scene=Markup(scene),
        viewer=Markup(viewer_program()),
    )
    document = paper.document(report.title, report.subtitle, lambda width: _story(report, cards, pictures, width))
    return {
        PAGE: page.encode(),
        DOCUMENT: document,
        SCENE: scene.encode(),
        NUMBERS: (json.dumps(as_table(report), indent=1, ensure_ascii=False) + "\n").encode(),
        **pictures,
    }


def as_table(report: ChangeReport) -> dict[str, Any]:
    """The comparison as data for JSON. Lengths in mm, volumes in cc."""
    change = report.change
    fit = change.fit
    return {
        "format": _FORMAT,
        "title": report.title,
        "dates": report.subtitle,
        "subject": report.subject,
        "warnings": report.warnings,
        "remarks": report.remarks,
        "notices": [notice.as_table() for notice in report.notices],
        "registration": {
            "before_from_after": fit.before_from_after.matrix.tolist(),
            "scatter_mm": round(fit.scatter_mm, 4),
            "within_mm": round(fit.within_mm, 4),
            "weakest_mm": round(fit.weakest_mm, 4),
            "turned_deg": round(fit.turned_deg, 3),
            "doubtful": change.doubtful,
            "pairing": change.pairing,
        },
        "at_one_date": dict(report.at_one_date),
        "breasts": {
            breast.name: {
                "verdict": verdict_of(breast, report.before),
                "before_cc": round(breast.before.volume_cc, 3),
                "before_interval_cc": _rounded(breast.before.interval_cc),
                "after_cc": round(breast.after.volume_cc, 3),
                "after_interval_cc": _rounded(breast.after.interval_cc),
                "change_cc": round(breast.volume.difference_cc, 3),
                "change_interval_cc": _rounded(breast.volume.difference_interval_cc),
                "ratio": round(breast.volume.ratio, 5),
                "ratio_interval": _rounded(breast.volume.ratio_interval, 5),
                "terms_cc": {name: round(term, 3) for name, term in breast.volume.terms_cc.items()},
                "beyond_error": breast.volume.beyond_error,
                "rms_mm": round(breast.rms_mm, 3),
                "wall": breast.after.wall_kind,
                "boundaries": [breast.before.boundary_method, breast.after.boundary_method],
                "note": breast.volume.note,
            }
            for breast in change.breasts
        },
        "lengths": [
            {
                "name": length.name,
                "title": length.title,
                "along_the_skin": length.along,
                "before_mm": round(length.before_mm, 2),
                "after_mm": round(length.after_mm, 2),
                "change_mm": round(length.change_mm, 2),
                "sigma_mm": round(length.sigma_mm, 2),
                "beyond_error": length.beyond_error,
            }
            for length in change.lengths
        ],
    }


def verdict_of(breast: BreastChange, before: datetime.date | None) -> str:
    """One breast's change and verdict in one sentence. The clinic's pages use it, too."""
    volume = breast.volume
    return change_sentence(
        breast.name, volume.difference_cc, volume.difference_interval_cc, volume.beyond_error, before
    )


def breast_card(breast: BreastChange, before: datetime.date | None) -> BreastCard:
    """Describe the change of one breast: amount, interval and verdict.

    Args:
        breast: one breast at both dates.
        before: the earlier date; None if it must not be named.
    """
    volume = breast.volume
    title = NAMES[breast.name]
    interval = volume.difference_interval_cc
    facts = [
        Fact("Before", measured_words(breast.before.volume_cc, breast.before.interval_cc)),
        Fact("After", measured_words(breast.after.volume_cc, breast.after.interval_cc)),
        Fact("After in % of before", _percent(volume.ratio, volume.ratio_interval)),
        Fact("Skin moved (RMS)", f"{breast.rms_mm:.1f} mm, with the trunks aligned"),
        Fact("Chest wall", f"{breast.after.wall_kind}, at both dates"),
    ]
    facts += [
        Fact(f"Uncertainty from {name}", f"± {term_words(term)} cc (95 %)") for name, term in volume.terms_cc.items()
    ]
    return BreastCard(
        title=f"{title[:1].upper()}{title[1:]}",
        change=rounded_words(volume.difference_cc, half_width(interval), "cc", sign=True, alone=True),
        interval=span_words(interval, sign=True),
        verdict=verdict_of(breast, before),
        facts=tuple(facts),
    )


def trunk_facts(change: Change) -> tuple[Fact, ...]:
    """Facts about the alignment of the two trunks."""
    fit = change.fit
    posed = {
        "same pose": "the same, judged by the trunk",
        "across poses": "different. The interval of the change includes this",
    }
    return (
        Fact("Fit around the breasts", f"80 % of the trunk within {fit.within_mm:.1f} mm"),
        Fact("Scatter (robust SD)", f"{fit.scatter_mm:.2f} mm"),
        Fact("Uncertainty of the fit", f"{fit.weakest_mm:.2f} mm (standard uncertainty)"),
        Fact("Lean", f"differs by {fit.turned_deg:.0f}° from the upright of the photographs"),
        Fact("Pose", posed.get(change.pairing, change.pairing)),
    )


def length_tables(lengths: Sequence[LengthChange]) -> tuple[TextTable, ...]:
    """Lengths that are known at both dates. Empty without landmarks."""
    if not lengths:
        return ()
    rows = tuple(
        (
            length.title,
            "along the skin" if length.along else "straight",
            *(at_95(length_mm, length.sigma_mm, alone=True) for length_mm in (length.before_mm, length.after_mm)),
            at_95(length.change_mm, length.sigma_mm, sign=True),
            "yes" if length.beyond_error else "no",
        )
        for length in lengths
    )
    columns = ("from, to", "path", "before, mm", "after, mm", "change, mm, ± 95 %", "larger than the error")
    return (TextTable(title="Lengths between landmarks", columns=columns, rows=rows),)


def definitions(change: Change) -> tuple[Fact, ...]:
    """The compared boundaries, chest wall and interval."""
    rows = []
    for breast in change.breasts:
        name = NAMES[breast.name]
        rows += [
            Fact(f"Boundary before, {name}", sentence(breast.before.boundary_method)),
            Fact(f"Boundary after, {name}", sentence(breast.after.boundary_method)),
        ]
    first = change.breasts[0]
    wall = f"{first.after.wall_kind.capitalize()}: {sentence(first.after.wall_definition, capital=False)}"
    rows.append(Fact("Chest wall", wall))
    rows.append(Fact("95 % interval", sentence(first.volume.note)))
    return tuple(rows)


def _story(
    report: ChangeReport, cards: Sequence[BreastCard], pictures: dict[str, bytes], width: float
) -> Iterator[Any]:
    from reportlab.platypus import Spacer

    yield paper.text("mammometry: two dates compared", size=8, colour=paper.ACCENT)
    yield paper.text(report.title, size=18, bold=True)
    yield paper.text(report.subtitle, size=8.5, colour=paper.FAINT)
    yield Spacer(0, 6)
    if report.warnings:
        yield paper.box([paper.text(f"• {warning}", size=8.5) for warning in report.warnings], width)
        yield Spacer(0, 8)
    shown = [
        [
            paper.text(card.title, size=9.5, colour=paper.FAINT),
            paper.text(card.change, size=22, bold=True),
            paper.text(card.interval, size=9, colour=paper.ACCENT),
            paper.text(card.verdict, size=9, bold=True),
            *paper.facts(card.facts),
        ]
        for card in cards
    ]
    trunk = [paper.text("Fit of the trunk", size=9.5, colour=paper.FAINT), *paper.facts(trunk_facts(report.change))]
    yield paper.side_by_side([*shown, trunk], width)
    yield Spacer(0, 8)
    yield paper.picture(encoded(pictures["change.png"]).jpeg, width, 400)
    yield from paper.facts([Fact("Remark", remark) for remark in report.remarks])
    for table in length_tables(report.change.lengths):
        yield paper.text(table.title, size=11, bold=True, before=6)
        yield paper.table(table, width)
    yield paper.picture(encoded(pictures["sections.png"]).jpeg, width, 180)
    yield paper.text("What was compared", size=11, bold=True, before=6)
    yield from paper.facts(definitions(report.change), size=7.5)
    held = Fact("This document contains", f"{report.contains}.")
    named = ", ".join(f"{fact.label} {fact.value}" for fact in versions())
    yield from paper.facts([held, *report.settings, Fact("Versions", named)], size=7.5)


def _percent(ratio: float, interval: tuple[float, float] | None) -> str:
    words = f"{100 * ratio:.0f} %"
    return words if interval is None else f"{words} ({100 * interval[0]:.0f} to {100 * interval[1]:.0f})"


def _rounded(interval: tuple[float, float] | None, digits: int = 3) -> list[float] | None:
    return None if interval is None else [round(bound, digits) for bound in interval]
