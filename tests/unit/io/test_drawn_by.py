"""Who drew what: a folder of boundary files, or a table."""

from pathlib import Path

import pytest

from mammometry.api.observers import read_drawn_by
from mammometry.base.errors import SessionError, TableError


def test_a_folder_names_persons_and_their_drawings(tmp_path: Path) -> None:
    for name in ("anna-1.json", "anna-2.json", "dr-ben.json", "notes.txt"):
        (tmp_path / name).write_text("{}")
    found = read_drawn_by(tmp_path, Path("front.ply"))
    assert [(each.observer, each.repeat) for each in found] == [("anna", "1"), ("anna", "2"), ("dr-ben", "1")]
    assert {each.mesh for each in found} == {Path("front.ply")}


def test_a_tables_paths_are_relative_to_it(tmp_path: Path) -> None:
    table = tmp_path / "data" / "who.csv"
    table.parent.mkdir()
    table.write_text(
        "mesh;boundary;observer;repeat\nf.ply;a/1.json;Anna;1\nf.ply;a/2.json;Anna;2\ng.ply;b.json;Ben;1\n"
    )
    found = read_drawn_by(table)
    assert found[1].boundary == table.parent / "a" / "2.json"
    assert [each.mesh.name for each in found] == ["f.ply", "f.ply", "g.ply"]
    assert [each.repeat for each in found] == ["1", "2", "1"]


def test_without_columns_for_them_there_is_one_mesh_and_one_drawing_each(tmp_path: Path) -> None:
    table = tmp_path / "who.csv"
    table.write_text("boundary,observer\na.json,Anna\nb.json,Ben\n")
    found = read_drawn_by(table, tmp_path / "front.ply")
    assert {each.mesh for each in found} == {tmp_path / "front.ply"}
    assert {each.repeat for each in found} == {"1"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("mesh,boundary,observer\nf.ply,a.json,\n", r"row 2: .*empty"),
        ("mesh,boundary,observer\nf.ply,a.json,Anna\nf.ply,b.json,Anna\n", r"second.* 1 .*f\.ply.*Anna"),
        ("mesh,boundary\nf.ply,a.json\n", "observer"),
    ],
)
def test_a_table_that_tells_too_little_is_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "who.csv").write_text(text)
    with pytest.raises(TableError, match=said):
        read_drawn_by(tmp_path / "who.csv")


def test_one_drawing_or_no_mesh_is_refused(tmp_path: Path) -> None:
    (tmp_path / "anna.json").write_text("{}")
    with pytest.raises(SessionError, match="1 drawings"):
        read_drawn_by(tmp_path, Path("front.ply"))
    with pytest.raises(SessionError, match="--mesh"):
        read_drawn_by(tmp_path)


def persons(folder: Path, *names: str) -> list[tuple[str, str]]:
    for name in names:
        (folder / name).write_text("{}")
    return [(drawing.observer, drawing.repeat) for drawing in read_drawn_by(folder, Path("front.ply"))]


def test_a_name_is_one_person_however_its_letters_are_stored(tmp_path: Path) -> None:
    """MacOS stores ü as u and a mark, and some disks distinguish upper and lower case."""
    found = persons(tmp_path, "j\u00fcrg-1.json", "ju\u0308rg-2.json", "Anna-1.json", "anna-02.json")
    assert len(found) == 4
    assert {name for name, _ in found} == {"Anna", found[-1][0]}
    table = tmp_path / "who.csv"
    table.write_text("boundary,observer,repeat\na.json,J\u00fcrg,1\nb.json,ju\u0308rg,1\n", encoding="utf-8")
    with pytest.raises(TableError, match=r"row 3: .*\b1\b"):
        read_drawn_by(table, tmp_path / "front.ply")


def test_one_drawing_under_two_names_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SessionError, match=r"\b1 .*Anna, .*Anna-1\.json"):
        persons(tmp_path, "Anna-1.json", "anna-1.json", "ben.json")


@pytest.mark.parametrize(
    "name", ["anna-1 (1).json", "anna-1 copy.json", "anna-1 - Kopie (2).json", "Copy of anna-1.json"]
)
def test_copies_are_refused_by_name(tmp_path: Path, name: str) -> None:
    with pytest.raises(SessionError, match="copy"):
        persons(tmp_path, "anna-1.json", name)


def test_words_that_need_their_number_name_a_person_with_it(tmp_path: Path) -> None:
    found = persons(tmp_path, "rater-1.json", "rater-2.json", "Rater-3-1.json", "Rater-3-2.json")
    assert sorted(found) == [("Rater-3", "1"), ("Rater-3", "2"), ("rater-1", "1"), ("rater-2", "1")]


def test_what_systems_leave_in_a_folder_is_no_drawing(tmp_path: Path) -> None:
    (tmp_path / "._anna-1.json").write_bytes(b"\x00\x05\x16\x07\x00\x02\x00\x00Mac OS X")
    assert persons(tmp_path, ".DS_Store", "anna-1.json", "ben-1.json") == [("anna", "1"), ("ben", "1")]


UNCLEAR = [("anna_1.json", "anna_2.json"), ("anna1.json", "Anna2.json"), ("anna 1.json", "anna 2.json")]


@pytest.mark.parametrize("names", UNCLEAR)
def test_numbers_without_a_hyphen_may_mean_two_things(tmp_path: Path, names: tuple[str, str]) -> None:
    with pytest.raises(SessionError, match=r"[Aa]nna-[12]\.json .*[12]"):
        persons(tmp_path, *names)


def test_raters_with_a_number_are_persons(tmp_path: Path) -> None:
    assert len({name for name, _ in persons(tmp_path, "rater1.json", "rater2.json", "R3.json", "observer_4.json")}) == 4
