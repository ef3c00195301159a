"""Tables of several countries: each number is what its writer meant, or it is refused with both readings."""

from pathlib import Path

import numpy as np
import pytest

from mammometry.base.errors import SessionError, TableError
from mammometry.batch.entries import find_entries
from mammometry.io.csv_tables import read_table
from mammometry.io.paired_tables import read_pairs

READ = [
    ("id;cc\n1;1860\n2;950\n", [1860, 950]),
    ("id;cc\n1;1,860.5\n2;950\n3;1,860\n", [1860.5, 950, 1860]),
    ("id;cc\n1;1.860,5\n2;950\n3;1.860\n", [1860.5, 950, 1860]),
    ("id;cc\n1;1,860,000\n2;1,860\n", [1_860_000, 1860]),
    ("id;cc\n1;1.860.000\n2;1.860\n", [1_860_000, 1860]),
    ("id;cc\n1;1,860\n2;950,5\n", [1.86, 950.5]),
    ("id;cc\n1;1,860\n2;0,950\n", [1.86, 0.95]),
    ("id;cc\n1;1,860e3\n2;1,5\n", [1860, 1.5]),
    ("id,cc\n1,1.860\n2,1.234\n", [1.86, 1.234]),
    ("id,cc\n0,123.456\n1,234.567\n", [123.456, 234.567]),
    ('id,cc\n1,"1,860.5"\n2,"1,020"\n', [1860.5, 1020]),
    ('id,cc\n1,"1,5"\n2,"2,25"\n', [1.5, 2.25]),
    ("id\tcc\n1\t-1,860.5\n2\t+2\n", [-1860.5, 2]),
    ("sep=;\nid;cc\n1;2,5\n", [2.5]),
    ('"sep=;"\r\nid;cc\r\n1;2,5\r\n', [2.5]),
    ("\ufeffsep=\t\nid\tcc\n1\t2,5\n", [2.5]),
    ("SEP=|;;\nid|cc\n1|2.5\n", [2.5]),
    ("\n\nid;cc\n1;2,5\n", [2.5]),
    ("id;cc\r1;2,25\r2;3,75\r", [2.25, 3.75]),
]
REFUSED = [
    ("id;cc\n1;1,860\n2;1860\n", "'1,860', which may mean 1860 or"),
    ("id;cc\n1;1.860\n2;1.234\n", r"'1\.860', which may mean 1860 or"),
    ("id\tcc\n1\t354\n2\t1,422\n3\t1579\n", "'1,422', which may mean 1422 or"),
    ("id;cc\n1;1,860\n2;950\n", r"row 2, column cc: found '1,860', which may mean 1860 or 1\.86, expected"),
    ("id;cc\n1;950\n2;1.860\n", r"row 3, column cc: found '1\.860', which may mean 1860 or 1\.86, expected"),
    ('id,cc\n1,"1,860"\n2,950\n', "'1,860', which may mean 1860 or"),
    ("id;cc\n1;1,860\n2;1,020\n", "'1,860', which may mean 1860 or"),
    ("id;cc\n1;1,860\n2;1.020\n", "'1,860', which may mean 1860 or"),
    ("id;cc\n1;1.5\n2;1,860\n", r"'1,860', which may mean 1860 or 1\.86, expected a number with a decimal point"),
    ("id;cc\n1;1.5\n2;1,5\n", "'1,5', expected a number with a decimal point"),
    ("id;cc\n1;1 860\n", "'1 860', expected a number"),
    ("id;cc\n1;1'860\n", "expected a number"),
    ("id;cc\n1;1,860.5\n2;18,60.5\n", r"'18,60\.5', expected a number"),
    ("id;cc\n1;1,86,000.5\n", "expected a number"),
]


@pytest.mark.parametrize(("text", "values"), READ, ids=[ascii(text) for text, _ in READ])
def test_the_column_settles_what_a_mark_means(tmp_path: Path, text: str, values: list[float]) -> None:
    (tmp_path / "a.csv").write_bytes(text.encode())
    np.testing.assert_array_equal(read_table(tmp_path / "a.csv", "a", "b").numbers("cc")[:, 0], values)


@pytest.mark.parametrize(("text", "sentence"), REFUSED, ids=[ascii(text) for text, _ in REFUSED])
@pytest.mark.requirement("R-IN-4")
def test_a_number_that_may_mean_two_is_refused(tmp_path: Path, text: str, sentence: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(SessionError, match=sentence):
        read_table(tmp_path / "a.csv", "a", "b").numbers("cc")


def test_another_column_settles_it_too(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("id;u;v\n0;123,456;1,5\n1;7;2\n")
    read = read_table(tmp_path / "a.csv", "a", "b").numbers("id", "u", "v")
    np.testing.assert_array_equal(read, [[0, 123.456, 1.5], [1, 7, 2]])


def test_lines_are_counted_from_the_first_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("sep=;\n\nid;cc\n1;2,5\n2;much\n")
    with pytest.raises(SessionError, match="row 5, column cc"):
        read_table(tmp_path / "a.csv", "a", "b").numbers("cc")


def test_every_reader_of_a_table_does_the_same(tmp_path: Path) -> None:
    """A batch's references had a reading of their own: a comma was always a decimal one."""
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "session.toml").write_text("")
    table = tmp_path / "study.csv"
    table.write_text("session;reference_cc\na;1,860\n")
    with pytest.raises(TableError, match=r"1860 or 1\.86"):
        find_entries([str(table)])
    table.write_text("session;reference_left_cc;reference_right_cc\na;1,860.5;\n")
    (entry,) = find_entries([str(table)])
    assert entry.reference_cc == {"left": 1860.5}
    for text in (
        "m;a_cc;b_cc\n1;1,860;1,850\n2;950;960\n3;700;701\n",
        "m\ta_cc\tb_cc\n1\t1860\t1,860\n2\t1364\t1,354\n3\t1434\t1,422\n",
        "m,a_cc,b_cc\n1,1860,1.860\n2,1364,1.354\n3,1434,1.422\n",
        "m;a_cc;b_cc\n1;1860.5;1.860\n2;364.2;1.354\n3;434;1.422\n",  # the other column shows a decimal point
    ):
        table.write_text(text)
        with pytest.raises(TableError, match=r"1860 or 1\.86"):
            read_pairs(table, reference="a_cc", measured="b_cc")
