"""Files in the way: what is ours is known by its record, everything else stays."""

import json
import os
import re
from pathlib import Path

import pytest

from mammometry.base.errors import StorageError
from mammometry.io import outputs
from mammometry.io.outputs import (
    RECORD,
    require_apart,
    require_free,
    require_own_folder,
    take_folder,
    write_output,
    write_outputs,
)

FILES = {"page.html": b"one", "numbers.json": b"{}"}


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_same_command_replaces_and_removes_what_it_wrote(tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    write_outputs(out, FILES, command="compare")
    (out / "mine.txt").write_text("mine")
    write_outputs(out, {"page.html": b"two"}, command="compare")
    assert names(out) == [RECORD, "mine.txt", "page.html"]
    assert (out / "page.html").read_bytes() == b"two"
    write_outputs(out, FILES, command="compare")
    assert (out / "numbers.json").read_bytes() == b"{}"


def test_what_was_changed_since_is_refused_where_it_is_in_the_way_and_kept_elsewhere(tmp_path: Path) -> None:
    write_outputs(tmp_path, FILES, command="compare")
    (tmp_path / "numbers.json").write_bytes(b"{1}")
    with pytest.raises(StorageError, match=r"numbers\.json: .*changed"):
        write_outputs(tmp_path, {**FILES, "page.html": b"two"}, command="compare")
    assert (tmp_path / "page.html").read_bytes() == b"one"
    write_outputs(tmp_path, {"page.html": b"two"}, command="compare")
    assert (tmp_path / "numbers.json").read_bytes() == b"{1}"


def test_another_commands_file_is_not_ours(tmp_path: Path) -> None:
    write_outputs(tmp_path, FILES, command="compare")
    with pytest.raises(StorageError, match="`mammometry compare`"):
        write_output(tmp_path / "page.html", b"two", command="report")
    write_output(tmp_path / "figure.pdf", b"figure", command="figure")
    write_output(tmp_path / "other.pdf", b"figure", command="figure")
    write_outputs(tmp_path, FILES, command="compare")
    assert names(tmp_path) == [RECORD, "figure.pdf", "numbers.json", "other.pdf", "page.html"]


@pytest.mark.parametrize("kind", ["file", "folder", "link", "dangling link", "hard link"])
def test_whatever_is_in_the_way_stays(tmp_path: Path, kind: str) -> None:
    out, mine = tmp_path / "out", tmp_path / "mine.html"
    out.mkdir()
    mine.write_text("mine")
    path = out / "page.html"
    match kind:
        case "file":
            path.write_text("mine")
        case "folder":
            path.mkdir()
        case "link":
            path.symlink_to(mine)
        case "dangling link":
            path.symlink_to(tmp_path / "nowhere")
        case "hard link":
            os.link(mine, path)
    before = os.lstat(path)
    with pytest.raises(StorageError, match=r"page\.html: "):
        write_outputs(out, FILES, command="compare")
    assert names(out) == ["page.html"]
    assert os.lstat(path) == before
    assert mine.read_text() == "mine"


def test_a_link_to_what_we_wrote_is_not_what_we_wrote(tmp_path: Path) -> None:
    write_outputs(tmp_path, FILES, command="compare")
    (tmp_path / "page.html").rename(tmp_path / "kept.html")
    (tmp_path / "page.html").symlink_to("kept.html")
    with pytest.raises(StorageError, match="mammometry"):
        write_outputs(tmp_path, FILES, command="compare")


@pytest.mark.parametrize(
    "record",
    [
        "mine",
        "[]",
        '{"format": 2, "files": {}}',
        '{"format": 1}',
        *(
            json.dumps({"format": 1, "files": {name: {"command": "compare", "sha256": []}}})
            for name in ("../mine.txt", "/etc/passwd", "..", ".", "", "a/b", RECORD, "a\0b")
        ),
    ],
)
def test_a_record_that_is_none_is_refused_and_stays(tmp_path: Path, record: str) -> None:
    (tmp_path / RECORD).write_text(record)
    with pytest.raises(StorageError, match=rf"{re.escape(RECORD)}: "):
        write_outputs(tmp_path, FILES, command="compare")
    assert names(tmp_path) == [RECORD]
    assert (tmp_path / RECORD).read_text() == record


def test_the_record_is_no_link_and_no_output(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="record"):
        write_output(tmp_path / RECORD, b"figure", command="figure")
    other = tmp_path / "other.json"
    other.write_text('{"format": 1, "files": {}}')
    (tmp_path / RECORD).symlink_to(other)
    with pytest.raises(StorageError, match="a link"):
        write_outputs(tmp_path, FILES, command="compare")
    assert other.read_text() == '{"format": 1, "files": {}}'


def test_a_name_with_odd_letters_comes_back(tmp_path: Path) -> None:
    for _ in range(2):
        write_output(tmp_path / "a:b\\c ü \udcff.pdf", b"figure", command="figure")


def test_an_interrupted_removal_is_made_good(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_outputs(tmp_path, FILES, command="compare")

    def stopped(self: Path, missing_ok: bool = False) -> None:
        if self.name == "numbers.json":
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", stopped)
        with pytest.raises(KeyboardInterrupt):
            write_outputs(tmp_path, {"page.html": b"two"}, command="compare")
    assert (tmp_path / "numbers.json").exists()
    write_outputs(tmp_path, {"page.html": b"three"}, command="compare")
    assert not (tmp_path / "numbers.json").exists()


@pytest.mark.parametrize("stop_at", [1, 2, 3])
def test_after_an_interruption_the_same_command_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stop_at: int
) -> None:
    """Whichever rename was the last one: the record, or one of the two files."""
    write_outputs(tmp_path, FILES, command="compare")
    done = 0
    rename = Path.replace

    def stopping(self: Path, target: Path) -> Path:
        nonlocal done
        done += 1
        if done > stop_at:
            raise KeyboardInterrupt
        return rename(self, target)

    newer = {name: data + b"newer" for name, data in FILES.items()}
    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", stopping)
        if stop_at < 3:
            with pytest.raises(KeyboardInterrupt):
                write_outputs(tmp_path, newer, command="compare")
        else:
            write_outputs(tmp_path, newer, command="compare")
    newest = {name: data + b"newest" for name, data in FILES.items()}
    write_outputs(tmp_path, newest, command="compare")
    assert names(tmp_path) == sorted([RECORD, *FILES])
    assert {name: (tmp_path / name).read_bytes() for name in FILES} == newest


def test_who_comes_in_between_keeps_his_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After the last look, before the file gets its name."""
    record = outputs._record

    def slow(folder: Path, files: object) -> None:
        record(folder, files)
        (folder / "page.html").write_text("mine")

    monkeypatch.setattr(outputs, "_record", slow)
    with pytest.raises(StorageError, match="exists"):
        write_outputs(tmp_path, FILES, command="compare")
    assert (tmp_path / "page.html").read_text() == "mine"


def test_a_disk_without_links_will_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", refuse)
    write_outputs(tmp_path, FILES, command="compare")
    assert names(tmp_path) == sorted([RECORD, *FILES])


def test_a_file_where_the_folder_is_to_be_stays(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("mine")
    for refuse in (require_free, lambda out, *_, **how: require_own_folder(out, **how)):
        with pytest.raises(StorageError, match=r"\bout: "):
            refuse(tmp_path / "out", [], command="compare")
    assert (tmp_path / "out").read_text() == "mine"


def test_a_folder_of_ones_own(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out"
    take_folder(out, command="measure")
    (out / "anything").write_text("")
    take_folder(out, command="measure")
    write_output(out / "figure.pdf", b"figure", command="figure")
    take_folder(out, command="measure")
    with pytest.raises(StorageError, match="folder"):
        take_folder(out, command="another")
    with pytest.raises(StorageError, match="folder"):
        take_folder(tmp_path, command="measure")
    assert names(tmp_path) == ["deep"]


# --- apart ---


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """data/table.csv, data/set/photo.jpg; link → data, linked/table.csv → data/table.csv; we stand in the folder."""
    (tmp_path / "data" / "set").mkdir(parents=True)
    (tmp_path / "linked").mkdir()
    (tmp_path / "data" / "table.csv").write_text("table")
    (tmp_path / "data" / "set" / "photo.jpg").write_text("photo")
    (tmp_path / "link").symlink_to("data")
    (tmp_path / "linked" / "table.csv").symlink_to("../data/table.csv")
    (tmp_path / "hard").mkdir()
    os.link(tmp_path / "data" / "table.csv", tmp_path / "hard" / "same.csv")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("out", "read"),
    [
        ("data", "data/table.csv"),
        (".", "data/table.csv"),
        ("link", "data/table.csv"),
        ("data", "link/table.csv"),
        ("new/../data", "data/table.csv"),
        ("data/set/..", "data/table.csv"),
        ("linked", "linked/table.csv"),  # the link lies there
        ("data", "linked/table.csv"),  # the file lies there
        ("data/table.csv", "data/table.csv"),
        ("linked/table.csv", "data/table.csv"),
        ("hard/same.csv", "data/table.csv"),
        ("data/set", "data/set"),
        ("data/set/out", "data/set"),
        ("link/set/deep/out", "data/set"),
        ("data", "data/set"),
    ],
)
def test_places_that_are_not_apart(place: Path, out: str, read: str) -> None:
    with pytest.raises(StorageError, match=rf"{Path(read).name}|{Path(out).name}"):
        require_apart(Path(out), [Path(read)])
    with pytest.raises(StorageError):
        require_apart(place / out, [Path(read)])


@pytest.mark.parametrize(
    ("out", "read"),
    [("data/out", "data/table.csv"), ("out", "data/set"), ("hard", "data/table.csv"), ("data", "data/absent.csv")],
)
def test_places_that_are_apart(place: Path, out: str, read: str) -> None:
    require_apart(Path(out), [Path(read)])
