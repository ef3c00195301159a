"""Tables of paired measurements, and the figures published from them."""

from pathlib import Path

from mammometry.base.errors import TableError
from mammometry.base.parse import number, parsing, read_text, toml_table
from mammometry.io.parsing.csv_tables import read_table
from mammometry.study.agreement import LEAST_SUBJECTS, PairedMeasurements, PublishedFigure

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
