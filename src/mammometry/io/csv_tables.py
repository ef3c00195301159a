"""Read CSV tables written by people, programs and spreadsheets in any country."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mammometry.base.errors import MammometryError, SessionError
from mammometry.base.parse import error_text, number, read_text, shown
from mammometry.geometry.arrays import Array, Bool, Float64

_OTHER = {",": ".", ".": ","}
_GROUPED = {mark: re.compile(rf"[+-]?[1-9][0-9]{{0,2}}(?:[{mark}][0-9]{{3}})+", re.ASCII) for mark in _OTHER}
"""Pattern of a grouped number, by the thousands separator."""
_GROUP = 3  # digits between thousands separators
_WHOLE = re.compile(r"[+-]?[0-9]+", re.ASCII)


@dataclass(frozen=True, slots=True, kw_only=True)
class DecimalMark:
    """A table's decimal mark and thousands separator."""

    mark: str
    """Decimal mark: a point or a comma."""
    groups: bool = False
    """Whether a cell proves that the other mark separates thousands."""
    ambiguous: frozenset[int] = frozenset()
    """Columns in which a mark before three digits may be a decimal mark or a thousands separator."""

    def number(self, cell: str) -> float:
        """Parse a cell as a number.

        Raises:
            ValueError: it is not a number in this table's format.
        """
        thousands = _OTHER[self.mark]
        whole, point, decimals = cell.partition(self.mark)
        if self.groups and _GROUPED[thousands].fullmatch(whole):
            whole = whole.replace(thousands, "")
        if thousands in whole + decimals:
            raise ValueError(f"{cell!r}: it has a {'comma' if thousands == ',' else 'point'}")
        return number(f"{whole}{'.' if point else ''}{decimals}")


def decimal_mark(columns: Iterable[Sequence[str]], *, separator: str = ";", alike: bool = False) -> DecimalMark:
    """Find a table's number format from all cells of some columns.

    A cell such as ``1,860`` or ``1.860`` is ambiguous. Another cell may prove what the mark means. Otherwise it is read
    with three decimals only if commas separate the cells and the column has no whole number: then a program wrote it.

    Args:
        columns: cells of each column.
        separator: separator of the cells.
        alike: whether all columns contain the same quantity measured by different methods. Then a whole number in one
            column also counts for the others; three decimals are accepted only in numbers from 100, such as
            ``412.125``; and a column with whole numbers must prove its own decimal mark.
    """
    marks: list[str] = []
    shown_in: set[int] = set()
    doubtful: list[tuple[int, str, str]] = []
    whole: set[int] = set()
    groups = False
    for place, cells in enumerate(columns):
        for cell in cells:
            letters = [letter for letter in cell if letter in _OTHER]
            if not letters:
                if _WHOLE.fullmatch(cell):
                    whole.add(place)
            elif len(letters) == 1:
                if _GROUPED[letters[0]].fullmatch(cell):
                    doubtful.append((place, letters[0], cell))
                else:
                    marks.append(letters[0])
                    shown_in.add(place)
            else:
                groups = True
                shown_in.add(place)
                several = cell.count(letters[-1]) > 1  # 1.860.000 has several, 1.860,5 has one
                marks.append(_OTHER[letters[-1]] if several else letters[-1])
    if marks:
        unclear = {place for place, *_ in doubtful if place in whole - shown_in} if alike else set()
        return DecimalMark(mark=marks[0], groups=groups, ambiguous=frozenset(unclear))
    hundreds = {place for place, _, cell in doubtful if len(re.split(r"[.,]", cell.lstrip("+-"))[0]) == _GROUP}
    written = {place for place, *_ in doubtful if place not in whole and (not alike or (hundreds and not whole))}
    ambiguous = {place for place, mark, _ in doubtful if mark == "," or separator != "," or place not in written}
    return DecimalMark(mark=doubtful[0][1] if doubtful else ".", ambiguous=frozenset(ambiguous))


def both_readings(cell: str) -> tuple[str, str] | None:
    """Both possible readings of a cell such as ``1,860``. None for other cells."""
    marks = {letter for letter in cell if letter in _OTHER}
    if len(marks) != 1 or not _GROUPED[mark := marks.pop()].fullmatch(cell) or cell.count(mark) != 1:
        return None
    return f"{number(cell.replace(mark, '')):g}", f"{number(cell.replace(mark, '.')):g}"


_SEPARATORS = ",;\t"
_MOST_MIB = 16  # a few hundred thousand rows
_STATED = re.compile(r'"?sep=([^\w\s"\'.]|\t)"?[,;\t ]*', re.IGNORECASE)  # first line of some spreadsheets' tables


