"""The report on paper: two to four pages, for the surgeon first, for the technician next.

It says and shows what the page in the browser does, from the same `ReportContent`. ReportLab needs no library of the
system, so that a PDF comes wherever mammometry runs.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
from PIL import Image

from mammometry.io.store import write_bytes
from mammometry.report.canvas import INK, caption_of
from mammometry.report.content import DISCLAIMER, Fact, ReportContent, Table

DOCUMENT = "report.pdf"
_MARGIN_MM = 14.0
_ACCENT, _FAINT, _LINE, _WARN, _WARN_GROUND = "#005a8e", "#586573", "#dde2e8", "#d08700", "#fff4dc"
_TECHNICIAN = ("detections", "residual-field", "rectified", "disparity", "range", "dents", "provenance", "repair")
"""Pictures that the paper has room for, two a row; all of them are on the page in the browser."""
_PICTURE_PX = 1400


def write(folder: Path, content: ReportContent) -> Path:
    """Write the document into a folder and return its path; an earlier one is replaced as a whole or not at all.

    Raises:
        StorageError: the folder cannot be written to.
    """
    write_bytes(folder / DOCUMENT, render(content))
    return folder / DOCUMENT


def render(content: ReportContent) -> bytes:
    """The document's bytes; the same content gives the same bytes."""
    from reportlab.lib.pagesizes import A4
    from reportlab.lib.units import mm
    from reportlab.platypus import BaseDocTemplate, Frame, PageTemplate

    _register_fonts()
    margin = _MARGIN_MM * mm
    width, height = A4[0] - 2 * margin, A4[1] - 2 * margin
    buffer = io.BytesIO()
    document = BaseDocTemplate(
        buffer,
        pagesize=A4,
        title=f"{content.title}: mammometry",
        author="mammometry",
        subject=content.subject,
        lang="en",
        invariant=True,
    )
    frame = Frame(margin, margin, width, height, 0, 0, 0, 0)
    document.addPageTemplates(PageTemplate(frames=[frame], onPage=_footer(content, margin)))
    document.build([*_for_the_surgeon(content, width), *_for_the_technician(content, width)])
    return buffer.getvalue()


def _for_the_surgeon(content: ReportContent, width: float) -> Iterator[Any]:
    """Warnings, volumes, the standard views; then what was measured, breast by breast."""
    from reportlab.platypus import Spacer

    yield _text("mammometry report", size=8, colour=_ACCENT)
    yield _text(content.title, size=18, bold=True)
    yield _text(" · ".join(filter(None, (content.created, content.subject))), size=8.5, colour=_FAINT)
    yield Spacer(0, 6)
    if content.warnings:
        many = "warnings" if len(content.warnings) > 1 else "warning"
        words = [_text(f"{len(content.warnings)} {many}", size=9.5, bold=True)]
        words += [_text(f"• {warning}", size=8.5) for warning in content.warnings]
        yield _box(words, width, ground=_WARN_GROUND, edge=_WARN)
        yield Spacer(0, 8)
    cards = [
        [
            _text(breast.title, size=9.5, colour=_FAINT),
            _text(breast.volume, size=22, bold=True),
            _text(breast.interval, size=9, colour=_ACCENT),
            *_facts(breast.facts[:4]),
        ]
        for breast in content.breasts
    ]
    if content.comparison:
        cards.append([_text("Both sides", size=9.5, colour=_FAINT), *_facts(content.comparison)])
    if cards:
        yield _side_by_side(cards, width)
        yield Spacer(0, 8)
    else:
        yield _text("This session shows an open surface: there is no volume to measure.")
    measure, surface = content.pictures.get("measure", {}), content.pictures.get("surface", {})
    overview = measure.get("overview", surface.get("views"))
    if overview is not None:
        yield _picture(overview, width, 290)
    for breast in content.breasts:
        yield _text(f"{breast.title}: what was measured", size=12, bold=True, before=10)
        yield from _facts(
            [
                Fact(label="Boundary", value=breast.boundary),
                Fact(label="Chest wall", value=breast.wall),
                Fact(label="Interval", value=breast.interval_note),
                *breast.facts[4:],
            ]
        )
        shown = [measure[name] for name in (f"closed-{breast.name}", f"sections-{breast.name}") if name in measure]
        yield from _pictures(shown, width, 150)


