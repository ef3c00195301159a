"""Tables of pairs: read as they are, refused by row and column."""

from pathlib import Path

import numpy as np
import pytest

from mammometry.base.errors import TableError
from mammometry.io.csv_tables import read_pairs, read_published


def written(folder: Path, text: str) -> Path:
    path = folder / "table.csv"
    path.write_text(text, encoding="utf-8")
    return path


GOOD = "id,reference_cc,measured_cc,note\na,1.5,2,x\nb,3,4,y\n\nc,5,6.25,z\n"


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize("start", ["", "\ufeff"])
def test_columns_names_and_unit(tmp_path: Path, delimiter: str, start: str) -> None:
    path = written(tmp_path, start + GOOD.replace(",", delimiter))
    found = read_pairs(path, reference="reference_cc", measured="measured_cc")
    assert found.names == ("a", "b", "c")
    assert np.array_equal(found.reference, [1.5, 3, 5])
    assert np.array_equal(found.measured, [2, 4, 6.25])
    assert (found.reference_name, found.measured_name, found.unit) == ("reference", "measured", "cc")


def test_subjects_without_names_are_numbered_and_a_strange_ending_is_no_unit(tmp_path: Path) -> None:
    path = written(tmp_path, "mini_one,wright_one\n1,2\n3,4\n5,7\n")
    found = read_pairs(path, reference="wright_one", measured="mini_one")
    assert found.names == ("1", "2", "3")
    assert (found.reference_name, found.unit) == ("wright one", "")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "an empty file"),
        ("id,reference_cc\na,1\n", "columns id, reference_cc"),
        ("reference_cc,reference_cc,measured_cc\n1,2,3\n", "two columns reference_cc"),
        (GOOD.replace("3,4", "3,four"), "row 3, column measured_cc: found 'four'"),
        (GOOD.replace("3,4", "3,"), "row 3, column measured_cc: found no value"),
        (GOOD.replace("b,3,4,y", "b,3"), "row 3, column measured_cc: found no value"),
        (GOOD.replace("3,4", "nan,4"), "row 3, column reference_cc: found 'nan'"),
        (GOOD.replace("5,6.25", "5,6,25"), "row 5: found 5 values"),
        (GOOD.replace(",", ";").replace("6.25", "6,25"), "row 5, column measured_cc: found '6,25'"),
        ("id,reference_cc,measured_cc\na,1,2\nb,3,4\n", "2 rows of measurements"),
    ],
)
def test_bad_tables_are_named_by_row_and_column(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(TableError) as caught:
        read_pairs(written(tmp_path, text), reference="reference_cc", measured="measured_cc")
    assert said in str(caught.value)
    assert caught.value.exit_code == 3


def test_no_file_and_no_text(tmp_path: Path) -> None:
    with pytest.raises(TableError, match="cannot be read"):
        read_pairs(tmp_path / "nothing.csv", reference="a", measured="b")
    (tmp_path / "picture.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(TableError, match="UTF-8"):
        read_pairs(tmp_path / "picture.csv", reference="a", measured="b")


def test_a_table_as_a_german_spreadsheet_writes_it(tmp_path: Path) -> None:
    path = written(tmp_path, "\ufeffid;reference_cc;measured_cc\r\na;1,5;2\r\nb;3;4\r\nc;5;6,25\r\n")
    found = read_pairs(path, reference="reference_cc", measured="measured_cc")
    assert np.array_equal(found.reference, [1.5, 3, 5])
    assert np.array_equal(found.measured, [2, 4, 6.25])


@pytest.mark.parametrize("published", ["nan", "1e308", "1_0", "inf"])
def test_a_published_figure_is_a_number(tmp_path: Path, published: str) -> None:
    path = tmp_path / "published.toml"
    path.write_text(f"[[figure]]\nwhat = 'x'\nfigure = 't'\npublished = '{published}'\n")
    with pytest.raises(TableError, match="which is not a number"):
        read_published(path)
    path.write_text("a = " + "[" * 100_000)
    with pytest.raises(TableError, match="nested more than"):
        read_published(path)


@pytest.mark.parametrize(
    "text", ["figure = 3", "[[figure]]\nwhat = 'x'", "[[figure]]\nwhat='x'\nfigure='t'\npublished='a'"]
)
def test_bad_published_figures(tmp_path: Path, text: str) -> None:
    path = tmp_path / "published.toml"
    path.write_text(text)
    with pytest.raises(TableError, match="another content"):
        read_published(path)
