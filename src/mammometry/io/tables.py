"""Tables of paired measurements, and the figures that a publication drew from one."""

from __future__ import annotations

import csv
import math
import tomllib
from pathlib import Path

import numpy as np

from mammometry.errors import TableError
from mammometry.study.agreement import LEAST_SUBJECTS, PairedMeasurements, PublishedFigure

_UNITS = ("cc", "ml", "mm", "cm", "mm2", "cm2", "g")
_DELIMITERS = ",;\t"


def read_pairs(path: Path, *, reference: str, measured: str) -> PairedMeasurements:
    """Read a CSV with one row a subject; the first line names the columns.

    Commas, semicolons or tabs stand between the values, a point before decimals. A first column that is neither of the
    two names the subjects; else they are numbered.

    Args:
        path: the table, UTF-8.
        reference: name of the column of the method compared with.
        measured: name of the column of the method under test.

    Raises:
        TableError: it cannot be read, a column is missing, a value is missing or no number (named by row and column),
            or there are fewer than three rows.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise TableError(
            str(path),
            found=f"a file that cannot be read ({getattr(error, 'strerror', None) or error})",
            expected="a CSV table in UTF-8",
            remedy="Check the path, or export the table as CSV in UTF-8",
        ) from None
    lines = text.splitlines()
    header = lines[0] if lines else ""
    delimiter = max(_DELIMITERS, key=header.count)
    rows = list(csv.reader(lines, delimiter=delimiter))
    columns = [name.strip() for name in rows[0]] if rows else []
    for wanted in (reference, measured):
        if columns.count(wanted) != 1:
            found = f"columns {', '.join(columns)}" if columns else "an empty file"
            raise TableError(
                str(path),
                found=f"two columns {wanted}" if columns.count(wanted) > 1 else found,
                expected=f"one column {wanted}",
                remedy="Rename the column, or name yours with --reference and --measured",
            )
    names: list[str] = []
    values: list[list[float]] = []
    for line, row in enumerate(rows[1:], start=2):
        if not any(cell.strip() for cell in row):
            continue
        if len(row) > len(columns):
            raise TableError(
                f"{path}, row {line}",
                found=f"{len(row)} values",
                expected=f"{len(columns)}, one a column",
                remedy="Correct the row; decimals take a point, not a comma",
            )
        cells = dict(zip(columns, (cell.strip() for cell in row), strict=False))
        values.append(
            [_number(cells.get(name, ""), f"{path}, row {line}, column {name}") for name in (reference, measured)]
        )
        named = columns[0] not in (reference, measured)
        names.append(cells[columns[0]] if named else str(len(names) + 1))
    if len(values) < LEAST_SUBJECTS:
        raise TableError(
            str(path),
            found=f"{len(values)} rows of measurements",
            expected=f"{LEAST_SUBJECTS} or more",
            remedy="Add measurements: fewer say nothing about agreement",
        )
    pairs = np.array(values)
    units = {name.rpartition("_")[2] for name in (reference, measured)}
    unit = units.pop() if len(units) == 1 else ""
    return PairedMeasurements(
        names=tuple(names),
        reference=pairs[:, 0].copy(),
        measured=pairs[:, 1].copy(),
        reference_name=_without_unit(reference),
        measured_name=_without_unit(measured),
        unit=unit if unit in _UNITS else "",
    )


def read_published(path: Path) -> tuple[PublishedFigure, ...]:
    """Read what a publication says of a table: TOML with one ``[[figure]]`` a figure.

    Raises:
        TableError: it cannot be read, or is not of that form.
    """
    try:
        with path.open("rb") as file:
            figures = tuple(PublishedFigure(**figure) for figure in tomllib.load(file)["figure"])
        for figure in figures:
            float(figure.published)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise TableError(
            str(path),
            found=f"another content ({error})",
            expected='[[figure]] tables with what, figure and published = "11.12", and note if there is one',
            remedy="Correct it",
        ) from None
    return figures


def _number(cell: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise TableError(
            where,
            found=f"{cell!r}" if cell else "no value",
            expected="a number with a decimal point",
            remedy="Correct the value; leave the subject out if it was not measured by both methods",
        )
    return value


def _without_unit(column: str) -> str:
    name, _, unit = column.rpartition("_")
    return (name if name and unit in _UNITS else column).replace("_", " ")
