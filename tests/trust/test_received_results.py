"""Results that came from elsewhere: whatever they name, nothing outside their folder is read, changed or removed."""

import hashlib
import json
import logging
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from small_products import NAMES, contents, key, make

from mammometry.io.results.store import Store
from mammometry.io.sealed import sealed, unsealed

pytestmark = pytest.mark.usefixtures("quick")
ABSOLUTE = "/ABSOLUTE"


@pytest.fixture
def results(tmp_path: Path) -> Path:
    (tmp_path / "precious.txt").write_text("precious")
    folder = tmp_path / "session" / "results"
    folder.mkdir(parents=True)
    store = Store(folder)
    with store.taken():
        for name in NAMES:
            make(store, name, 1)
    return folder


def precious(results: Path) -> Path:
    return results.parents[1] / "precious.txt"


def answered(data: bytes) -> dict[str, Any]:
    return {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}


def change_record(results: Path, product: str, change: Callable[[dict[str, Any]], None]) -> None:
    path = results / "surface" / "provenance.json"
    table, _ = unsealed(path.read_bytes())
    change(table["products"][product])
    path.write_bytes(sealed(table))  # whoever means harm gives it a digest


def run(results: Path, version: int = 2) -> Store:
    store = Store(results)
    with store.taken():
        for name in NAMES:
            make(store, name, version)
    assert all(store.state(key(name, version)) == "current" for name in NAMES)
    return store


def left_ready(results: Path, record: dict[str, Any] | None = None, **changes: Any) -> Path:
    """A product that an interrupted run left ready: first, version 1, with a record that may be changed."""
    old = json.loads((results / "surface" / "provenance.json").read_text())["products"]["mesh"]
    ready = results / ".ready-surface-mesh-1"
    (ready / "surface").mkdir(parents=True)
    about = {"stage": "surface", "product": "mesh", "record": {**old, **(record or {})}} | changes
    (ready / "record.json").write_text(json.dumps(about))
    return ready


HOSTILE = ["../../../precious.txt", ABSOLUTE, "sub/../../../../precious.txt", "..\\..\\..\\precious.txt", "C:\\x",
           "C:x", "mesh.ply:stream", ".", "..", "", "a//b", "a/", "nul\0", "provenance.json", "Provenance.JSON",
           "provenance.json.", "provenance.json ", ".lock", "line\nbreak"]  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("where", ["record in place", "record ready"])
@pytest.mark.requirement("R-LOSS-8")
def test_names_that_lead_elsewhere(results: Path, name: str, where: str) -> None:
    name = name.replace(ABSOLUTE, str(precious(results)))
    files = {"files": {name: answered(b"precious")}}
    if where == "record ready":
        ready = left_ready(results, files)
        if not name.startswith("/") and ".." not in name and "\0" not in name and name not in ("", ".", "a/"):
            (ready / "surface" / name).parent.mkdir(exist_ok=True)
            (ready / "surface" / name).write_bytes(b"precious")
    else:
        change_record(results, "mesh", lambda record: record.update(files))
        assert Store(results).state(key("mesh", 1)) == "absent"
        assert Store(results).state(key("blocked", 1)) == "current"  # the others still count
    run(results)
    assert precious(results).read_text() == "precious"
    assert not [path.name for path in results.iterdir() if path.name.startswith(".ready")]


INVALID: dict[str, Callable[[dict[str, Any]], object]] = {
    "no files": lambda record: record.pop("files"),
    "a list of files": lambda record: record.update(files=["mesh.ply"]),
    "no digest": lambda record: record.update(files={"mesh.ply": {"bytes": 3}}),
    "a digest that is none": lambda record: record.update(files={"mesh.ply": {"bytes": 3, "sha256": "00"}}),
    "a number as text": lambda record: record.update(version="1"),
    "negative bytes": lambda record: record.update(files={"mesh.ply": {**answered(b""), "bytes": -1}}),
    "no time": lambda record: record.update(made=None),
    "seconds that are none": lambda record: record.update(seconds="soon"),
    "more than there is": lambda record: record.update(run="rm -r"),
    "no key": lambda record: record.pop("key"),
}


