"""CSV tables made by people, programs and spreadsheets of any country.

Among them tables of paired measurements, with the figures published from them.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mammometry.base.errors import MammometryError, SessionError, TableError
from mammometry.base.parse import error_text, number, parsing, read_text, shown, toml_table
from mammometry.geometry.arrays import Array, Float64

if TYPE_CHECKING:
    from mammometry.study.agreement import PairedMeasurements, PublishedFigure

_OTHER = {",": ".", ".": ","}
_GROUPED = {mark: re.compile(rf"[+-]?[1-9][0-9]{{0,2}}(?:[{mark}][0-9]{{3}})+", re.ASCII) for mark in _OTHER}
"""By what separates thousands."""
_SHORT = re.compile(r"[+-]?[1-9][0-9]{0,2}", re.ASCII)
_LONG = re.compile(r"[+-]?[0-9]{4,}", re.ASCII)


@dataclass(frozen=True, slots=True, kw_only=True)
class DecimalMark:
    """A table's decimal mark and its mark between thousands."""

    mark: str
    """Before decimals: a point or a comma."""
    groups: bool = False
    """Whether some cell shows that the other mark separates thousands."""
    ambiguous: frozenset[int] = frozenset()
    """Columns in which nothing shows what a mark before three digits means."""

    def number(self, cell: str) -> float:
        """Parse a cell as a number.

        Raises:
            ValueError: it is no number as this table writes them.
        """
        thousands = _OTHER[self.mark]
        whole, point, decimals = cell.partition(self.mark)
        if self.groups and _GROUPED[thousands].fullmatch(whole):
            whole = whole.replace(thousands, "")
        if thousands in whole + decimals:
            raise ValueError(f"{cell!r}, which has a {'comma' if thousands == ',' else 'point'}")
        return number(f"{whole}{'.' if point else ''}{decimals}")


def decimal_mark(columns: Iterable[Sequence[str]]) -> DecimalMark:
    """Find out how a table writes its numbers, from all cells of some columns."""
    marks: list[str] = []
    doubtful: list[str] = []
    ambiguous: set[int] = set()
    long = groups = False
    for place, cells in enumerate(columns):
        before = len(doubtful)
        for cell in cells:
            letters = [letter for letter in cell if letter in _OTHER]
            if not letters:
                long = long or bool(_LONG.fullmatch(cell))
            elif len(letters) == 1:
                (doubtful if _GROUPED[letters[0]].fullmatch(cell) else marks).append(letters[0])
            else:
                groups = True
                several = cell.count(letters[-1]) > 1  # 1.860.000, else 1.860,5
                marks.append(_OTHER[letters[-1]] if several else letters[-1])
        # 1.860 has decimals to most, unless whole numbers stand beside it.
        if "," in doubtful[before:] or (doubtful[before:] and any(map(_SHORT.fullmatch, cells))):
            ambiguous.add(place)
    if marks:
        return DecimalMark(mark=marks[0], groups=groups)
    if long:  # 1860 beside 1,250: whoever separates thousands does so everywhere
        ambiguous.clear()
    return DecimalMark(mark=(doubtful or ["."])[0], ambiguous=frozenset(ambiguous))


def both_readings(cell: str) -> tuple[str, str] | None:
    """Both meanings of a cell such as ``1,860``, else None."""
    marks = {letter for letter in cell if letter in _OTHER}
    if len(marks) != 1 or not _GROUPED[mark := marks.pop()].fullmatch(cell) or cell.count(mark) != 1:
        return None
    return f"{number(cell.replace(mark, '')):g}", f"{number(cell.replace(mark, '.')):g}"


