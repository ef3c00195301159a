"""Whether results are as they were written: flipped bytes are found where results are shown, handed on and verified."""

import errno
import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from test_store import Maker, key, volume

from mammometry.base.errors import FullDiskError, StorageError
from mammometry.base.progress import Progress
from mammometry.cli import main
from mammometry.io.results.store import Store
from mammometry.io.results.verify import shown, verify
from mammometry.io.sealed import sealed, unsealed


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """A mesh and pictures, as `mammometry measure MESH` leaves them: stages without a session."""
    store = Store(tmp_path / "scan-measured")

    def write(folder: Path, progress: Progress) -> None:
        (folder / "model.glb").write_bytes(b"glTF" * 100)
        (folder / "views.png").write_bytes(b"png")

    with store.taken():
        store.recall(key(), Maker())
        store.write_folder(key("previews"), lambda: write)
    return tmp_path / "scan-measured"


def flip(path: Path) -> None:
    """Change one byte, and let size and time of change be as they were."""
    was = path.stat()
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    os.utime(path, ns=(was.st_atime_ns, was.st_mtime_ns))


@pytest.mark.parametrize("name", ["mesh.ply", "model.glb"])
@pytest.mark.requirement("R-LOSS-9")
def test_a_flipped_byte_is_damage_and_is_renewed(results: Path, name: str) -> None:
    path = results / "surface" / name
    data = path.read_bytes()
    product = "mesh" if name == "mesh.ply" else "previews"
    open_before = Store(results)
    assert open_before.has(key(product))
    flip(path)
    for store in (open_before, Store(results)):  # also by a process that has seen it whole
        assert store.state(key(product)) == "damaged"
        assert not store.has(key(product))
    if name == "mesh.ply":
        maker = Maker()
        assert volume(Store(results), key(), maker) == 1.0
        assert maker.times == 1
        assert path.read_bytes() == data


def test_files_are_handed_on_whole_or_not(results: Path) -> None:
    store = Store(results)
    assert store.files(key("previews"))["views.png"] == b"png"
    assert store.files(key("report")) == {}
    flip(results / "surface" / "views.png")
    with pytest.raises(StorageError, match=r"surface/views.png: .*changed"):
        store.files(key("previews"))
    (results / "surface" / "views.png").unlink()
    with pytest.raises(StorageError, match=r"surface/views.png: (?!.*changed)"):
        store.files(key("previews"))


def test_bytes_are_read_once_while_a_file_stays(results: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from mammometry.io.results import store as module

    read = list[str]()
    real = module.file_digest
    monkeypatch.setattr(module, "file_digest", lambda path: (read.append(path.name), real(path))[1])
    store = Store(results)
    for _ in range(3):
        assert store.states([key(), key("previews")]) == ["current", "current"]
    assert sorted(read) == ["mesh.ply", "model.glb", "views.png"]
    (results / "surface" / "mesh.ply").touch()
    assert store.has(key())
    assert read.count("mesh.ply") == 2


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1])


def linked(path: Path) -> None:
    path.rename(path.with_name("was.ply"))
    path.symlink_to("was.ply")


DAMAGES: dict[str, tuple[Callable[[Path], object], str]] = {
    "flipped": (flip, "a file that was changed since it was written"),
    "cut": (cut, "bytes instead of"),
    "removed": (Path.unlink, "no such file"),
    "a link": (linked, "no such file"),
}


@pytest.mark.parametrize(("damage", "found"), DAMAGES.values(), ids=DAMAGES)
@pytest.mark.requirement("R-LOSS-9")
def test_verify_names_what_is_damaged(
    results: Path, capsys: pytest.CaptureFixture[str], damage: Callable[[Path], object], found: str
) -> None:
    assert main.run(["verify", str(results)]) == 0
    assert "2 products, 3 files, 0 MB:" in capsys.readouterr().out
    damage(results / "surface" / "mesh.ply")
    assert main.run(["verify", str(results), "--json"]) == 9
    table = json.loads(capsys.readouterr().out)
    (named,) = table["damaged"]
    assert (named["product"], named["file"]) == ("mesh", "surface/mesh.ply")
    assert found in named["found"]
    assert table["renewed"] == ["surface/mesh"]
    assert main.run(["verify", str(results)]) == 9
    said = capsys.readouterr().out
    assert "surface/mesh.ply: " in said
    assert "surface/mesh" in said
    assert "DAMAGED" in said
    assert main.run(["verify", str(results), "--quiet"]) == 9
    printed = capsys.readouterr()
    assert (printed.out, "surface/mesh.ply: " in printed.err) == ("", True)  # what went wrong is no chatter


def test_verify_says_what_it_cannot_check(results: Path) -> None:
    (results / "surface" / "notes.txt").write_text("mine")
    (results / ".ready-surface-mesh-1").mkdir()
    findings = verify(results)
    assert (findings.damaged, findings.unrecorded) == ((), ("surface/notes.txt",))
    assert findings.leftovers == (".ready-surface-mesh-1",)
    path = results / "surface" / "provenance.json"
    table, _ = unsealed(path.read_bytes())
    table["products"]["mesh"]["files"] = {"../../x": {"bytes": 1, "sha256": "0" * 64}}
    path.write_bytes(sealed(table))
    (damage,) = verify(results).damaged
    assert (damage.product, damage.found.endswith(" mesh")) == ("mesh", True)
    path.unlink()
    (damage,) = verify(results).damaged
    assert (damage.product, damage.file) == (None, "surface/provenance.json")


def test_a_first_product_that_was_being_moved_into_place_is_no_damage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a disk that is full once the stage's first file is in place and its record is not."""

    def full(path: Path, data: bytes) -> None:
        raise OSError(errno.ENOSPC, "no room", str(path))

    store = Store(tmp_path / "results")
    monkeypatch.setattr("mammometry.io.results.store.write_new", full)
    with store.taken(), pytest.raises(FullDiskError):
        store.recall(key(), Maker())
    findings = verify(tmp_path / "results")
    assert findings.damaged == ()
    assert findings.unrecorded == ("surface/mesh.ply",)
    assert len(findings.leftovers) == 1
    (tmp_path / "results" / findings.leftovers[0]).rename(tmp_path / "elsewhere")  # then nothing says whose it is
    (damaged,) = verify(tmp_path / "results").damaged
    assert damaged.found.endswith("records")


def test_verify_of_something_else(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main.run(["verify", str(tmp_path)]) == 3
    assert "results" in capsys.readouterr().err
    assert main.run(["verify", str(tmp_path / "nowhere")]) == 3


def test_names_are_shown_without_control_characters() -> None:
    assert shown("a\x1b[2Jb\udcffé") == "a?[2Jb?é"
