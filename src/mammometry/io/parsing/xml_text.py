"""XML of other programs, read without what can do harm."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from mammometry.base.parse import parsing, read_text

_MOST_MIB = 16  # a large project of photogrammetry has some MiB of cameras


def read_xml(path: Path, expected: str) -> ElementTree.Element:
    """Read the root of an XML file. Declarations are refused: a few entities unfold to gigabytes.

    Raises:
        SessionError: it cannot be read, or is no such XML.
    """
    text = read_text(path, path.name, expected, most_mib=_MOST_MIB).lstrip()
    with parsing("a file that cannot be parsed", path.name, expected):
        if "<!" in text.replace("<!--", ""):
            raise ValueError("a declaration, <!…>")
        try:
            return ElementTree.fromstring(text)
        except ElementTree.ParseError as error:
            raise ValueError(str(error)) from None
