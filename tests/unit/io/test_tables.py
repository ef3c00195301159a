"""Tables of pairs: read as they are, refused by row and column."""

from pathlib import Path

import numpy as np
import pytest

from mammometry.base.errors import TableError
from mammometry.base.notices import Notice
from mammometry.io.paired_tables import read_pairs, read_published


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
        ("", "empty"),
        ("id,reference_cc\na,1\n", "id, reference_cc"),
        ("reference_cc,reference_cc,measured_cc\n1,2,3\n", "columns reference_cc"),
        (GOOD.replace("3,4", "3,four"), "found 'four'"),
        (GOOD.replace("3,4", "3,"), "row 3, column measured_cc:"),
        (GOOD.replace("b,3,4,y", "b,3"), "row 3, column measured_cc:"),
        (GOOD.replace("3,4", "nan,4"), "found 'nan'"),
        (GOOD.replace("5,6.25", "5,6,25"), "row 5: found 5 values"),
        (GOOD.replace(",", ";").replace("6.25", "6,25"), "row 5, column measured_cc: found '6,25'"),
        ("id,reference_cc,measured_cc\na,1,2\nb,3,4\n", "2 rows"),
    ],
)
def test_bad_tables_are_named_by_row_and_column(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(TableError) as caught:
        read_pairs(written(tmp_path, text), reference="reference_cc", measured="measured_cc")
    assert said in str(caught.value)
    assert caught.value.exit_code == 3


def test_no_file_and_no_text(tmp_path: Path) -> None:
    with pytest.raises(TableError, match=r"nothing\.csv: "):
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
    with pytest.raises(TableError, match="number"):
        read_published(path)
    path.write_text("a = " + "[" * 100_000)
    with pytest.raises(TableError, match="nested"):
        read_published(path)


@pytest.mark.parametrize(
    "text", ["figure = 3", "[[figure]]\nwhat = 'x'", "[[figure]]\nwhat='x'\nfigure='t'\npublished='a'"]
)
def test_bad_published_figures(tmp_path: Path, text: str) -> None:
    path = tmp_path / "published.toml"
    path.write_text(text)
    with pytest.raises(TableError, match="content"):
        read_published(path)


PATIENTS = "patient,reference_cc,measured_cc\nA,364.6,354.4\nB,434.7,422.3\nC,579,613.4\nD,231.1,209.5\nE,433.4,465.1\n"


def refused(folder: Path, text: str, reference: str = "reference_cc", measured: str = "measured_cc") -> str:
    with pytest.raises(TableError) as caught:
        read_pairs(written(folder, text), reference=reference, measured=measured)
    return str(caught.value)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("Mean,408.6,412.9\n", "row 7: found 'Mean'"),
        ("Mittelwert:,408.6,412.9\n", "a summary"),
        ("mean (n = 5),408.6,412.9\n", "a summary"),
        ("S.D.,126.5,150.6\n", "a summary"),
        ("F,500,510\n∅,423.8,429.1\n", "mean"),
        ("total of all,2042.8,2064.7\n", "sum"),
        ("±,126.3,148.2\n", "deviation"),
        (",408.6,412.9\n", "subject"),
        ("F,-999,300\n", "column reference_cc: found -999"),
        ("F,300,-1\n", "column measured_cc: found -1"),
        ("E,433.4,465.1\n", "row 6"),
    ],
)
@pytest.mark.requirement("R-IN-4")
def test_rows_that_are_no_measurement_are_refused(tmp_path: Path, rows: str, said: str) -> None:
    assert said in refused(tmp_path, PATIENTS + rows)


def test_a_change_may_be_negative(tmp_path: Path) -> None:
    text = "id,change_water_cc,change_3d_cc\na,-12,-10\nb,30,28\nc,-5,2\n"
    found = read_pairs(written(tmp_path, text), reference="change_water_cc", measured="change_3d_cc")
    assert found.measured[0] == -10


def test_the_same_measurements_twice_are_refused(tmp_path: Path) -> None:
    assert "column measured_cc twice" in refused(tmp_path, PATIENTS, "measured_cc")
    same = "id,reference_cc,measured_cc\na,1,1\nb,2,2\nc,3,3\n"
    assert "reference_cc and measured_cc" in refused(tmp_path, same)
    twice = "reference_cc,measured_cc\n" + 2 * "100,101\n220,210\n333,340\n"
    assert "twice" in refused(tmp_path, twice)
    constant = "id,reference_cc,measured_cc\na,400,410\nb,400,410\nc,400,410\n"
    assert "400 and 410" in refused(tmp_path, constant)


