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
        ("mesh,boundary,observer\nf.ply,a.json,\n", "row 2: found an empty cell"),
        ("mesh,boundary,observer\nf.ply,a.json,Anna\nf.ply,b.json,Anna\n", "a second drawing 1 of f.ply by Anna"),
        ("mesh,boundary\nf.ply,a.json\n", "one column observer"),
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
