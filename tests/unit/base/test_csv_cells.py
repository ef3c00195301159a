"""No cell of any CSV that we write is a formula."""

import ast
import csv
import io
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mammometry.base.csv_cells import csv_text, harmless

_FORMULAS = "=+-@\t\r\n＝＋－＠"


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1+cmd|' /C calc'!A0", "@SUM(A1)", "\t1", "\n1", "＝1", "-", "--5"])
def test_a_formula_becomes_text(text: str) -> None:
    assert harmless(text) == f"'{text}"


def test_a_carriage_return_does_not_end_the_row() -> None:
    assert harmless("\r=1") == "'\n'=1"
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


@pytest.mark.parametrize("text", ["a;=1+1", "a; =1", 'a;"=1"', "a|@x", "a\t+1", "a\n-x", "a;-1+cmd"])
def test_no_part_begins_a_formula_where_another_mark_separates(text: str) -> None:
    table = csv_text(["id", "cell"], [[1, text]])
    parts = [part.strip(' "') for mark in ";|\t\n" for part in table.split(mark)]
    assert not [part for part in parts if part.startswith(tuple(_FORMULAS))]
    assert "'" in table


@given(st.lists(st.text(alphabet="a;|\t\n\"' =+-@1"), min_size=1))
def test_no_part_of_any_text_begins_a_formula(cells: list[str]) -> None:
    table = csv_text(["id", *cells], [])
    for part in (part.strip(' "') for mark in ";|\t\n" for part in table.split(mark)):
        number = part.partition(",")[0].strip(' "').partition(";")[0]
        assert not part.startswith(tuple("=+-@")) or float(re.split(r'[;|\t\n"]', number)[0]) < 0


def test_text_is_in_quotes_and_words_and_numbers_are_not() -> None:
    table = csv_text(["id", "why"], [[1, "a; b"], [2, "ok"], [3.5, -2], [None, 'say "no"'], ["x", "change: -5; -6.5"]])
    assert table == 'id,why\n1,"a; b"\n2,ok\n3.5,-2\n,"say ""no"""\nx,"change: -5; -6.5"\n'


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
    assert calls == set()  # csv_cells writes its own rows