_SEPARATORS = ",;\t"
_MOST_MIB = 16  # of a whole table: some hundred thousand rows
_STATED = re.compile(r'"?sep=([^\w\s"\'.]|\t)"?[,;\t ]*', re.IGNORECASE)  # as spreadsheets begin a table


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table with named columns. Its cells are text without blanks around them."""

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
            names = ", ".join(name for name in self.columns if name) or "no names"
            raise self.refusal(
                self.name,
                found=f"two columns {column}" if count else f"columns {names}",
                expected=f"one column {column}",
                remedy="Correct the first line, which names the columns",
            )
        place = self.columns.index(column)
        return tuple(row[place] for row in self.rows)

    def numbers(self, *columns: str, blank: bool = False) -> Float64[Array, "n k"]:
        """Some columns as numbers.

        Args:
            columns: their names.
            blank: whether a cell may be empty. It is NaN then.

        Raises:
            MammometryError: as `texts`; a cell that is no number, one written otherwise than the others, or one that
                may mean two numbers.
        """
        cells = [self.texts(column) for column in columns]
        mark = decimal_mark(cells)
        values = np.full((len(self.rows), len(columns)), np.nan)
        for row, line in enumerate(self.lines):
            for column, name in enumerate(columns):
                if (cell := cells[column][row]) or not blank:
                    where = f"{self.name}, row {line}, column {name}"
                    values[row, column] = self._number(cell, where, mark, doubted=column in mark.ambiguous)
        return values

    def _number(self, cell: str, where: str, mark: DecimalMark, *, doubted: bool) -> float:
        readings = both_readings(cell)
        if readings is not None and doubted:
            remedy = "Write whole numbers without a mark, or decimals of all numbers to another place"
            expected = "numbers without marks between thousands"
            raise self.refusal(
                where, found=f"{shown(cell)}, which may mean {' or '.join(readings)}", expected=expected, remedy=remedy
            )
        try:
            return mark.number(cell)
        except ValueError:
            doubt = "" if readings is None else f", which may mean {' or '.join(readings)}"
            remedy = "Correct the value, or leave the whole row out"
            expected = f"a number with a decimal {'comma, as the others' if mark.mark == ',' else 'point'}"
            raise self.refusal(
                where, found=f"{shown(cell)}{doubt}" if cell else "no value", expected=expected, remedy=remedy
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
    head = next((line for line in re.split(r"[\r\n]", text) if line.strip()), "")
    stated = _STATED.fullmatch(head)
    if stated is not None:
        text = text.replace(head, "", 1)  # its line stays empty, so that lines are counted rightly
    text = re.sub(" +$", "", text, flags=re.MULTILINE)  # after a quote they are a mistake to the reader
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
                    expected=f"{len(columns)}, one a column",
                    remedy="Correct the row; where commas separate, decimals take a point",
                )
            lines.append(reader.line_num)
            rows.append((*row, *[""] * (len(columns) - len(row)))[: len(columns)])
    except csv.Error as error:
        where = f"{name}, row {reader.line_num}"
        raise refusal(where, found=error_text(error), expected=expected, remedy="Correct the table") from None
    if not columns:
        raise refusal(name, found="an empty file", expected=expected, remedy="Fill in the table")
    return Table(name=name, columns=columns, lines=tuple(lines), rows=tuple(rows), separator=separator, refusal=refusal)


_UNITS = ("cc", "ml", "mm", "cm", "mm2", "cm2", "g")


def read_pairs(path: Path, *, reference: str, measured: str) -> PairedMeasurements:
    """Read a CSV with one row a subject.

    The first line names the columns. Written as `csv_tables` reads it. A first column that is neither of the two names
    the subjects; else they are numbered.

    Args:
        path: the table, UTF-8.
        reference: name of the column of the method compared with.
        measured: name of the column of the method under test.

    Raises:
        TableError: it cannot be read, a column is missing, a value is missing or no number (named by row and column),
            or there are fewer than three rows.
    """
    from mammometry.study.agreement import LEAST_SUBJECTS, PairedMeasurements

    table = read_table(path, str(path), "a CSV table, one row a subject", refusal=TableError)
    pairs = table.numbers(reference, measured)
    named = table.columns[0] not in (reference, measured)
    names = table.texts(table.columns[0]) if named else tuple(str(row + 1) for row in range(len(pairs)))
    if len(pairs) < LEAST_SUBJECTS:
        remedy = "Add measurements: fewer do not show agreement"
        expected = f"{LEAST_SUBJECTS} or more"
        raise TableError(str(path), found=f"{len(pairs)} rows of measurements", expected=expected, remedy=remedy)
    units = {name.rpartition("_")[2] for name in (reference, measured)}
    unit = units.pop() if len(units) == 1 else ""
    return PairedMeasurements(
        names=names,
        reference=pairs[:, 0].copy(),
        measured=pairs[:, 1].copy(),
        reference_name=_without_unit(reference),
        measured_name=_without_unit(measured),
        unit=unit if unit in _UNITS else "",
    )


def read_published(path: Path) -> tuple[PublishedFigure, ...]:
    """Read a publication's figures: TOML with one ``[[figure]]`` each.

    Raises:
        TableError: it cannot be read, or is not of that form.
    """
    from mammometry.study.agreement import PublishedFigure

    expected = '[[figure]] tables with what, figure and published = "11.12", and note if there is one'
    table = toml_table(
        read_text(path, str(path), expected, most_mib=1, refusal=TableError), str(path), expected, refusal=TableError
    )
    with parsing("another content", str(path), expected, TableError):
        figures = tuple(PublishedFigure(**figure) for figure in table["figure"])
        for figure in figures:
            if not all(isinstance(text, str) for text in (figure.what, figure.figure, figure.published, figure.note)):
                raise ValueError("a value that is not text")
            number(figure.published)
    return figures


def _without_unit(column: str) -> str:
    name, _, unit = column.rpartition("_")
    return (name if name and unit in _UNITS else column).replace("_", " ")
