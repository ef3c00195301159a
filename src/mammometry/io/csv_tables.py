"""CSV tables made by people, programs and spreadsheets of any country.

UTF-8 with or without a byte-order mark; commas, semicolons or tabs between the cells. Where commas do not separate,
numbers may have decimal commas, all of them or none: ``1,234`` beside ``1.5`` could mean a thousand.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mammometry.base.errors import MammometryError, SessionError
from mammometry.base.parse import number, read_text, said, shown
from mammometry.geometry.arrays import Array, Float64

_SEPARATORS = ",;\t"
_MOST_MIB = 16  # of a whole table: some hundred thousand rows
_SWAPPED = str.maketrans(",.", ".,")  # a point among decimal commas is then as wrong as a comma among points


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table with named columns.

    Its cells are text without blanks around them.
    """

    name: str
    """What to call it in messages."""
    columns: tuple[str, ...]
    """As the first line names them."""
    lines: tuple[int, ...]
    """Line of each row in the file, from 1. Empty lines are no rows."""
    rows: tuple[tuple[str, ...], ...]
    """As many cells each as there are columns."""
    separator: str
    """What stands between the cells."""
    refusal: type[MammometryError] = SessionError
    """The class of its errors."""

    def texts(self, column: str) -> tuple[str, ...]:
        """All cells of a column.

        Raises:
            MammometryError: there is no such column, or it is there twice.
        """
        if (count := self.columns.count(column)) != 1:
            there = ", ".join(name for name in self.columns if name) or "no names"
            raise self.refusal(
                self.name,
                found=f"two columns {column}" if count else f"columns {there}",
                expected=f"one column {column}",
                remedy="Correct the first line, which names the columns",
            )
        place = self.columns.index(column)
        return tuple(row[place] for row in self.rows)

    def numbers(self, *columns: str) -> Float64[Array, "n k"]:
        """Some columns as numbers.

        Raises:
            MammometryError: as `texts`; a cell that is no number, or one written otherwise than the others.
        """
        cells = list(zip(*(self.texts(column) for column in columns), strict=True))
        comma = self._has_decimal_commas([cell for row in cells for cell in row])
        values = np.empty((len(cells), len(columns)))
        for place, (line, row) in enumerate(zip(self.lines, cells, strict=True)):
            for column, (name, cell) in enumerate(zip(columns, row, strict=True)):
                values[place, column] = self._number(cell, f"{self.name}, row {line}, column {name}", comma)
        return values

    def _has_decimal_commas(self, cells: Sequence[str]) -> bool:
        """Whether the first number with a decimal mark has a comma."""
        marked = next((cell for cell in cells if "," in cell or "." in cell), ".")
        return self.separator != "," and "," in marked

    def _number(self, cell: str, where: str, comma: bool) -> float:
        try:
            return number(cell.translate(_SWAPPED) if comma else cell)
        except ValueError:
            raise self.refusal(
                where,
                found=shown(cell) if cell else "no value",
                expected=f"a number with a decimal {'comma, as those above' if comma else 'point'}",
                remedy="Correct the value, or leave the whole row out",
            ) from None


def read_table(path: Path, name: str, expected: str, *, refusal: type[MammometryError] = SessionError) -> Table:
    """Read a CSV whose first line names the columns.

    Args:
        path: the table.
        name: what to call it in messages.
        expected: what it should hold, in words.
        refusal: the class of its errors.

    Raises:
        MammometryError: `refusal`; it cannot be read or is empty, or a row has more cells than there are columns.
    """
    text = read_text(path, name, expected, most_mib=_MOST_MIB, refusal=refusal)
    first = text.partition("\n")[0]
    separator = max(_SEPARATORS, key=first.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    lines: list[int] = []
    rows: list[tuple[str, ...]] = []
    columns: tuple[str, ...] = ()
    try:
        for cells in reader:
            row = tuple(cell.strip() for cell in cells)
            if not any(row):
                continue
            if not columns:
                columns = row
                continue
            if any(row[len(columns) :]):
                raise refusal(
                    f"{name}, row {reader.line_num}",
                    found=f"{len(row)} values",
                    expected=f"{len(columns)}, one a column",
                    remedy="Correct the row; where commas separate, decimals take a point",
                )
            lines.append(reader.line_num)
            rows.append((*row, *[""] * (len(columns) - len(row)))[: len(columns)])
    except csv.Error as error:
        where = f"{name}, row {reader.line_num}"
        raise refusal(where, found=said(error), expected=expected, remedy="Correct the table") from None
    if not columns:
        raise refusal(name, found="an empty file", expected=expected, remedy="Fill in the table")
    return Table(
        name=name,
        columns=columns,
        lines=tuple(lines),
        rows=tuple(rows),
        separator=separator,
        refusal=refusal,
    )
