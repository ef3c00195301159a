"""Read tables of paired measurements, and published figures about them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mammometry.base.errors import TableError
from mammometry.base.notices import Notice
from mammometry.base.parse import number, parsing, read_text, shown, toml_table
from mammometry.geometry.arrays import Array, Float64
from mammometry.io.csv_tables import CsvTable, both_readings, read_table
from mammometry.io.measured_columns import MeasuredColumn, common_unit, measured_column, same_unit
from mammometry.io.subject_columns import SubjectRows, subject_rows

if TYPE_CHECKING:
    from mammometry.study.agreement import PairedMeasurements, PublishedFigure

_ALIKE = 3.0  # largest ratio of two methods' values for one subject, if a mark is ambiguous
_SCALES = 5.0  # typical ratio above which quantities or units differ
# words in the names of columns that may contain negative values
_CHANGES = ("change", "difference", "diff", "delta", "gain", "loss")


def read_pairs(path: Path, *, reference: str, measured: str) -> PairedMeasurements:
    """Read a CSV with one pair of measurements per row.

    Number formats are those of `csv_tables`. If the columns have different units of the same kind, both are converted
    to the smaller unit.

    Args:
        path: the table, UTF-8.
        reference: column of the reference method.
        measured: column of the method under test.

    Raises:
        TableError: the table cannot be read, a column is missing, both columns are the same, or their units are of
        different kinds; a value (named by row and column) is missing, invalid, ambiguous, or a code for a missing
        value; a row is a summary or repeats another; or there are fewer than three subjects.
    """
    from mammometry.study.agreement import LEAST_SUBJECTS, PairedMeasurements

    table = read_table(path, str(path), "a CSV table, one row per subject", refusal=TableError)
    if reference == measured:
        raise _refused(table, f"column {measured} twice", "two methods", "Give two columns: --reference and --measured")
    pairs = table.numbers(reference, measured, alike=same_unit(reference, measured))
    columns = tuple(measured_column(name, pairs[:, place]) for place, name in enumerate((reference, measured)))
    unit, factors = common_unit(table, *columns)
    _require_marks(table, (reference, measured), pairs, factors)
    who = subject_rows(table, (reference, measured), pairs)
    _require_values(table, columns, pairs)
    notices = _codes(columns, pairs, who)
    pairs = pairs * factors
    count = len(set(who.subjects))
    if count < LEAST_SUBJECTS:
        remedy = "Add measurements: fewer cannot show agreement"
        found = f"{len(pairs)} rows of measurements" if count == len(pairs) else f"rows of {count} subjects"
        raise _refused(table, found, f"{LEAST_SUBJECTS} or more", remedy)
    _require_two_methods(table, columns, pairs)
    _require_scale(table, columns, pairs)
    return PairedMeasurements(
        names=who.names,
        reference=pairs[:, 0].copy(),
        measured=pairs[:, 1].copy(),
        reference_name=columns[0].title,
        measured_name=columns[1].title,
        unit=unit,
        subjects=who.subjects if count < len(pairs) else (),
        notices=(*notices, *_warnings(columns, pairs)),
    )


def _require_marks(
    table: CsvTable, names: tuple[str, str], pairs: Float64[Array, "n 2"], factors: Float64[Array, " 2"]
) -> None:
    """Refuse ``1.422`` next to 1434: other cells prove the decimal mark, the other method suggests 1422."""
    for column, name in enumerate(names):
        for row, cell in enumerate(table.texts(name)):
            other = abs(pairs[row, 1 - column]) * factors[1 - column] / factors[column]
            readings = both_readings(cell)
            if readings is None or not other:
                continue
            taken = _times(pairs[row, column], other)
            if min(_times(float(reading), other) for reading in readings) < min(taken, _ALIKE):
                raise TableError(
                    f"{table.name}, row {table.lines[row]}, column {name}",
                    found=f"{shown(cell)}, which may mean {' or '.join(readings)}, next to {pairs[row, 1 - column]:g}",
                    expected="numbers without thousands separators",
                    remedy="Write the number without a thousands separator, or with one or two decimals",
                )


def _times(one: float, other: float) -> float:
    """Ratio of the larger to the smaller magnitude."""
    return math.exp(abs(math.log(abs(one) / abs(other))))


def _require_values(table: CsvTable, columns: tuple[MeasuredColumn, ...], pairs: Float64[Array, "n 2"]) -> None:
    """Refuse negative values, except in columns of changes, and negative codes for missing values."""
    for row, place in np.argwhere(pairs < 0):
        column, value = columns[place], pairs[row, place]
        changes = any(word in column.name.casefold() for word in _CHANGES)
        if not (_is_code(value) or (column.unit and not changes)):
            continue
        raise TableError(
            f"{table.name}, row {table.lines[row]}, column {column.name}",
            found=f"{value:g}",
            expected="a measurement, not a code for a missing one" if _is_code(value) else "a value of 0 or more",
            remedy="Remove the row if the value is missing"
            if _is_code(value) or not column.unit
            else "Correct the value, or remove the row. If the column contains changes, name it change_…",
        )


def _is_code(value: float) -> bool:
    """Whether a value consists of nines, which statistics programs use for missing values: 999, −9."""
    digits = f"{abs(value):.15g}"
    return set(digits) == {"9"} and (value < 0 or len(digits) > 2)


def _require_two_methods(table: CsvTable, columns: tuple[MeasuredColumn, ...], pairs: Float64[Array, "n 2"]) -> None:
    if (pairs[:, 0] == pairs[:, 1]).all():
        found = f"the same numbers in {columns[0].name} and {columns[1].name}"
        raise _refused(table, found, "measurements by two methods", "Check that one was not copied from the other")
    if not np.ptp(pairs, axis=0).any():
        found = f"{pairs[0, 0]:g} and {pairs[0, 1]:g} in every row"
        raise _refused(table, found, "subjects that differ", "Check the columns")


def _codes(columns: tuple[MeasuredColumn, ...], pairs: Float64[Array, "n 2"], who: SubjectRows) -> list[Notice]:
    """Warnings about values that may be codes for missing ones."""
    found = []
    for column, values in zip(columns, pairs.T, strict=True):
        suspects = [row for row, value in enumerate(values) if value == 0 or _is_code(value)]
        if suspects and len(suspects) < len(values):
            value, name = values[suspects[0]], who.names[suspects[0]]
            suspect: dict[str, float | str] = {"column": column.name, "value": float(value), "row": name}
            found.append(Notice(code="value-may-be-missing", values=suspect))
    return found


def _warnings(columns: tuple[MeasuredColumn, ...], pairs: Float64[Array, "n 2"]) -> Iterator[Notice]:
    for place, column in enumerate(columns):
        if not np.ptp(pairs[:, place]):
            yield Notice(code="column-constant", values={"column": column.name, "value": float(pairs[0, place])})
        if not column.unit and columns[1 - place].unit:
            yield Notice(code="unit-assumed", values={"column": column.name, "unit": columns[1 - place].unit})
    ratio = _typical_ratio(pairs)
    if not 1 / _SCALES < ratio < _SCALES:
        values: dict[str, float | str] = {"reference": columns[0].name, "measured": columns[1].name, "ratio": ratio}
        yield Notice(code="columns-differ", values=values)


def _typical_ratio(pairs: Float64[Array, "n 2"]) -> float:
    usable = pairs[(pairs > 0).all(axis=1)]
    return float(np.median(usable[:, 1] / usable[:, 0])) if len(usable) else 1.0


def _require_scale(table: CsvTable, columns: tuple[MeasuredColumn, ...], pairs: Float64[Array, "n 2"]) -> None:
    """Refuse a column without a unit whose values do not fit the other column's unit."""
    ratio = _typical_ratio(pairs)
    unknown = [column for column in columns if not column.unit]
    if len(unknown) == 1 and not 1 / _SCALES < ratio < _SCALES:
        raise TableError(
            f"{table.name}, column {unknown[0].name}",
            found=f"no unit, and {columns[1].name} is typically {ratio:.3g} times {columns[0].name}",
            expected="the unit at the end of the name, such as water_cc or water_l",
            remedy="Rename the column",
        )


def _refused(table: CsvTable, found: str, expected: str, remedy: str) -> TableError:
    return TableError(table.name, found=found, expected=expected, remedy=remedy)


def read_published(path: Path) -> tuple[PublishedFigure, ...]:
    """Read published figures: TOML with one ``[[figure]]`` table per figure.

    Raises:
        TableError: it cannot be read, or has another form.
    """
    from mammometry.study.agreement import PublishedFigure

    expected = '[[figure]] tables with what, figure and published = "11.12", and note if there is one'
    table = toml_table(
        read_text(path, str(path), expected, most_mib=1, refusal=TableError), str(path), expected, refusal=TableError
    )
    with parsing("wrong content", str(path), expected, TableError):
        figures = tuple(PublishedFigure(**figure) for figure in table["figure"])
        for figure in figures:
            if not all(isinstance(text, str) for text in (figure.what, figure.figure, figure.published, figure.note)):
                raise ValueError("a value that is not text")
            number(figure.published)
    return figures
