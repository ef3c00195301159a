"""Text in lines: words of all scripts in visual order, from left to right."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import groupby
from typing import Any
from unicodedata import bidirectional, category
from xml.sax.saxutils import escape

from reportlab.lib.enums import TA_LEFT, TA_RIGHT
from reportlab.pdfbase.pdfmetrics import registerFont, stringWidth
from reportlab.platypus import Flowable, Paragraph

from mammometry.base.value import value
from mammometry.report.documents.letters import embedding
from mammometry.report.documents.letters.direction import is_right_to_left, levels, reordered
from mammometry.report.documents.letters.shaping import is_plain, shaped

_SLACK = 0.01  # points by which a line must be narrower than the space, so that rounding does not break it again


@value
class Piece:
    """Letters of one font and direction in a line."""

    text: str
    """Letters, or codes of the font's shapes."""
    font: str
    level: int
    """Level from `direction.levels`."""

    def width(self, size: float) -> float:
        """Width at a size of the font, points."""
        return float(stringWidth(self.text, self.font, size))

    @property
    def markup(self) -> str:
        """Markup for a paragraph of ReportLab."""
        if self.font == embedding.NAME:
            return f'<font name="{embedding.NAME}">{self.text}</font>'
        return escape(self.text)


def pieces(line: str, font: str, *, is_bold: bool) -> list[Piece]:
    """Pieces of a line in reading order. Spaces and words are separate pieces.

    Args:
        line: text without line breaks.
        font: ReportLab's name of DejaVu, for words without shaping.
        is_bold: whether the other fonts are bold.

    Raises:
        SettingsError: a letter that no font has.
    """
    _prepare()
    at = levels(line, int(is_right_to_left(line)))
    made = []
    for (is_blank, level), run in groupby(zip(line, at, strict=True), key=lambda item: (item[0].isspace(), item[1])):
        word = "".join(letter for letter, _ in run if not _is_direction_mark(letter))
        if level % 2 == 0 and is_plain(word):
            made.append(Piece(text=word, font=font, level=level))
        elif is_blank:
            made.append(Piece(text=" " * len(word), font=embedding.NAME, level=level))
        else:
            codes = shaped(word, is_bold=is_bold, right_to_left=bool(level % 2))
            made.append(Piece(text=codes, font=embedding.NAME, level=level))
    return made


def in_order(line: Sequence[Piece]) -> list[Piece]:
    """Pieces of one line in order from left to right.

    Neighbours with the same font and level are joined, because PDF readers restore the reading order within a piece.
    """
    from_left = reordered(line, [piece.level for piece in line])
    joined = []
    for (font, level), run in groupby(from_left, key=lambda piece: (piece.font, piece.level)):
        joined.append(Piece(text="".join(piece.text for piece in run), font=font, level=level))
    return joined


def paragraph(words: str, style: Any, *, is_bold: bool = False, label: str = "", label_markup: str = "") -> Any:
    """A paragraph of ReportLab.

    Args:
        words: text, with line breaks.
        style: paragraph style, whose font is DejaVu.
        is_bold: whether this is the bold font.
        label: text before the words in the first line; it runs from left to right.
        label_markup: the same text as markup.

    Raises:
        SettingsError: a letter that no font has.
    """
    lines = [pieces(line, style.fontName, is_bold=is_bold) for line in words.split("\n")]
    if any(bidirectional(letter) in ("R", "AL", "AN") for letter in words):
        return _Directed(lines, style, label, label_markup, [is_right_to_left(line) for line in words.split("\n")])
    return Paragraph(
        label_markup + "<br/>".join("".join(piece.markup for piece in in_order(line)) for line in lines), style
    )


class _Directed(Flowable):  # type: ignore[misc]
    """A paragraph of right-to-left text, broken into lines here, because each line is reordered."""

    def __init__(
        self, lines: Sequence[Sequence[Piece]], style: Any, label: str, label_markup: str, turned: Sequence[bool]
    ) -> None:
        super().__init__()
        self.style, self._lines, self._turned = style, lines, turned
        self._label, self._label_markup = label, label_markup
        self._set: Any = None

    def wrap(self, width: float, height: float) -> tuple[float, float]:
        """Break the text into lines of this width."""
        first = stringWidth(self._label, self.style.fontName, self.style.fontSize)
        broken = []
        for line in self._lines:
            broken += list(_broken(line, width - _SLACK, self.style.fontSize, first))
            first = 0.0
        is_turned = all(self._turned) and len(broken) > 1 and not self._label
        style = self.style.clone("directed", alignment=TA_RIGHT if is_turned else TA_LEFT)
        shown = "<br/>".join("".join(piece.markup for piece in in_order(line)) for line in broken)
        self._set = Paragraph(self._label_markup + shown, style)
        self.width, self.height = self._set.wrap(width, height)
        return self.width, self.height

    def split(self, width: float, height: float) -> list[Any]:
        """Parts for this page and the next."""
        self.wrap(width, height)
        return list(self._set.split(width, height))

    def draw(self) -> None:
        """Draw the lines found by the last `wrap`."""
        self._set.drawOn(self.canv, 0, 0)


def _broken(line: Sequence[Piece], width: float, size: float, used: float) -> Iterator[list[Piece]]:
    """Lines of at most this width, in reading order. `used`: space already used in the first line. Points."""
    current: list[Piece] = []
    for is_blank, run in groupby(line, key=lambda piece: piece.text.isspace()):
        word = list(run)
        across = sum(piece.width(size) for piece in word)
        if not is_blank and current and used + across > width:
            yield current
            current, used = [], 0.0
        if current or not is_blank:
            current += word
            used += across
    yield current


def _is_direction_mark(letter: str) -> bool:
    """Whether a letter only controls direction and is not drawn. Joiners do not count: shaping needs them."""
    return category(letter) == "Cf" and letter not in "\u200c\u200d"


@lru_cache(maxsize=1)
def _prepare() -> None:
    registerFont(embedding.ShapedFont())
