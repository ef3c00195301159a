"""Tables as programs and spreadsheets of several countries write them."""

import csv
import io
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mammometry.base.errors import MammometryError, SessionError
from mammometry.base.parse import LARGEST
from mammometry.io.csv_tables import both_readings, read_table

VALUES = st.lists(st.tuples(*[st.floats(min_value=-LARGEST, max_value=LARGEST)] * 3), min_size=1, max_size=8)
in_one_folder = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=50)


@given(VALUES, st.sampled_from(",;\t"), st.booleans(), st.booleans(), st.sampled_from(["\n", "\r\n"]))
@in_one_folder
def test_whatever_a_spreadsheet_writes_is_read(
    tmp_path: Path, rows: list[tuple[float, ...]], separator: str, mark: bool, commas: bool, end: str
) -> None:
    text = io.StringIO()
    writer = csv.writer(text, delimiter=separator, lineterminator=end)
    writer.writerow(["id", "u", "v"])
    for row in rows:
        cells = [f"{cell}0" if both_readings(cell) else cell for cell in map(repr, row)]  # 1.125 may mean 1125
        writer.writerow([cell.replace(".", ",") if commas and separator != "," else cell for cell in cells])
    (tmp_path / "a.csv").write_bytes(text.getvalue().encode("utf-8-sig" if mark else "utf-8"))
    np.testing.assert_array_equal(read_table(tmp_path / "a.csv", "a", "b").numbers("id", "u", "v"), rows)


@given(st.text() | st.binary(), st.sampled_from(["", "id,u,v\n", "id;u;v\n"]))
@in_one_folder
def test_anything_else_is_one_sentence_or_finite(tmp_path: Path, rest: str | bytes, first: str) -> None:
    content = rest if isinstance(rest, bytes) else rest.encode("utf-8", "surrogatepass")
    (tmp_path / "a.csv").write_bytes(first.encode() + content)
    said = "a.csv"
    try:
        values = read_table(tmp_path / "a.csv", "a.csv", "b").numbers("id", "u", "v")
        assert np.isfinite(values).all()
    except MammometryError as error:
        said = str(error)
    assert said.startswith("a.csv")
    assert "\n" not in said


EXCEL = "\ufeffid;u;v\r\n0;10,5;3\r\n1;1.0488,5;2\r\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (EXCEL, r"a, row 3, column u: .*'1\.0488,5'.* comma"),
        ("id;u;v\n0;1.5;2\n1;2,5;3\n", r"a, row 3, column u: .*'2,5'.* point"),
        ("id;u;v\n0;1,5;2\n1;2.5;3\n", r"a, row 3, column u: .*'2\.5'.* comma"),
        ("id,u,v\n0,1,5,2\n", "a, row 2: found 4 values"),
        ("id,u\n0,1\n", r"a: .*\bid, u,.*\bv\b"),
        ("id,u,u,v\n0,1,1,2\n", r"a: .*\bu\b"),
        ("id,u,v\n0,1e308,2\n", "column u: found '1e308'"),
        ("id,u,v\n0,1_0,2\n", "column u: found '1_0'"),
        ("id,u,v\n0,-inf,2\n", "column u: found '-inf'"),
        ("id,u,v\n0," + "1" * 200_000 + ",2\n", "limit"),
        ('id,u,v\n0,"1,2\n', "data"),
        ("\n\n", "empty"),
    ],
)
def test_mistakes_are_named_by_row_and_column(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    with pytest.raises(SessionError, match=said) as caught:
        read_table(tmp_path / "a.csv", "a", "b").numbers("id", "u", "v")
    assert len(str(caught.value)) < 400


def test_empty_cells_at_a_rows_end_and_blank_lines_are_no_mistake(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("id;u;v;\n\n0;1,5;2;;;\n;;\n1;2;3\n")
    table = read_table(tmp_path / "a.csv", "a", "b")
    assert table.numbers("u", "v").tolist() == [[1.5, 2.0], [2.0, 3.0]]
    assert table.lines == (3, 5)
