"""The memo on disk: what is redone, what survives an interruption, what a full disk says."""

import errno
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.first_cases import first

from mammometry.base.errors import BusyError, FullDiskError, StorageError
from mammometry.base.progress import Progress
from mammometry.geometry.mesh import TriangleMesh
from mammometry.io import write
from mammometry.io.results import codecs
from mammometry.io.results.codecs import ARRAYS
from mammometry.io.results.store import Store
from mammometry.io.write import write_text
from mammometry.job.products import Key
from mammometry.surface.ranges.dents import KeepMasks


def key(product: str = "mesh", **changes: object) -> Key:
    values = {"version": 1, "settings": {"cube_mm": 0.5}, "inputs": {"photograph": "abc"}} | changes
    return Key(stage="surface", product=product, **values)  # type: ignore[arg-type]


def mesh(height: float = 1.0) -> TriangleMesh:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, height]])
    return TriangleMesh(vertices=corners, faces=np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32))


class Maker:
    """Counts how often it is asked to make the mesh."""

    def __init__(self, height: float = 1.0) -> None:
        self.times = 0
        self.height = height

    def __call__(self) -> Callable[[Progress], TriangleMesh]:
        def make(progress: Progress) -> TriangleMesh:
            self.times += 1
            progress(1.0)
            return mesh(self.height)

        return make


def volume(store: Store, which: Key, maker: Maker) -> float:
    return 6 * store.recall(which, maker).volume_mm3()


def test_a_product_is_made_once(tmp_path: Path) -> None:
    maker = Maker(2.0)
    assert volume(Store(tmp_path), key(), maker) == 2.0
    assert volume(Store(tmp_path), key(), maker) == 2.0
    assert maker.times == 1


@pytest.mark.parametrize(
    "change",
    [{"version": 2}, {"settings": {"cube_mm": 0.6}}, {"settings": {}}, {"inputs": {"photograph": "abd"}}],
    ids=["version", "setting", "settings", "input"],
)
def test_a_change_makes_it_stale_and_anew(tmp_path: Path, change: dict[str, object]) -> None:
    store = Store(tmp_path)
    store.recall(key(), Maker())
    assert store.state(key()) == "current"
    assert store.state(key(**change)) == "stale"
    assert volume(store, key(**change), Maker(3.0)) == 3.0
    assert store.state(key()) == "stale"


def test_nothing_yet_is_absent(tmp_path: Path) -> None:
    assert Store(tmp_path / "results").state(key()) == "absent"
    assert not (tmp_path / "results").exists()  # asking leaves no trace


def test_provenance_says_what_it_was_made_from(tmp_path: Path) -> None:
    Store(tmp_path).recall(key(), Maker())
    table = json.loads((tmp_path / "surface" / "provenance.json").read_text())
    record = table["products"]["mesh"]
    assert (table["format"], table["stage"]) == (1, "surface")
    assert record["settings"] == {"cube_mm": 0.5}
    assert record["inputs"] == {"photograph": "abc"}
    assert record["software"]["mammometry"]
    assert record["seconds"] >= 0
    assert record["made"].endswith("+00:00")
    (name,) = record["files"]
    assert record["files"][name]["bytes"] == (tmp_path / "surface" / name).stat().st_size
    assert str(tmp_path) not in json.dumps(table)


def test_a_product_belongs_to_its_subject(tmp_path: Path) -> None:
    Store(tmp_path).recall(key(), Maker())
    named = Store(tmp_path, subject="P-1")
    assert named.state(key()) == "stale"
    maker = Maker(2.0)
    assert volume(named, key(), maker) == 2.0
    assert named.record(key()).subject == "P-1"
    assert named.state(key()) == "current"
    assert b"comment subject P-1" in (tmp_path / "surface" / "mesh.ply").read_bytes()
    for other in (None, "P-2"):
        assert Store(tmp_path, subject=other).state(key()) == "stale"


@pytest.mark.parametrize("damage", ["cut", "changed", "removed", "record"])
def test_damaged_results_are_made_anew(tmp_path: Path, damage: str) -> None:
    Store(tmp_path).recall(key(), Maker())
    path = tmp_path / "surface" / "mesh.ply"
    data = path.read_bytes()
    if damage == "cut":
        path.write_bytes(data[:-5])
    elif damage == "changed":
        path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    elif damage == "removed":
        path.unlink()
    else:
        (tmp_path / "surface" / "provenance.json").write_text("{")
    maker = Maker()
    assert volume(Store(tmp_path), key(), maker) == 1.0
    assert maker.times == 1
    assert path.read_bytes() == data