@pytest.mark.parametrize("change", INVALID.values(), ids=INVALID)
def test_an_invalid_record_is_none(results: Path, change: Callable[[dict[str, Any]], object]) -> None:
    before = contents(results)
    change_record(results, "mesh", lambda record: change(record) and None)
    assert Store(results).state(key("mesh", 1)) == "absent"
    store = run(results, 1)
    assert store.made == ["surface/mesh"]
    assert contents(results) == before


OTHER = '{"format": 1, "stage": "match", "products": {}}'
UNREADABLE = ["", "{", "null", "[]", '{"format": 1}', OTHER.replace("{}", "3"), "[" * 100_000, "\xff", OTHER]


@pytest.mark.parametrize("text", UNREADABLE)
@pytest.mark.parametrize("name", ["surface/provenance.json", ".ready-surface-mesh-1/record.json"])
def test_unreadable_records_are_none_and_block_nothing(results: Path, text: str, name: str) -> None:
    before = contents(results)
    left_ready(results)
    (results / name).write_bytes(text.encode("latin-1"))
    run(results, 1)
    assert contents(results) == before
    assert not [path.name for path in results.iterdir() if path.name.startswith((".ready", ".set-aside"))]


@pytest.mark.parametrize("what", ["no record", "a record of nothing", "files missing", "other bytes"])
def test_a_leftover_that_cannot_be_finished_goes(results: Path, what: str) -> None:
    before = contents(results)
    ready = left_ready(results, None if what != "other bytes" else {"key": "0" * 64})
    if what == "no record":
        (ready / "record.json").unlink()
    if what == "a record of nothing":
        (ready / "record.json").write_text("")
    if what == "files missing":
        left_record = json.loads((ready / "record.json").read_text())
        left_record["record"]["files"] = {"gone.ply": answered(b"gone")}
        (ready / "record.json").write_text(json.dumps(left_record))
    if what == "other bytes":
        (ready / "surface" / "mesh.ply").write_bytes(b"half")
        (results / "surface" / "mesh.ply").write_bytes(b"half")
        run(results, 1)
    assert run(results, 1).made == []  # the older result was not lost
    assert contents(results) == before
    assert sorted(path.name for path in results.iterdir()) == [".lock", "measure", "surface"]


def test_a_leftover_older_than_what_is_there_goes(results: Path) -> None:
    old = (results / "surface" / "mesh.ply").read_bytes()
    ready = left_ready(results, {"made": "2001-01-01T00:00:00+00:00"})
    run(results, 2)
    for name in ("record.json", "surface"):
        assert not (ready / name).exists()
    new = contents(results)
    ready = left_ready(results, {"made": "2001-01-01T00:00:00+00:00", "files": {"mesh.ply": answered(old)}})
    (ready / "surface" / "mesh.ply").write_bytes(old)
    assert run(results, 2).made == []
    assert contents(results) == new


