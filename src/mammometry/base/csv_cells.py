"""CSV in which no cell is a formula.

A spreadsheet computes what begins with = + - or @, and may fetch addresses by it. Such text gets an apostrophe in
front, which shows that it is text. Numbers stay numbers, negative ones too.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable
from typing import Protocol

_BEGINS_A_FORMULA = tuple("=+-@\t\n＝＋－＠")
"""The last four are the full-width forms, which some spreadsheets read alike (OWASP, CSV Injection)."""
_NUMBER = re.compile(r"-[0-9]+(\.[0-9]+)?([eE][+-]?[0-9]+)?")


def harmless(cell: object) -> str | int | float:
    """Return a cell that no spreadsheet takes for a formula. None is an empty cell."""
    if cell is None:
        return ""
    if isinstance(cell, int | float):
        return cell
    # A carriage return alone would end the row for readers.
    text = str(cell).replace("\r\n", "\n").replace("\r", "\n")
    return f"'{text}" if text.startswith(_BEGINS_A_FORMULA) and not _NUMBER.fullmatch(text) else text


class _Text(Protocol):
    """A file, or an answer of a web server."""

    def write(self, text: str, /) -> object: ...


class CsvWriter:
    """Writes rows of harmless cells, each line ending with LF."""

    def __init__(self, file: _Text) -> None:
        self._writer = csv.writer(file, lineterminator="\n")

    def row(self, cells: Iterable[object]) -> None:
        """Write one row."""
        self._writer.writerow([harmless(cell) for cell in cells])


def csv_text(columns: Iterable[object], rows: Iterable[Iterable[object]]) -> str:
    """Return a whole table as text."""
    file = io.StringIO()
    writer = CsvWriter(file)
    writer.row(columns)
    for row in rows:
        writer.row(row)
    return file.getvalue()
