"""The report as a PDF: one page for the surgeon, then the details.

It has the same content as the web page. ReportLab needs no system library, so a PDF can be made wherever mammometry
runs.
"""

from collections.abc import Iterator
from functools import partial
from typing import Any

from mammometry.base.notices.words import words_of
from mammometry.report.content import Fact, LargeNumber, ReportContent, ReportPicture
from mammometry.report.documents import paper
from mammometry.report.documents.pages import breast_pictures, paper_pictures, whole_pictures
from mammometry.report.documents.paper import (
    ACCENT,
    FAINT,
    WARN,
    box,
    facts,
    fitted,
    pictures,
    side_by_side,
    table,
    text,
)
from mammometry.report.figures.canvas import INK
from mammometry.report.first_page import FirstPage, signature
from mammometry.report.words.volumes import MEANINGS_INTRODUCTION
from mammometry.study.tables import TextTable

DOCUMENT = "report.pdf"
_MOST_PAGES = 5
_HEIGHT = 150.0  # height of a breast's pictures, points; appearance only
_PICTURE_HEIGHTS = (120.0, 95.0)
"""Heights of the technical pictures, points. The largest one that keeps the document within `_MOST_PAGES` is used."""
_LEAST_PICTURES, _GAP = 200.0, 6.0  # least height of the first page's pictures, and space between them, points
_VIEW_NAME = 12.0  # height of the name of a view, points
_WRITING = 80.0  # largest space for writing a conclusion, points
_LONGEST_CONCLUSION = 900  # most characters that fit on the first page; longer conclusions are on the second


def render(content: ReportContent, first: FirstPage) -> bytes:
    """The document as bytes. Equal arguments give equal bytes.

    Args:
        content: content of the report.
        first: content of the first page.
    """

    def story(technical: float, width: float, height: float) -> Iterator[Any]:
        yield from _for_the_surgeon(content, first, width, height)
        yield from _in_words(content, first, width)
        yield from _for_the_technician(content, width, technical)

    stories = [partial(story, height) for height in _PICTURE_HEIGHTS]
    return fitted(first.title, content.about, stories, most_pages=_MOST_PAGES)


def _for_the_surgeon(content: ReportContent, first: FirstPage, width: float, height: float) -> Iterator[Any]:
    """The first page. Its pictures fill the space that the text leaves."""
    from reportlab.platypus import PageBreak, Spacer

    above, below = [*_heading(content, first, width)], [*_below(content, first, width)]
    signing = [] if first.conclusion else [*paper.signature_line(width, 0.0)]
    left = height - paper.height_of([*above, *below, *signing], width) - 3 * _GAP
    middle: list[Any] = []
    if first.pictures:
        middle = [Spacer(0, _GAP), _views(first, width, max(left, _LEAST_PICTURES)), Spacer(0, _GAP)]
    yield from [*above, *middle, *below]
    if first.conclusion is None:
        room = left - paper.height_of(middle, width)
        yield from paper.signature_line(width, min(max(room, 0.0), _WRITING))
    yield PageBreak()


def _heading(content: ReportContent, first: FirstPage, width: float) -> Iterator[Any]:
    who = [text(first.title, size=17, bold=True), text(first.who, size=9)]
    when = [text("Breast measurement", size=9, colour=ACCENT), text(first.when, size=9)]
    yield paper.columns([who, when], [0.55 * width, 0.45 * width])
    for operation in first.operations:
        yield text(operation, size=9)
    yield paper.line(width)
    if first.numbers:
        yield paper.columns(
            [_large(number) for number in first.numbers], [width / len(first.numbers)] * len(first.numbers)
        )
    else:
        yield text("This session shows an open surface, which has no volume.")
    if first.cautions:
        yield box([text(caution, size=8.5) for caution in first.cautions], width)


def _large(number: LargeNumber) -> list[Any]:
    words = [text(number.title, size=9.5, colour=FAINT, square=number.colour), text(number.value, size=24, bold=True)]
    words += [text(number.interval, size=9.5, colour=ACCENT)] if number.interval else []
    return [*words, *([text(number.note, size=8, colour=FAINT)] if number.note else [])]