@pytest.mark.parametrize(
    ("columns", "row", "unit", "pair", "names"),
    [
        (("tape_cm", "scan_mm"), (21, 211), "mm", (210, 211), ("tape", "scan")),
        (("water_l", "scan_cc"), (0.42, 411), "cc", (420, 411), ("water", "scan")),
        (("water (mL)", "scan [cm³]"), (420, 411), "ml", (420, 411), ("water", "scan")),
        (("water_l", "scan_l"), (420, 411), "", (420, 411), ("water l", "scan l")),
        (("weight_kg", "scan_g"), (0.42, 411), "g", (420, 411), ("weight", "scan")),
    ],
)
def test_units_of_one_kind_are_converted(
    tmp_path: Path, columns: tuple[str, str], row: tuple[float, float], unit: str, pair: tuple[float, float],
    names: tuple[str, str],
) -> None:  # fmt: skip
    text = f"id;{columns[0]};{columns[1]}\n" + "".join(f"{k};{k * row[0]};{k * row[1]}\n" for k in (1, 2, 3))
    found = read_pairs(written(tmp_path, text), reference=columns[0], measured=columns[1])
    assert found.unit == unit
    assert (found.reference[0], found.measured[0]) == pytest.approx(pair)
    assert (found.reference_name, found.measured_name) == names
    assert found.notices == ()


def test_units_of_two_kinds_are_refused(tmp_path: Path) -> None:
    text = "id,tape_cm,scan_cc\na,21,300\nb,22,310\nc,23,350\n"
    assert "tape_cm" in refused(tmp_path, text, "tape_cm", "scan_cc")


def test_what_is_doubtful_is_said(tmp_path: Path) -> None:
    text = "id,water,scan_cc\na,290,300\nb,300,310\nc,310,999\n"
    found = read_pairs(written(tmp_path, text), reference="water", measured="scan_cc")
    assert found.notices == (
        Notice(code="value-may-be-missing", values={"column": "scan_cc", "value": 999.0, "row": "c"}),
        Notice(code="unit-assumed", values={"column": "water", "unit": "cc"}),
    )
    litres = text.replace("290", "0.29").replace("300,310", "0.30,310").replace("310,999", "0.31,320")
    assert "water: " in refused(tmp_path, litres, "water", "scan_cc")
    text = litres.replace("scan_cc", "scan")
    (notice,) = read_pairs(written(tmp_path, text), reference="water", measured="scan").notices
    assert (notice.code, notice.values["measured"]) == ("columns-differ", "scan")


@pytest.mark.parametrize(
    ("head", "rows", "names", "subjects"),
    [
        ("patient,side", ("P1,left", "P1,right", "P2,left", "p2,right", "P3,left"), "P1, left", "p1 p1 p2 p2 p3"),
        ("id,note", ("P1 left,", "P1 right,", "P2 (L),", "P2-r,", "P3_left,"), "P1 left", "p1 p1 p2 p2 p3"),
        ("id,note", ("7L,", "7R,", "8L,", "8R,", "9L,"), "7L", "7 7 8 8 9"),
        ("side,patient_id", ("left,A", "right,A", "left,B", "right,B", "left,C"), "A, left", "a a b b c"),
        ("id,patient", ("1,A", "2,A", "3,B", "4,B", "5,C"), "A", "a a b b c"),
        ("id,note", ("jürg,", "ju\u0308rg,", "Jürg,", "ben,", "eva,"), "jürg", "jürg jürg jürg ben eva"),
    ],
)
def test_both_breasts_of_a_woman_are_one_subject(
    tmp_path: Path, head: str, rows: tuple[str, ...], names: str, subjects: str
) -> None:
    text = f"{head},reference_cc,measured_cc\n"
    text += "".join(f"{row},{300 + 17.5 * k},{290 + 19 * k}\n" for k, row in enumerate(rows))
    found = read_pairs(written(tmp_path, text), reference="reference_cc", measured="measured_cc")
    assert found.names[0] == names
    assert " ".join(found.subjects) == subjects


def test_subjects_without_both_sides_keep_their_names(tmp_path: Path) -> None:
    text = "id,reference_cc,measured_cc\nAnna L,300,310\nBea R,200,220\nCleo L,400,410\nMax,500,520\n"
    assert read_pairs(written(tmp_path, text), reference="reference_cc", measured="measured_cc").subjects == ()
    text = "side,reference_cc,measured_cc\nleft,300,310\nright,200,220\nleft,400,410\n"
    found = read_pairs(written(tmp_path, text), reference="reference_cc", measured="measured_cc")
    assert (found.subjects, found.names[1]) == ((), "2, right")
    assert "2 subjects" in refused(tmp_path, "id,reference_cc,measured_cc\na,3,4\na,5,6\nb,7,8\n")
