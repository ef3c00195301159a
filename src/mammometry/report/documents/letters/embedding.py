"""The shapes of `shaping` as a font for ReportLab.

A document embeds only the shapes that it uses, and the letters that they represent, for searching and copying text.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakKeyDictionary

from mammometry.report.documents.letters.shaping import EM, Cluster, cluster_of

NAME = "Shaped"
"""Name of the font. Its texts consist of the codes from `shaping.shaped`."""
_MOST = 255  # most shapes of one font in the file: its codes are bytes, and 0 is the missing glyph
_CURVE_ERROR = 0.5  # largest error of quadratic curves, units of the em: invisible in print at 24 points
_ASCENT, _DESCENT = (
    880,
    -300,
)  # similar to Noto Sans CJK and Devanagari, units of the em; PDF readers use it for selections
_SYMBOLIC = 4  # flag of a font with its own encoding (PDF 32000-1, table 123)
_SYMBOL_CODES = 0xF000  # first code of a symbolic TrueType font (9.6.6.4)


@dataclass(slots=True)
class _Used:
    """The part of the font that one document uses."""

    name: str = ""
    """The font's name inside the document. Empty: not used yet."""
    places: dict[str, int] = field(default_factory=dict)
    """Position of each code, in order of first use."""


class _Face:
    """A font's design for ReportLab."""

    name = NAME
    ascent, descent = _ASCENT, _DESCENT


class ShapedFont:
    """A font for ReportLab. Its documents do not affect each other."""

    fontName = NAME
    face = _Face()
    substitutionFonts = ()
    shapable = False
    _multiByte = _dynamicFont = 1

    def __init__(self) -> None:
        self._of: WeakKeyDictionary[Any, _Used] = WeakKeyDictionary()

    def stringWidth(self, text: str, size: float, encoding: str = "utf8") -> float:
        """Width of a text made of codes, points."""
        return sum(cluster_of(code).advance for code in text) * size / EM

    def splitString(self, text: str, document: Any, encoding: str = "utf8") -> list[tuple[int, bytes]]:
        """Font in the file, and bytes, for each run of a text made of codes."""
        places = self._of.setdefault(document, _Used()).places
        runs: list[tuple[int, bytes]] = []
        for code in text:
            subset, byte = divmod(places.setdefault(code, len(places)), _MOST)
            if runs and runs[-1][0] == subset:
                runs[-1] = (subset, runs[-1][1] + bytes([byte + 1]))
            else:
                runs.append((subset, bytes([byte + 1])))
        return runs

    def getSubsetInternalName(self, subset: int, document: Any) -> str:
        """Name of one of the fonts in the file."""
        used = self._of.setdefault(document, _Used())
        if not used.name:
            used.name = f"F{len(document.fontMapping) + 1}"
            document.fontMapping[NAME] = f"/{used.name}"
            document.delayedFonts.append(self)
        return f"/{used.name}+{subset}"

    def addObjects(self, document: Any) -> None:
        """Write the fonts. Called when all text is known."""
        used = self._of.pop(document)
        codes = list(used.places)
        for subset, first in enumerate(range(0, len(codes), _MOST)):
            clusters = [cluster_of(code) for code in codes[first : first + _MOST]]
            _add(document, f"{used.name}+{subset}", _tag(subset), clusters)