def _views(first: FirstPage, width: float, height: float) -> Any:
    """The front view, and next to it the two oblique views, one above the other."""
    front, *oblique = first.pictures
    if len(oblique) != 2:
        return paper.picture(front.jpeg, width, height)
    label = _VIEW_NAME
    ratio = front.width / front.height
    # Both columns together are as wide as the page: ratio (h − label) + gap + ratio (h − 2 label − gap) / 2 = width.
    height = min(height, (width - _GAP + ratio * (2 * label + _GAP / 2)) / (1.5 * ratio))
    small = (height - 2 * label - _GAP) / 2
    cells: list[list[Any]] = [[], []]
    cells[0] = [_view_name(front), paper.picture(front.jpeg, width, height - label)]
    for view in oblique:
        cells[1] += [_view_name(view), paper.picture(view.jpeg, width, small)]
    wide = ratio * (height - label) + _GAP
    return paper.columns(cells, [wide, ratio * small], gap=_GAP)


def _view_name(picture: ReportPicture) -> Any:
    return text(picture.title, size=8, colour=FAINT, leading=_VIEW_NAME - 1.2)


def _below(content: ReportContent, first: FirstPage, width: float) -> Iterator[Any]:
    if content.lengths is not None:
        yield table(content.lengths, width, size=9, first=0.4)
        yield text(content.lengths_note, size=7.5, colour=FAINT)
    for sentence in first.change:
        yield text(sentence, size=8.5, before=3)
    if first.confirmation:
        colour = INK if first.is_confirmed else WARN
        yield text(f"Boundaries: {first.confirmation}.", size=9, colour=colour, before=3)
    yield from _conclusion(first, width)


def _conclusion(first: FirstPage, width: float) -> Iterator[Any]:
    signed = first.conclusion
    yield text("Conclusion", size=9, colour=FAINT, before=4)
    if signed is None:
        return
    if len(signed.text) > _LONGEST_CONCLUSION:
        yield text(f"It is long: see the next page. Signed: {signature(signed)}.", size=9)
        return
    yield from _signed(first)


def _signed(first: FirstPage) -> Iterator[Any]:
    assert first.conclusion is not None
    yield text(first.conclusion.text, size=9.5)
    yield text(f"Signed: {signature(first.conclusion)}. {first.amended}", size=8.5, colour=FAINT)


def _in_words(content: ReportContent, first: FirstPage, width: float) -> Iterator[Any]:
    """Definitions and origin of the numbers, for each breast."""
    if first.conclusion is not None and len(first.conclusion.text) > _LONGEST_CONCLUSION:
        yield text("Conclusion", size=12, bold=True)
        yield from _signed(first)
    if content.warnings:
        words = [text("Read this before you use the numbers", size=9.5, bold=True)]
        yield box([*words, *(text(f"• {words_of(warning)}", size=8.5) for warning in content.warnings)], width)
    if content.meanings:
        yield text("Definition of the breast", size=12, bold=True, before=8)
        yield text(MEANINGS_INTRODUCTION, size=8.5)
    for meaning in content.meanings:
        yield text(meaning.title, size=9, bold=True, before=4)
        yield text(meaning.sentences, size=8.5)
        yield from facts(meaning.volumes)
    if content.comparison:
        yield text("Left and right", size=12, bold=True, before=8)
        yield from facts(content.comparison)
    for breast in (breast for breast in content.breasts if breast.rows):
        yield text(f"{breast.title}: measured values", size=12, bold=True, before=8)
        yield from facts(breast.rows)
        if breast.tables:
            yield side_by_side([[_title(data), table(data, width / 2 - 12)] for data in breast.tables], width)
        yield from pictures(breast_pictures(content, breast.name), width, _HEIGHT)
    yield from pictures(whole_pictures(content), width, _HEIGHT)


def _for_the_technician(content: ReportContent, width: float, height: float) -> Iterator[Any]:
    """Each stage as numbers and one or two pictures."""
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
    changed = content.changed_settings or (Fact("Settings", "all recommended"),)
    yield text("World frame, times, settings and versions", size=11, bold=True, before=6)
    timings = ", ".join(f"{fact.label} {fact.value}" for fact in content.timings)
    versions = ", ".join(f"{fact.label} {fact.value}" for fact in content.versions)
    held = Fact("This document contains", f"{content.contains}.")
    last = [held, Fact("World frame", content.world), *changed, Fact("Versions", versions)]
    if timings:
        last.insert(2, Fact("Times", timings))
    yield from facts(last, size=7.5)


def _title(data: TextTable) -> Any:
    return text(data.title, size=7.5, bold=True, before=3)