def test_a_failure_leaves_the_earlier_result(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.recall(key(), Maker())

    def broken(progress: Progress) -> TriangleMesh:
        raise RuntimeError("halfway")

    with pytest.raises(RuntimeError, match="halfway"):
        store.recall(key(version=2), lambda: broken)
    assert store.state(key()) == "current"
    assert sorted(path.name for path in tmp_path.iterdir()) == [".lock", "surface"]


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG])
def test_a_full_disk_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int) -> None:
    store = Store(tmp_path)
    store.recall(key(), Maker())

    def full(*args: object, **kwargs: object) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(codecs, "encode", full)
    with pytest.raises(FullDiskError, match=r"\bMB\b") as caught:
        store.recall(key(version=2), Maker())
    assert "\n" not in str(caught.value)
    assert store.state(key()) == "current"
    monkeypatch.undo()
    assert volume(store, key(version=2), Maker(4.0)) == 4.0  # and goes on when there is room


def test_a_folder_that_may_not_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(*args: object, **kwargs: object) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(tmp_path))

    monkeypatch.setattr(Path, "mkdir", denied)
    with pytest.raises(StorageError, match="permission"), Store(tmp_path / "results").taken():
        pass


def test_one_run_at_a_time(tmp_path: Path) -> None:
    first, second = Store(tmp_path), Store(tmp_path)
    with first.taken():
        with first.taken():
            pass
        with pytest.raises(BusyError), second.taken():
            pass
    with second.taken():
        pass


KILLED = """
import os, signal, sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from test_store import Maker, key
from mammometry.io.results import store
folder = Path(sys.argv[1])
replaced = 0
def counted(self, target, real=Path.replace):
    global replaced
    if replaced == int(sys.argv[2]):
        os.kill(os.getpid(), signal.SIGKILL)
    replaced += 1
    return real(self, target)
if sys.argv[2] == "rename":
    def killed(self, target):
        os.kill(os.getpid(), signal.SIGKILL)
    Path.rename = killed
else:
    Path.replace = counted
store.Store(folder).recall(key(version=2), Maker(5.0))
"""


@pytest.mark.slow
@pytest.mark.parametrize(("moment", "finished"), first(1, [("rename", False), ("0", True), ("1", True)]))
def test_killed_while_it_puts_a_result_in_place(tmp_path: Path, moment: str, finished: bool) -> None:
    Store(tmp_path).recall(key(), Maker())
    script = KILLED.format(tests=str(Path(__file__).parent))
    done = subprocess.run([sys.executable, "-c", script, str(tmp_path), moment], check=False)
    assert done.returncode == -signal.SIGKILL
    store = Store(tmp_path)
    with store.taken():
        pass
    # Before the rename the old result stands; after it the new one is finished.
    assert store.state(key(version=2) if finished else key()) == "current"
    maker = Maker(5.0)
    assert volume(store, key(version=2), maker) == 5.0
    assert maker.times == (0 if finished else 1)
    assert sorted(path.name for path in tmp_path.iterdir()) == [".lock", "surface"]


def test_a_folder_product_replaces_its_files(tmp_path: Path) -> None:
    store = Store(tmp_path)

    def writer(names: tuple[str, ...]) -> Callable[[], Callable[[Path, Progress], None]]:
        def write(folder: Path, progress: Progress) -> None:
            for name in names:
                (folder / name).parent.mkdir(exist_ok=True, parents=True)
                (folder / name).write_text(name)

        return lambda: write

    assert store.write_folder(key("report"), writer(("a.html", "img/b.png")))
    assert not store.write_folder(key("report"), writer(()))
    assert store.write_folder(key("report", version=2), writer(("a.html", "img/c.png")))
    kept = {path.relative_to(tmp_path / "surface").as_posix() for path in (tmp_path / "surface").rglob("*.*")}
    assert kept == {"a.html", "img/c.png", "provenance.json"}


def test_small_files_are_whole_or_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "cameras.json"
    write_text(path, "old")

    def full(path: Path) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(write, "sync_file", full)
    with pytest.raises(FullDiskError):
        write_text(path, "new")
    assert path.read_text() == "old"
    assert [each.name for each in tmp_path.iterdir()] == ["cameras.json"]


def test_a_result_of_an_earlier_format_is_renewed_and_its_file_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As kept range data, once copies in an .npz, now a mask in a .tif: neither is taken for the other."""
    kept = KeepMasks(keep=(np.eye(70, dtype=bool),), angles_rad=(np.eye(70, dtype=np.float32),))
    with monkeypatch.context() as before:
        before.setattr(codecs, "_format", lambda product: ARRAYS)
        Store(tmp_path).recall(key("valid", version=3), lambda: lambda progress: (1, 2))
    assert (tmp_path / "surface" / "valid.npz").is_file()
    store = Store(tmp_path)
    assert store.state(key("valid", version=4)) == "stale"
    store.recall(key("valid", version=4), lambda: lambda progress: kept)
    assert [path.name for path in (tmp_path / "surface").glob("valid*")] == ["valid.tif"]
    read = Store(tmp_path).recall(key("valid", version=4), Maker())
    np.testing.assert_array_equal(read.keep[0], kept.keep[0])