def _tag(subset: int) -> str:
    """Six capital letters, which PDF requires before the name of a subset font."""
    return "".join(chr(ord("A") + subset // 26**place % 26) for place in range(5, -1, -1))


def _add(document: Any, name: str, tag: str, clusters: Sequence[Cluster]) -> None:
    from reportlab.pdfbase import pdfdoc

    base = f"{tag}+{NAME}"
    program = pdfdoc.PDFStream(content=_true_type(clusters), filters=[pdfdoc.PDFZCompress])
    program.dictionary["Length1"] = len(program.content)
    descriptor = pdfdoc.PDFDictionary(
        {
            "Type": "/FontDescriptor",
            "FontName": pdfdoc.PDFName(base),
            "Flags": _SYMBOLIC,
            "FontBBox": pdfdoc.PDFArray([0, _DESCENT, EM, _ASCENT]),
            "Ascent": _ASCENT,
            "Descent": _DESCENT,
            "CapHeight": _ASCENT,
            "ItalicAngle": 0,
            "StemV": 80,
            "FontFile2": document.Reference(program, f"fontFile:{base}"),
        }
    )
    to_unicode = pdfdoc.PDFStream(content=_to_unicode(base, clusters), filters=[pdfdoc.PDFZCompress])
    font = pdfdoc.PDFTrueTypeFont()
    font.Name, font.BaseFont = name, base
    font.FirstChar, font.LastChar = 0, len(clusters)
    font.Widths = pdfdoc.PDFArray([0, *(cluster.advance for cluster in clusters)])
    font.ToUnicode = document.Reference(to_unicode, f"toUnicodeCMap:{base}")
    font.FontDescriptor = document.Reference(descriptor, f"fontDescriptor:{base}")
    document.Reference(font, name)
    document.idToObject["BasicFonts"].dict[name] = font


def _to_unicode(base: str, clusters: Sequence[Cluster]) -> bytes:
    """Letters of each code, for readers that search and copy (PDF 32000-1, 9.10.3)."""
    lines = [
        f"<{place:02X}> <{cluster.text.encode('utf-16-be').hex().upper()}>" for place, cluster in enumerate(clusters, 1)
    ]
    blocks = [lines[start : start + 100] for start in range(0, len(lines), 100)]  # a block contains at most 100
    return "\n".join(
        [
            "/CIDInit /ProcSet findresource begin 12 dict begin begincmap",
            "/CIDSystemInfo << /Registry (Adobe) /Ordering (UCS) /Supplement 0 >> def",
            f"/CMapName /{base} def /CMapType 2 def",
            "1 begincodespacerange <00> <FF> endcodespacerange",
            *(f"{len(block)} beginbfchar\n" + "\n".join(block) + "\nendbfchar" for block in blocks),
            "endcmap CMapName currentdict /CMap defineresource pop end end",
        ]
    ).encode("ascii")


def _true_type(clusters: Sequence[Cluster]) -> bytes:
    """A TrueType font with one glyph per cluster, coded from 1. The same clusters give the same bytes."""
    from fontTools.fontBuilder import FontBuilder
    from fontTools.pens.cu2quPen import Cu2QuPen
    from fontTools.pens.ttGlyphPen import TTGlyphPen

    names = [".notdef", *(f"c{place}" for place in range(1, len(clusters) + 1))]
    glyphs = {".notdef": TTGlyphPen(None).glyph()}
    for name, cluster in zip(names[1:], clusters, strict=True):
        pen = TTGlyphPen(None)
        cluster.draw(Cu2QuPen(pen, max_err=_CURVE_ERROR, all_quadratic=True))
        glyphs[name] = pen.glyph()
    made = FontBuilder(EM, isTTF=True)
    made.setupGlyphOrder(names)
    made.setupCharacterMap({_SYMBOL_CODES + place: name for place, name in enumerate(names) if place})
    made.setupGlyf(glyphs)
    advances = dict(zip(names, [0, *(cluster.advance for cluster in clusters)], strict=True))
    made.setupHorizontalMetrics({name: (advances[name], getattr(glyphs[name], "xMin", 0)) for name in names})
    made.setupHorizontalHeader(ascent=_ASCENT, descent=_DESCENT)
    made.setupNameTable({"familyName": NAME, "styleName": "Regular"})
    made.setupOS2()
    made.setupPost(keepGlyphNames=False)
    made.updateHead(created=0, modified=0)
    made.font.recalcTimestamp = False
    written = io.BytesIO()
    made.save(written)
    return written.getvalue()