def _for_the_technician(content: ReportContent, width: float) -> Iterator[Any]:
    """Each stage in numbers and in one or two pictures."""
    from reportlab.platypus import PageBreak

    yield PageBreak()
    yield _text("For the technician", size=14, bold=True)
    for stage in content.stages:
        yield _text(stage.title, size=11, bold=True, before=6)
        yield from _facts(stage.facts, size=7.5)
        for table in stage.tables:
            yield _table(table, width)
    drawn = {name: png for pictures in content.pictures.values() for name, png in pictures.items()}
    yield from _pictures([drawn[name] for name in _TECHNICIAN if name in drawn], width, 175)
    changed = content.changed_settings or (Fact(label="Settings", value="all as recommended"),)
    yield _text("Frame, times, settings, versions", size=11, bold=True, before=6)
    timings = ", ".join(f"{fact.label} {fact.value}" for fact in content.timings)
    versions = ", ".join(f"{fact.label} {fact.value}" for fact in content.versions)
    held = Fact(label="This document holds", value=f"{content.contains}.")
    facts = [held, Fact(label="World frame", value=content.world), *changed, Fact(label="Versions", value=versions)]
    if timings:
        facts.insert(2, Fact(label="Times", value=timings))
    yield from _facts(facts, size=7.5)


def _text(words: str, *, size: float = 8.5, bold: bool = False, colour: str = INK, before: float = 0.0) -> Any:
    from reportlab.lib.styles import ParagraphStyle
    from reportlab.platypus import Paragraph

    style = ParagraphStyle(
        "text",
        fontName="DejaVu-Bold" if bold else "DejaVu",
        fontSize=size,
        leading=1.3 * size,
        textColor=colour,
        spaceBefore=before,
        spaceAfter=0.15 * size,
        splitLongWords=1,
    )
    return Paragraph(escape(words), style)


def _facts(facts: Sequence[Fact], size: float = 8.0) -> Iterator[Any]:
    from reportlab.lib.styles import ParagraphStyle
    from reportlab.platypus import Paragraph

    style = ParagraphStyle("fact", fontName="DejaVu", fontSize=size, leading=1.3 * size, textColor=INK, spaceAfter=1.5)
    for fact in facts:
        label = f'<font color="{_FAINT}">{escape(fact.label)}:</font>'
        yield Paragraph(f"{label} {escape(fact.value)}", style)


def _table(table: Table, width: float) -> Any:
    from reportlab.lib.styles import ParagraphStyle
    from reportlab.platypus import Paragraph, TableStyle
    from reportlab.platypus import Table as Grid

    size = 6.5
    style = ParagraphStyle("cell", fontName="DejaVu", fontSize=size, leading=1.2 * size, textColor=INK)
    faint = ParagraphStyle("head", parent=style, textColor=_FAINT)
    rows = [[Paragraph(escape(name), faint) for name in table.columns]]
    rows += [[Paragraph(escape(cell), style) for cell in row] for row in table.rows]
    lined = TableStyle(
        [
            ("LINEBELOW", (0, 0), (-1, -1), 0.4, _LINE),
            ("VALIGN", (0, 0), (-1, -1), "TOP"),
            *((f"{side}PADDING", (0, 0), (-1, -1), 1.6) for side in ("TOP", "BOTTOM", "LEFT", "RIGHT")),
        ]
    )
    return Grid(rows, colWidths=[width / len(table.columns)] * len(table.columns), style=lined, spaceBefore=3)


