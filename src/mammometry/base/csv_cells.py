"""CSV in which no cell is interpreted as a formula.

Spreadsheets compute cells that start with = + - or @, and such a formula may fetch a web address. A leading apostrophe
marks such cells as text. Numbers stay numbers, including negative ones.

Spreadsheets in countries with a decimal comma split the file at every semicolon, also inside a cell whose quotes do not
start it: the second half of ``a;=1+1`` would be a formula. The same applies to tabs, vertical bars and line ends. So
the text after each of them is treated like a new cell.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterable
from typing import Protocol

_BEGINS_A_FORMULA = tuple("=+-@\t\n＝＋－＠")
"""The last four are the full-width forms, which some spreadsheets accept too (OWASP, CSV Injection)."""
_NEGATIVE = r"-[0-9]+(?:\.[0-9]+)?(?:[;|\t\n]|$)"
_WITHIN = re.compile(rf'(?<=[;|\t\n])(?=[\s"]*[=+\-@＝＋－＠])(?![\s"]*{_NEGATIVE})')
"""Positions at which part of a cell starts a formula. Negative numbers are not formulas."""
_PLAIN = re.compile(r"[\w.\-]*")
"""Text that no program splits or interprets."""
_NUMBER = re.compile(r"-[0-9]+(\.[0-9]+)?([eE][+-]?[0-9]+)?")


def harmless(cell: object) -> str | int | float:
    """Return a cell that no spreadsheet interprets as a formula. None becomes an empty cell."""
    if cell is None:
        return ""
    if isinstance(cell, int | float):
        return cell
    # Some readers would end the row at a carriage return.
    text = str(cell).replace("\r\n", "\n").replace("\r", "\n")
    text = _WITHIN.sub("'", text)
    return f"'{text}" if text.startswith(_BEGINS_A_FORMULA) and not _NUMBER.fullmatch(text) else text


class _Text(Protocol):
    """A file or an HTTP response."""

    def write(self, text: str, /) -> object: ...


class CsvWriter:
    """Writes rows of harmless cells. Each line ends with LF.

    Text is quoted unless it is a single word or number, so that programs detect the separator correctly.
    """

    def __init__(self, file: _Text) -> None:
        self._file = file

    def row(self, cells: Iterable[object]) -> None:
        """Write one row."""
        self._file.write(",".join(map(_quoted, cells)) + "\n")


def _quoted(cell: object) -> str:
    text = str(harmless(cell))
    return text if _PLAIN.fullmatch(text) else '"' + text.replace('"', '""') + '"'


def csv_text(columns: Iterable[object], rows: Iterable[Iterable[object]]) -> str:
    """Return a whole table as text."""
    file = io.StringIO()
    writer = CsvWriter(file)
    writer.row(columns)
    for row in rows:
        writer.row(row)
    return file.getvalue()
