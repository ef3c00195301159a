"""The report on paper: two to four pages.

The first part is for the surgeon, the second for the technician. It shows what the page in the browser shows, from the
same `ReportContent`. ReportLab needs no library of the system, so a PDF can be made wherever mammometry runs.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import chain, repeat
from typing import Any

from mammometry.report.arrangement import breast_pictures, first_pictures, paper_pictures
from mammometry.report.content import Fact, ReportContent
from mammometry.report.paper import ACCENT, FAINT, box, facts, fitted, picture, pictures, side_by_side, table, text
from mammometry.study.tables import Table

DOCUMENT = "report.pdf"
_MOST_PAGES = 4  # the surgeon's two and the technician's two
_FIRST_HEIGHT, _HEIGHT = 220.0, 150.0  # of the first picture and of the others, points; chosen by eye
_PICTURE_HEIGHTS = (175.0, 150.0, 125.0, 100.0)
"""Heights of the technical pictures, points. The document takes the largest that fits `_MOST_PAGES`."""


def render(content: ReportContent) -> bytes:
    """The document's bytes. The same content gives the same bytes."""

    def story(height: float, width: float) -> Iterator[Any]:
        yield from _for_the_surgeon(content, width)
        yield from _for_the_technician(content, width, height)

    stories = [partial(story, height) for height in _PICTURE_HEIGHTS]
    return fitted(content.identity.title, content.about, stories, most_pages=_MOST_PAGES)


def _for_the_surgeon(content: ReportContent, width: float) -> Iterator[Any]:
    """Warnings, volumes, the standard views. Then what was measured, breast by breast."""
    from reportlab.platypus import Spacer

    yield text("mammometry report", size=8, colour=ACCENT)
    yield text(content.identity.title, size=18, bold=True)
    yield text(content.about, size=8.5, colour=FAINT)
    yield Spacer(0, 6)
    if content.warnings:
        many = "warnings" if len(content.warnings) > 1 else "warning"
        words = [text(f"{len(content.warnings)} {many}", size=9.5, bold=True)]
        words += [text(f"• {warning}", size=8.5) for warning in content.warnings]
        yield box(words, width)
        yield Spacer(0, 8)
    cards = [
        [
            text(breast.title, size=9.5, colour=FAINT),
            text(breast.volume, size=22, bold=True),
            text(breast.interval, size=9, colour=ACCENT),
            *(text(caution, size=8.5, bold=True) for caution in breast.cautions),
            *facts(breast.facts),
        ]
        for breast in content.breasts
    ]
    if content.comparison:
        cards.append([text("Both sides", size=9.5, colour=FAINT), *facts(content.comparison)])
    if cards:
        yield side_by_side(cards, width)
        yield Spacer(0, 8)
    else:
        yield text("This session shows an open surface, which has no volume.")
    for shown, height in zip(first_pictures(content), chain([_FIRST_HEIGHT], repeat(_HEIGHT)), strict=False):
        yield picture(shown.jpeg, width, height)
    for breast in content.breasts:
        yield text(f"{breast.title}: what was measured", size=12, bold=True, before=10)
        yield from facts(
            [
                Fact(label="Boundary", value=breast.boundary),
                Fact(label=breast.wall_label, value=breast.wall),
                Fact(label="95 % interval", value=breast.interval_note),
            ]
        )
        if breast.tables:
            yield side_by_side([[_title(data), table(data, width / 2 - 12)] for data in breast.tables], width)
        yield from pictures(breast_pictures(content, breast.name), width, _HEIGHT)


def _for_the_technician(content: ReportContent, width: float, height: float) -> Iterator[Any]:
    """Each stage in numbers and in one or two pictures."""
    from reportlab.platypus import PageBreak

    yield PageBreak()
    yield text("For the technician", size=14, bold=True)
    for stage in content.stages:
        yield text(stage.title, size=11, bold=True, before=6)
        yield from facts(stage.facts, size=7.5)
        for data in stage.tables:
            yield _title(data)
            yield table(data, width)
    yield from pictures(paper_pictures(content, list(content.pictures)), width, height)
    changed = content.changed_settings or (Fact(label="Settings", value="all recommended"),)
    yield text("World frame, times, settings and versions", size=11, bold=True, before=6)
    timings = ", ".join(f"{fact.label} {fact.value}" for fact in content.timings)
    versions = ", ".join(f"{fact.label} {fact.value}" for fact in content.versions)
    held = Fact(label="This document contains", value=f"{content.contains}.")
    last = [held, Fact(label="World frame", value=content.world), *changed, Fact(label="Versions", value=versions)]
    if timings:
        last.insert(2, Fact(label="Times", value=timings))
    yield from facts(last, size=7.5)


def _title(data: Table) -> Any:
    return text(data.title, size=7.5, bold=True, before=3)