def _side_by_side(cells: Sequence[Sequence[Any]], width: float) -> Any:
    """Cells of equal width in one row."""
    from reportlab.platypus import Table as Grid
    from reportlab.platypus import TableStyle

    style = TableStyle(
        [
            ("VALIGN", (0, 0), (-1, -1), "TOP"),
            ("BOX", (0, 0), (-1, -1), 0.5, _LINE),
            ("INNERGRID", (0, 0), (-1, -1), 0.5, _LINE),
            *((f"{side}PADDING", (0, 0), (-1, -1), 6) for side in ("TOP", "BOTTOM", "LEFT", "RIGHT")),
        ]
    )
    return Grid([[list(cell) for cell in cells]], colWidths=[width / len(cells)] * len(cells), style=style)


def _box(words: Sequence[Any], width: float, *, ground: str, edge: str) -> Any:
    from reportlab.platypus import Table as Grid
    from reportlab.platypus import TableStyle

    style = TableStyle(
        [
            ("BACKGROUND", (0, 0), (-1, -1), ground),
            ("LINEBEFORE", (0, 0), (0, -1), 3, edge),
            *((f"{side}PADDING", (0, 0), (-1, -1), 5) for side in ("TOP", "BOTTOM", "RIGHT")),
            ("LEFTPADDING", (0, 0), (-1, -1), 9),
        ]
    )
    return Grid([[list(words)]], colWidths=[width], style=style)


def _pictures(pngs: Sequence[bytes], width: float, height: float) -> Iterator[Any]:
    """Pictures two a row, each under its title."""
    from reportlab.platypus import Table as Grid
    from reportlab.platypus import TableStyle

    half = 0.5 * width - 4
    bare = TableStyle(
        [
            ("VALIGN", (0, 0), (-1, -1), "TOP"),
            *((f"{side}PADDING", (0, 0), (-1, -1), 2) for side in ("TOP", "BOTTOM", "LEFT", "RIGHT")),
        ]
    )
    for start in range(0, len(pngs), 2):
        row = [
            [_text(caption_of(png).title, size=8, bold=True), _picture(png, half, height)]
            for png in pngs[start : start + 2]
        ]
        yield Grid([row], colWidths=[0.5 * width] * len(row), style=bare, hAlign="LEFT", spaceBefore=4)


def _picture(png: bytes, width: float, height: float) -> Any:
    """A picture fitted into a room, in points, with no more pixels than a printer shows."""
    from reportlab.platypus import Image as Placed

    with Image.open(io.BytesIO(png)) as opened:
        image = Image.fromarray(np.asarray(opened.convert("RGB")))  # without any metadata
    image.thumbnail((_PICTURE_PX, _PICTURE_PX))
    buffer = io.BytesIO()
    image.save(buffer, format="JPEG", quality=88, subsampling=0)
    scale = min(width / image.width, height / image.height)
    return Placed(buffer, image.width * scale, image.height * scale)


def _footer(content: ReportContent, margin: float) -> Callable[[Any, Any], None]:
    def draw(canvas: Any, document: Any) -> None:
        canvas.saveState()
        canvas.setFont("DejaVu", 6)
        canvas.setFillColor(_FAINT)
        canvas.drawString(margin, 0.55 * margin, DISCLAIMER)
        canvas.drawRightString(document.pagesize[0] - margin, 0.55 * margin, f"{content.title} · {document.page}")
        canvas.restoreState()

    return draw


@lru_cache(maxsize=1)
def _register_fonts() -> None:
    """DejaVu, which Matplotlib brings along, has every sign that we use: ± σ ² − °."""
    from matplotlib import get_data_path
    from reportlab.pdfbase.pdfmetrics import registerFont
    from reportlab.pdfbase.ttfonts import TTFont

    folder = Path(get_data_path()) / "fonts" / "ttf"
    registerFont(TTFont("DejaVu", folder / "DejaVuSans.ttf"))
    registerFont(TTFont("DejaVu-Bold", folder / "DejaVuSans-Bold.ttf"))