@dataclass(frozen=True, slots=True, kw_only=True)
class CsvTable:
    """A table with named columns. Spaces around cells are removed."""

    name: str
    """Its name in messages."""
    columns: tuple[str, ...]
    """Names in the first line."""
    lines: tuple[int, ...]
    """Line of each row in the file, from 1. Empty lines are skipped."""
    rows: tuple[tuple[str, ...], ...]
    """Rows. Each has as many cells as there are columns."""
    separator: str
    """Separator of the cells."""
    refusal: type[MammometryError] = SessionError
    """Class of the errors that it raises."""

    def texts(self, column: str) -> tuple[str, ...]:
        """All cells of a column.

        Raises:
            MammometryError: the column is missing or exists twice.
        """
        if (count := self.columns.count(column)) != 1:
            names = ", ".join(name for name in self.columns if name) or "no names"
            raise self.refusal(
                self.name,
                found=f"two columns {column}" if count else f"columns {names}",
                expected=f"one column {column}",
                remedy="Correct the first line, which names the columns",
            )
        place = self.columns.index(column)
        return tuple(row[place] for row in self.rows)

    def numbers(self, *columns: str, blank: bool = False, alike: bool = False) -> Float64[Array, "n k"]:
        """Some columns as numbers.

        Args:
            columns: their names.
            blank: whether cells may be empty. They become NaN.
            alike: whether all columns contain the same quantity, see `decimal_mark`.

        Raises:
            MammometryError: see `texts`; or a cell is not a number, has another format than the others, or is
            ambiguous.
        """
        cells = [self.texts(column) for column in columns]
        mark = decimal_mark(cells, separator=self.separator, alike=alike)
        values = np.full((len(self.rows), len(columns)), np.nan)
        for row, line in enumerate(self.lines):
            for column, name in enumerate(columns):
                if (cell := cells[column][row]) or not blank:
                    where = f"{self.name}, row {line}, column {name}"
                    values[row, column] = self._number(cell, where, mark, doubted=column in mark.ambiguous)
        return values

    def require(self, column: str, fine: Sequence[bool] | Bool[Array, " n"], expected: str) -> None:
        """Refuse a column with an invalid cell. The error names the first one.

        Args:
            column: its name.
            fine: whether the cell is valid, for each row.
            expected: description of a valid cell, for the message.

        Raises:
            MammometryError: a cell is invalid.
        """
        row = next((row for row, good in enumerate(fine) if not good), None)
        if row is not None:
            raise self.refusal(
                f"{self.name}, row {self.lines[row]}, column {column}",
                found=shown(self.texts(column)[row]),
                expected=expected,
                remedy="Correct the value, or remove the row",
            )

    def _number(self, cell: str, where: str, mark: DecimalMark, *, doubted: bool) -> float:
        readings = both_readings(cell)
        if readings is not None and doubted:
            remedy = "Write numbers without thousands separators, and with one or two decimals"
            expected = "numbers without thousands separators"
            raise self.refusal(
                where, found=f"{shown(cell)}, which may mean {' or '.join(readings)}", expected=expected, remedy=remedy
            )
        try:
            return mark.number(cell)
        except ValueError:
            doubt = "" if readings is None else f", which may mean {' or '.join(readings)}"
            remedy = "Correct the value, or remove the whole row"
            expected = f"a number with a decimal {'comma, as in the others' if mark.mark == ',' else 'point'}"
            raise self.refusal(
                where, found=f"{shown(cell)}{doubt}" if cell else "no value", expected=expected, remedy=remedy
            ) from None


def read_table(path: Path, name: str, expected: str, *, refusal: type[MammometryError] = SessionError) -> CsvTable:
    """Read a CSV whose first line names the columns.

    Args:
        path: the table.
        name: its name in messages.
        expected: what it should contain, for messages.
        refusal: class of the errors.

    Raises:
        MammometryError: of class `refusal`; the table cannot be read or is empty, or a row has too many cells.
    """
    text = read_text(path, name, expected, most_mib=_MOST_MIB, refusal=refusal)
    head = next((line for line in re.split(r"[\r\n]", text) if line.strip()), "")
    stated = _STATED.fullmatch(head)
    if stated is not None:
        text = text.replace(head, "", 1)  # an empty line remains, so that line numbers are right
    text = re.sub(" +$", "", text, flags=re.MULTILINE)  # the reader does not accept spaces after a closing quote
    separator = stated[1] if stated is not None else max(_SEPARATORS, key=head.count)
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
                    expected=f"{len(columns)}, one per column",
                    remedy="Correct the row. If commas separate the cells, write decimals with a point"
                    if separator == ","
                    else f"Correct the row, or put quotes around a cell that contains {shown(separator)}",
                )
            lines.append(reader.line_num)
            rows.append((*row, *[""] * (len(columns) - len(row)))[: len(columns)])
    except csv.Error as error:
        where = f"{name}, row {reader.line_num}"
        raise refusal(where, found=error_text(error), expected=expected, remedy="Correct the table") from None
    if not columns:
        raise refusal(name, found="an empty file", expected=expected, remedy="Fill in the table")
    return CsvTable(
        name=name, columns=columns, lines=tuple(lines), rows=tuple(rows), separator=separator, refusal=refusal
    )
