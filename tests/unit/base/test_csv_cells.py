"""No cell of any CSV that we write is a formula."""

import ast
import csv
import io
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mammometry.base.csv_cells import csv_text, harmless

_FORMULAS = "=+-@\t\r\n＝＋－＠"


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1+cmd|' /C calc'!A0", "@SUM(A1)", "\t=1", "\n=1", "＝1", "-", "--5"])
def test_a_formula_becomes_text(text: str) -> None:
    assert harmless(text) == f"'{text}"


def test_a_carriage_return_does_not_end_the_row() -> None:
    assert harmless("\r=1") == "'\n=1"
    assert harmless("a\r\nb\rc") == "a\nb\nc"


@pytest.mark.parametrize("cell", [-1, -2.5, 3, "-1", "-2.5", "-1.5e-05", "4", "a=b", ""])
def test_numbers_and_plain_text_stay(cell: object) -> None:
    assert harmless(cell) == cell


@given(st.lists(st.text(), min_size=1))
def test_no_cell_begins_a_formula_when_it_is_read_back(cells: list[str]) -> None:
    text = csv_text(["begin", *cells], [])
    (row,) = csv.reader(io.StringIO(text, newline=""))
    for cell in row:
        assert not cell.startswith(tuple(_FORMULAS)) or float(cell) < 0


def test_every_writer_of_csv_is_this_one(repository: Path) -> None:
    """Walks the whole code: nobody else calls the csv module's writers."""
    package = repository / "src" / "mammometry"
    writers = ("writer", "DictWriter", "to_csv", "savetxt")
    calls = {
        path.relative_to(package).as_posix()
        for path in package.rglob("*.py")
        if any(word in (text := path.read_text()) for word in (*writers, "from csv"))
        for node in ast.walk(ast.parse(text))
        if (isinstance(node, ast.Attribute) and node.attr in writers)
        or (isinstance(node, ast.ImportFrom) and node.module == "csv")
    }
    assert calls == {"base/csv_cells.py"}
