"""Shaping of text: select a font that has the letters, and join and place them with HarfBuzz."""

from __future__ import annotations

import itertools
import threading
import unicodedata
from collections.abc import Iterator, Sequence
from functools import cache, lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeAlias

from mammometry.base.errors import SettingsError
from mammometry.base.value import value
from mammometry.report.documents.letters.direction import MIRRORED

EM = 1000
"""Units per em, the same for all fonts. PDF measures letters in thousandths of the font's size."""
_REGULAR, _BOLD = 400.0, 700.0  # positions on OpenType's weight axis
_LATIN, _SYMBOLS, _EMOJI = "NotoSans[wght].ttf", "NotoSansSymbols[wght].ttf", "NotoEmoji[wght].ttf"
_CJK = "NotoSansCJK-VF.otf.ttc"
_FIRST_CODE = 0xF0000  # private use area, since codes of shapes are not letters
_SHOWN_LETTERS = 5  # number of unprintable letters that an error lists

Shape: TypeAlias = "tuple[tuple[int, int, int], ...]"
"""Glyph, and its position to the right of and above the shape's origin, units of `EM`."""


@value
class Cluster:
    """Shape that represents one or more letters, in one font."""

    text: str
    """The letters, in reading order, with mirrored brackets."""
    font: Path
    """The font's file."""
    is_bold: bool
    shape: Shape
    advance: int
    """Width, units of `EM`."""

    def draw(self, pen: Any) -> None:
        """Draw the outlines with a pen of fontTools. The origin is at the left end of the baseline."""
        from fontTools.pens.transformPen import TransformPen

        font = _font(self.font, self.is_bold)
        for glyph, right, up in self.shape:
            font.draw_glyph_with_pen(glyph, TransformPen(pen, (1, 0, 0, 1, right, up)))


# Shared by all documents of this process. There are as many as different syllables in names.
_clusters: dict[int, Cluster] = {}
_codes: dict[Cluster, int] = {}
_free = itertools.count(_FIRST_CODE)
_lock = threading.Lock()


def cluster_of(code: str) -> Cluster:
    """Cluster of a code from `shaped`.

    Any other letter, such as a space, represents itself.
    """
    return _clusters.get(ord(code)) or _clusters[ord(shaped(code, is_bold=False, right_to_left=False))]


def shaped(word: str, *, is_bold: bool, right_to_left: bool) -> str:
    """Codes of a word's clusters from left to right, one character each (see `cluster_of`).

    Args:
        word: letters of one direction, in reading order.
        is_bold: whether it is drawn in bold.
        right_to_left: whether it runs from right to left.

    Raises:
        SettingsError: no font has one of the letters, which it names.
    """
    runs = [_shaped(text, font, is_bold, right_to_left) for text, font in _runs(unicodedata.normalize("NFC", word))]
    return "".join(_code(cluster) for run in (reversed(runs) if right_to_left else runs) for cluster in run)


def is_plain(word: str) -> bool:
    """Whether DejaVu has all letters of a word, and none needs joining or stacking."""
    return all(map(_is_plain_letter, word))


@lru_cache(maxsize=4096)  # more than there are in a clinic's documents
def _is_plain_letter(letter: str) -> bool:
    return (
        letter <= "\uffff"  # with ReportLab's own fonts, other letters could not be copied from the PDF
        and _has(_dejavu(False), [ord(letter)])
        and not unicodedata.category(letter).startswith("M")
        and unicodedata.bidirectional(letter) not in ("R", "AL", "AN")
    )


def _code(cluster: Cluster) -> str:
    with _lock:
        code = _codes.get(cluster)
        if code is None:
            code = _codes[cluster] = next(_free)
            _clusters[code] = cluster
    return chr(code)


def _shaped(text: str, font: Path, is_bold: bool, right_to_left: bool) -> list[Cluster]:
    """Clusters of letters in one font, from left to right."""
    import uharfbuzz

    buffer = uharfbuzz.Buffer()
    buffer.add_str(text)
    buffer.guess_segment_properties()
    buffer.direction = "rtl" if right_to_left else "ltr"
    buffer.language = "en"  # the default is the machine's language, which would affect the document
    uharfbuzz.shape(_font(font, is_bold), buffer)
    glyphs = list(zip(buffer.glyph_infos, buffer.glyph_positions, strict=True))
    starts = sorted({info.cluster for info, _ in glyphs})
    ends = dict(zip(starts, [*starts[1:], len(text)], strict=True))
    clusters = []
    for start, members in itertools.groupby(glyphs, key=lambda glyph: glyph[0].cluster):
        shape, across = [], 0
        for info, position in members:
            shape.append((info.codepoint, across + position.x_offset, position.y_offset))
            across += position.x_advance
        letters = text[start : ends[start]]
        clusters.append(
            Cluster(
                text=letters.translate(MIRRORED) if right_to_left else letters,
                font=font,
                is_bold=is_bold,
                shape=tuple(shape),
                advance=across,
            )
        )
    return clusters


