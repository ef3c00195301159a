"""Elements of PDF documents: paragraphs, facts, tables, pictures on A4."""

import io
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

from PIL import Image

from mammometry.base.letters import isolated
from mammometry.report.content import DISCLAIMER, Fact, ReportPicture
from mammometry.report.figures.canvas import INK
from mammometry.study.tables import TextTable

_MARGIN_MM = 14.0  # margin of the page; appearance only
_FOOTER_SIZE = 6.0  # points; smaller than all text above it
ACCENT, FAINT = "#005a8e", "#586573"
WARN = "#8a5a00"
_LINE, _EDGE, _WARN_GROUND = "#dde2e8", "#d08700", "#fff4dc"


def document(title: str, subject: str, story: Callable[[float], Iterable[Any]]) -> bytes:
    """A document as bytes. The same content gives the same bytes.

    Args:
        title: title of the document, repeated at the foot of each page.
        subject: subject of the document.
        story: width of a page's text, points → content.
    """
    return _built(title, subject, lambda width, height: story(width))[0]


def fitted(
    title: str, subject: str, stories: Sequence[Callable[[float, float], Iterable[Any]]], *, most_pages: int
) -> bytes:
    """The first of several documents that has few enough pages, or else the last one.

    Args:
        title: title of the document.
        subject: subject of the document.
        stories: width and height of a page's text, points → content.
        most_pages: largest number of pages.
    """
    made = b""
    for story in stories:
        made, pages = _built(title, subject, story)
        if pages <= most_pages:
            break
    return made


def _built(title: str, subject: str, story: Callable[[float, float], Iterable[Any]]) -> tuple[bytes, int]:
    """A document's bytes, and the number of its pages."""
    from reportlab.lib.pagesizes import A4
    from reportlab.lib.units import mm
    from reportlab.platypus import BaseDocTemplate, Frame, PageTemplate

    _prepare()
    margin = _MARGIN_MM * mm
    width, height = A4[0] - 2 * margin, A4[1] - 2 * margin
    buffer = io.BytesIO()
    made = BaseDocTemplate(
        buffer,
        pagesize=A4,
        title=f"{title}: mammometry",
        author="mammometry",
        subject=subject,
        lang="en",
        invariant=True,
    )
    frame = Frame(margin, margin, width, height, 0, 0, 0, 0)
    made.addPageTemplates(PageTemplate(frames=[frame], onPage=_footer(title, margin)))
    made.build([*story(width, height)])
    return buffer.getvalue(), int(made.page)


def text(
    words: str,
    *,
    size: float = 8.5,
    bold: bool = False,
    colour: str = INK,
    before: float = 0.0,
    leading: float | None = None,
    square: str = "",
) -> Any:
    """A paragraph. Sizes in points.

    Args:
        words: its text.
        size: size of the letters.
        bold: whether they are bold.
        colour: colour of the letters.
        before: space above it.
        leading: distance between lines. None: depends on the size.
        square: colour of a square before the text. Empty: no square.
    """
    from reportlab.lib.styles import ParagraphStyle

    from mammometry.report.documents.letters.lines import paragraph

    _prepare()
    style = ParagraphStyle(
        "text",
        fontName="DejaVu-Bold" if bold else "DejaVu",
        fontSize=size,
        leading=leading or 1.3 * size,
        textColor=colour,
        spaceBefore=before,
        spaceAfter=0.15 * size,
        splitLongWords=1,
    )
    mark = f'<font color="{square}">■</font> ' if square else ""
    return paragraph(_marked(words), style, is_bold=bold, label="■ " if square else "", label_markup=mark)


def _marked(words: str) -> str:
    """Text for a PDF: commands without their `backticks`."""
    return words.replace("`", "")


def facts(lines: Sequence[Fact], size: float = 8.0) -> Iterator[Any]:
    """One line per fact: label and value."""
    from reportlab.lib.styles import ParagraphStyle

    from mammometry.report.documents.letters.lines import paragraph

    _prepare()
    style = ParagraphStyle("fact", fontName="DejaVu", fontSize=size, leading=1.3 * size, textColor=INK, spaceAfter=1.5)
    for fact in lines:
        markup = f'<font color="{FAINT}">{escape(fact.label)}:</font> '
        yield paragraph(_marked(fact.value), style, label=f"{fact.label}: ", label_markup=markup)


def table(data: TextTable, width: float, *, size: float = 6.5, first: float | None = None) -> Any:
    """A table of the given width, points.

    Args:
        data: columns and rows.
        width: width of the table.
        size: size of its text.
        first: share of the width for the first column. None: all columns have the same width.
    """
    from reportlab.lib.styles import ParagraphStyle

    from mammometry.report.documents.letters.lines import paragraph

    _prepare()
    style = ParagraphStyle("cell", fontName="DejaVu", fontSize=size, leading=1.2 * size, textColor=INK)
    faint = ParagraphStyle("head", parent=style, textColor=FAINT)
    rows = [[paragraph(name, faint) for name in data.columns]]
    rows += [[paragraph(cell, style) for cell in row] for row in data.rows]
    count = len(data.columns)
    share = 1 / count if first is None else first
    widths = [share * width, *[(1 - share) * width / max(count - 1, 1)] * (count - 1)]
    below = ("LINEBELOW", (0, 0), (-1, -1), 0.4, _LINE)
    return _grid(rows, widths, 0.18 * size, below, spaceBefore=3)


