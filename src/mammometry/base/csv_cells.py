"""CSV in which no cell is a formula.

A spreadsheet computes what begins with = + - or @, and may fetch addresses by it. Such text gets an apostrophe in
front, which shows that it is text. Numbers stay numbers, negative ones too.

Where semicolons separate cells, as in spreadsheets of countries with a decimal comma, our file is split at every
semicolon, also within quotes that do not begin a cell: ``a;=1+1`` would be a formula in its second half. The same holds
for tabs, bars and line ends. So the part after each of them is treated as a cell's beginning too.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterable
from typing import Protocol

_BEGINS_A_FORMULA = tuple("=+-@\t\n＝＋－＠")
"""The last four are the full-width forms, which some spreadsheets read alike (OWASP, CSV Injection)."""
_NEGATIVE = r"-[0-9]+(?:\.[0-9]+)?(?:[;|\t\n]|$)"
_WITHIN = re.compile(rf'(?<=[;|\t\n])(?=[\s"]*[=+\-@＝＋－＠])(?![\s"]*{_NEGATIVE})')
"""Places at which a part of a cell begins a formula. A negative number is none."""
_PLAIN = re.compile(r"[\w.\-]*")
"""Text that no program splits."""
_NUMBER = re.compile(r"-[0-9]+(\.[0-9]+)?([eE][+-]?[0-9]+)?")


def harmless(cell: object) -> str | int | float:
    """Return a cell that no spreadsheet takes for a formula. None is an empty cell."""
    if cell is None:
        return ""
    if isinstance(cell, int | float):
        return cell
    # A carriage return alone would end the row for readers.
    text = str(cell).replace("\r\n", "\n").replace("\r", "\n")
    text = _WITHIN.sub("'", text)
    return f"'{text}" if text.startswith(_BEGINS_A_FORMULA) and not _NUMBER.fullmatch(text) else text


class _Text(Protocol):
    """A file, or an answer of a web server."""

    def write(self, text: str, /) -> object: ...


class CsvWriter:
    """Writes rows of harmless cells, each line ending with LF.

    Text is in quotes unless it is one word or number, so that programs that guess the separator guess right.
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