def _runs(word: str) -> Iterator[tuple[str, Path]]:
    """Parts of a word, each with a font that has all its letters. One part if one font has the whole word."""
    if (font := _font_file(word)) is not None:
        yield word, font
        return
    parts = [(part, _font_file(part)) for part in _with_marks(word)]
    lacking = [part for part, font in parts if font is None]
    if lacking:
        raise _unprintable("".join(lacking))
    for font, run in itertools.groupby(parts, key=lambda part: part[1]):
        assert font is not None
        yield "".join(part for part, _ in run), font


def _with_marks(word: str) -> list[str]:
    """Each letter together with the marks and joiners after it."""
    parts: list[str] = []
    for letter in word:
        if parts and (unicodedata.category(letter)[0] == "M" or _is_ignored(letter)):
            parts[-1] += letter
        else:
            parts.append(letter)
    return parts


def _is_ignored(letter: str) -> bool:
    """Whether a letter only modifies others: a joiner, or a selector of a variant."""
    return unicodedata.category(letter) == "Cf" or unicodedata.name(letter, "").startswith("VARIATION SELECTOR")


def _unprintable(letters: str) -> SettingsError:
    named = [f"U+{ord(letter):04X} {unicodedata.name(letter, 'without a name')}" for letter in dict.fromkeys(letters)]
    more = f" and {len(named) - _SHOWN_LETTERS} more" if len(named) > _SHOWN_LETTERS else ""
    return SettingsError(
        "the document",
        found=f"{', '.join(named[:_SHOWN_LETTERS])}{more}",
        expected="letters that can be printed",
        remedy="Install a font that has them on this machine, or write the text with other letters",
    )


def _font_file(letters: str) -> Path | None:
    """First font that has all of these letters. None if no included or installed font has."""
    wanted = [ord(letter) for letter in letters if not _is_ignored(letter)]
    return next((file for file in _files() if _has(file, wanted)), None) or next(
        (file for file in _files_of_machine() if _has(file, wanted)), None
    )


def _has(file: Path, letters: Sequence[int]) -> bool:
    return all(_font(file, False).get_nominal_glyph(letter) is not None for letter in letters)


@lru_cache(maxsize=1)
def _files() -> tuple[Path, ...]:
    """Included fonts in order of preference.

    Mixed words look better in one font of their script, so fonts of symbols come last.
    """
    noto, cjk = (_folder(package) for package in ("manimgx_fonts", "manimgx_fonts_cjk"))
    scripts = sorted(set(noto.glob("NotoSans*.ttf")) - {noto / _LATIN, noto / _SYMBOLS, *noto.glob("*-Italic*")})
    return noto / _LATIN, *scripts, cjk / _CJK, _dejavu(False), noto / _SYMBOLS, noto / _EMOJI


@lru_cache(maxsize=1)
def _files_of_machine() -> tuple[Path, ...]:
    """Fonts installed on this machine, sorted by name."""
    from matplotlib.font_manager import findSystemFonts

    return tuple(sorted(map(Path, findSystemFonts())))


def _folder(package: str) -> Path:
    spec = find_spec(package)
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).parent


def _dejavu(is_bold: bool) -> Path:
    """DejaVu's file, which Matplotlib includes."""
    from matplotlib import get_data_path

    return Path(get_data_path()) / "fonts" / "ttf" / ("DejaVuSans-Bold.ttf" if is_bold else "DejaVuSans.ttf")


@cache
def _font(file: Path, is_bold: bool) -> Any:
    """HarfBuzz's font of a file. Of several faces it uses the first, which is Japanese in Noto Sans CJK."""
    import uharfbuzz

    face = uharfbuzz.Face(uharfbuzz.Blob.from_file_path(str(_dejavu(is_bold) if file == _dejavu(False) else file)))
    font = uharfbuzz.Font(face)
    font.scale = (EM, EM)
    if any(axis.tag == "wght" for axis in face.axis_infos):
        font.set_variations({"wght": _BOLD if is_bold else _REGULAR})
    return font