def columns(cells: Sequence[Sequence[Any]], widths: Sequence[float], *, gap: float = 0.0) -> Any:
    """Cells of given widths in one row, without lines, with `gap` points between them."""
    apart = ("RIGHTPADDING", (0, 0), (-2, -1), gap)
    return _grid([[list(cell) for cell in cells]], list(widths), 0, apart, hAlign="LEFT")


def _grid(rows: list[list[Any]], widths: Sequence[float], padding: float, *commands: Any, **options: Any) -> Any:
    """A table with equal padding on all sides of its cells, and further style commands."""
    from reportlab.platypus import Table as Grid
    from reportlab.platypus import TableStyle

    sides = [(f"{side}PADDING", (0, 0), (-1, -1), padding) for side in ("TOP", "BOTTOM", "LEFT", "RIGHT")]
    style = TableStyle([("VALIGN", (0, 0), (-1, -1), "TOP"), *sides, *commands])
    return Grid(rows, colWidths=widths, style=style, **options)


def line(width: float) -> Any:
    """A thin line across the page."""
    from reportlab.platypus import HRFlowable

    return HRFlowable(width=width, thickness=0.6, color=_LINE, spaceBefore=3, spaceAfter=4)


def signature_line(width: float, room: float) -> Iterator[Any]:
    """An empty line for a signature, with space above it. Points."""
    from reportlab.platypus import HRFlowable, Spacer

    yield Spacer(0, 22 + room)
    yield HRFlowable(width=width, thickness=0.6, color=FAINT, spaceBefore=0, spaceAfter=2)
    yield text("name, date, signature", size=7, colour=FAINT)


def height_of(flowables: Sequence[Any], width: float) -> float:
    """Height of these elements in a column, including the space between them, points."""
    heights = [
        flowable.wrap(width, 1e6)[1] + flowable.getSpaceBefore() + flowable.getSpaceAfter() for flowable in flowables
    ]
    return float(sum(heights))


def side_by_side(cells: Sequence[Sequence[Any]], width: float) -> Any:
    """Cells of equal width in one row."""
    lines = [(kind, (0, 0), (-1, -1), 0.5, _LINE) for kind in ("BOX", "INNERGRID")]
    return _grid([[list(cell) for cell in cells]], [width / len(cells)] * len(cells), 6, *lines)


def box(words: Sequence[Any], width: float) -> Any:
    """A warning: paragraphs on a coloured background with a border on the left."""
    ground, edge = ("BACKGROUND", (0, 0), (-1, -1), _WARN_GROUND), ("LINEBEFORE", (0, 0), (0, -1), 3, _EDGE)
    return _grid([[list(words)]], [width], 5, ground, edge, ("LEFTPADDING", (0, 0), (-1, -1), 9))


def pictures(shown: Sequence[ReportPicture], width: float, height: float) -> Iterator[Any]:
    """Pictures in rows of two, each below its title."""
    half = 0.5 * width - 4
    for start in range(0, len(shown), 2):
        row = [
            [text(item.title, size=8, bold=True), picture(item.jpeg, half, height)] for item in shown[start : start + 2]
        ]
        yield _grid([row], [0.5 * width] * len(row), 2, hAlign="LEFT", spaceBefore=4)


def picture(jpeg: bytes, width: float, height: float) -> Any:
    """A JPEG scaled to fit into a box, points."""
    from reportlab.platypus import Image as Placed

    with Image.open(io.BytesIO(jpeg), formats=("JPEG",)) as opened:
        image_width, image_height = opened.size
    scale = min(width / image_width, height / image_height)
    return Placed(io.BytesIO(jpeg), image_width * scale, image_height * scale)


def _footer(title: str, margin: float) -> Callable[[Any, Any], None]:
    from mammometry.report.documents.letters.lines import in_order, pieces

    def draw(canvas: Any, document: Any) -> None:
        canvas.saveState()
        canvas.setFont("DejaVu", _FOOTER_SIZE)
        canvas.setFillColor(FAINT)
        canvas.drawString(margin, 0.55 * margin, DISCLAIMER)
        named = in_order(pieces(f"{isolated(title)} · {document.page}", "DejaVu", is_bold=False))
        left = document.pagesize[0] - margin - sum(piece.width(_FOOTER_SIZE) for piece in named)
        for piece in named:
            canvas.setFont(piece.font, _FOOTER_SIZE)
            canvas.drawString(left, 0.55 * margin, piece.text)
            left += piece.width(_FOOTER_SIZE)
        canvas.restoreState()

    return draw


@lru_cache(maxsize=1)
def _prepare() -> None:
    """Register DejaVu, and store pictures as bytes instead of ASCII.

    DejaVu is part of Matplotlib and has every sign that we use: ± σ ² − °.
    """
    from matplotlib import get_data_path
    from reportlab import rl_config
    from reportlab.pdfbase.pdfmetrics import registerFont
    from reportlab.pdfbase.ttfonts import TTFont

    rl_config.useA85 = 0  # a fifth smaller, and much faster
    folder = Path(get_data_path()) / "fonts" / "ttf"
    registerFont(TTFont("DejaVu", folder / "DejaVuSans.ttf"))
    registerFont(TTFont("DejaVu-Bold", folder / "DejaVuSans-Bold.ttf"))
