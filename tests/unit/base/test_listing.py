"""What systems leave in a folder is not listed."""

from pathlib import Path

from mammometry.base.listing import is_hidden, visible


def test_only_what_a_person_put_there_is_listed_by_name(tmp_path: Path) -> None:
    for name in ("b.jpg", "a.jpg", "._a.jpg", ".DS_Store", "Thumbs.db", "desktop.ini"):
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "__MACOSX").mkdir()
    (tmp_path / "pose").mkdir()
    assert [path.name for path in visible(tmp_path)] == ["a.jpg", "b.jpg", "pose"]
    assert visible(tmp_path / "nowhere") == []
    assert not is_hidden("a.b._c")