def test_what_is_not_ours_is_set_aside(results: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    left = results / ".ready-notes"
    left.mkdir()
    (left / "notes.txt").write_text("mine")
    (results / ".writing-plan.txt").write_text("mine too")
    run(results)
    assert (results / ".set-aside-ready-notes-1" / "notes.txt").read_text() == "mine"
    assert (results / ".set-aside-writing-plan.txt-1").read_text() == "mine too"
    assert len([line for line in caplog.messages if "is not ours" in line]) == 2


def test_a_file_that_was_changed_is_not_removed_with_its_product(results: Path) -> None:
    notes = results / "surface" / "only-1.png"  # version 2 of the pictures has it no more
    notes.write_text("drawn over by somebody")
    (results / "surface" / "notes.txt").write_text("mine")
    change_record(results, "mesh", lambda record: record["files"].update({"notes.txt": answered(b"yours")}))
    run(results)
    assert notes.read_text() == "drawn over by somebody"
    assert (results / "surface" / "notes.txt").read_text() == "mine"


def test_a_record_that_names_another_products_file(results: Path) -> None:
    blocked = (results / "surface" / "blocked.npz").read_bytes()
    change_record(results, "mesh", lambda record: record["files"].update({"blocked.npz": answered(blocked)}))
    store = Store(results)
    with store.taken():
        make(store, "mesh", 2)
    assert store.state(key("blocked", 1)) == "current"


# --- links ---


@pytest.fixture
def outside(results: Path) -> Path:
    """A folder outside the session that has what a stage's folder has."""
    folder = results.parents[1] / "outside"
    folder.mkdir()
    for path in (results / "surface").iterdir():
        if path.is_file():
            (folder / path.name).write_bytes(path.read_bytes())
    return folder


def snapshot(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_stages_folder_that_is_a_link(results: Path, outside: Path) -> None:
    (results / "surface").rename(results / "was")
    (results / "surface").symlink_to(outside, target_is_directory=True)
    before = snapshot(outside)
    assert Store(results).state(key("mesh", 1)) == "absent"
    run(results)
    assert snapshot(outside) == before
    assert not (results / "surface").is_symlink()


@pytest.mark.parametrize("name", ["mesh.ply", "sub", "provenance.json"])
def test_a_link_inside_a_stages_folder(results: Path, outside: Path, name: str) -> None:
    path = results / "surface" / name
    if name == "sub":
        (path / "c.png").rename(outside / "c.png")
        path.rmdir()
        path.symlink_to(outside, target_is_directory=True)
    else:
        path.unlink()
        path.symlink_to(outside / name)
    before = snapshot(outside)
    product = "pictures" if name == "sub" else "mesh"
    assert Store(results).state(key(product, 1)) in ("damaged", "absent")
    run(results, 1)
    run(results, 2)
    assert snapshot(outside) == before
    assert not path.is_symlink()


@pytest.mark.parametrize("where", ["", "surface", "surface/mesh.ply", "provenance.json", "record.json"])
@pytest.mark.requirement("R-LOSS-8")
def test_a_leftover_with_links(results: Path, outside: Path, where: str) -> None:
    ready = left_ready(results, {"made": "2099-01-01T00:00:00+00:00"})
    (ready / "surface" / "mesh.ply").write_bytes((outside / "mesh.ply").read_bytes())
    (outside / "surface").mkdir()
    (outside / "record.json").write_bytes((ready / "record.json").read_bytes())
    (outside / "surface" / "mesh.ply").write_bytes((outside / "mesh.ply").read_bytes())
    path = ready / where if where else ready
    if path.is_dir():
        path.rename(results / "was")
    else:
        path.unlink(missing_ok=True)
    path.symlink_to(outside / where if where else outside)
    before = snapshot(outside)
    run(results)
    assert snapshot(outside) == before


def test_results_that_are_a_link(results: Path, outside: Path) -> None:
    from mammometry.base.errors import StorageError

    results.rename(results.with_name("was"))
    results.symlink_to(outside, target_is_directory=True)
    before = snapshot(outside)
    with pytest.raises(StorageError, match=r"results: .*link"), Store(results).taken():
        pass
    assert snapshot(outside) == before


@pytest.mark.parametrize("name", [".lock", ".lock-holder"])
def test_a_lock_that_is_a_link(results: Path, name: str) -> None:
    from mammometry.base.errors import StorageError

    (results / name).unlink(missing_ok=True)
    (results / name).symlink_to(precious(results))
    if name == ".lock":
        with pytest.raises(StorageError, match=r"link"), Store(results).taken():
            pass
    else:
        run(results)
    assert precious(results).read_text() == "precious"


@pytest.mark.parametrize("name", ["mesh.ply", "provenance.json", "sub"])
def test_something_else_of_that_name(results: Path, name: str) -> None:
    path = results / "surface" / name
    if name == "sub":
        (path / "c.png").unlink()
        path.rmdir()
        os.mkfifo(path)
    else:
        path.unlink()
        path.mkdir()
        (path / "mine.txt").write_text("mine")
    run(results)
    if name != "sub":
        assert [found.read_text() for found in results.rglob("mine.txt")] == ["mine"]
