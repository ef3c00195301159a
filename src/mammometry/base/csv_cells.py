"""CSV in which no cell is read as a formula.

A spreadsheet computes cells that begin with = + - or @, and such a formula may fetch a web address. Such text gets a
leading apostrophe, which marks it as text. Numbers stay numbers, also negative ones.

Spreadsheets in countries with a decimal comma split our file at every semicolon, also inside quotes that do not begin a
cell: the second half of ``a;=1+1`` would be a formula. The same holds for tabs, bars and line ends. So the text after
each of them is treated as a new cell.
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
"""Positions at which a part of a cell begins a formula. A negative number is not a formula."""
_PLAIN = re.compile(r"[\w.\-]*")
"""Text that no program splits."""
_NUMBER = re.compile(r"-[0-9]+(\.[0-9]+)?([eE][+-]?[0-9]+)?")


def harmless(cell: object) -> str | int | float:
    """Return a cell that no spreadsheet reads as a formula. None becomes an empty cell."""
    if cell is None:
        return ""
    if isinstance(cell, int | float):
        return cell
    # Readers would end the row at a carriage return.
    text = str(cell).replace("\r\n", "\n").replace("\r", "\n")
    text = _WITHIN.sub("'", text)
    return f"'{text}" if text.startswith(_BEGINS_A_FORMULA) and not _NUMBER.fullmatch(text) else text


class _Text(Protocol):
    """A file or an HTTP response."""

    def write(self, text: str, /) -> object: ...


class CsvWriter:
    """Writes rows of harmless cells, each line ending with LF.

    Text is quoted unless it is one word or number, so that programs guess the separator correctly.
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
