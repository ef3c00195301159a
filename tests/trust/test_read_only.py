"""Results on a disk that may only be read: they are shown, checked and read, and nothing is tried in vain."""

import subprocess
import sys
from pathlib import Path

import pytest
from read_only_disk import read_only
from small_products import NAMES, contents, key, make, mesh

from mammometry.base.errors import StorageError
from mammometry.cli import main
from mammometry.io.results.store import Store

HERE = Path(__file__).parent


@pytest.fixture
def results(tmp_path: Path) -> Path:
    store = Store(tmp_path / "results")
    with store.taken():
        for name in NAMES:
            make(store, name, 1)
    return tmp_path / "results"


def test_results_are_read_and_checked(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with read_only(results):
        store = Store(results)
        assert all(store.has(key(name)) for name in NAMES)
        first = store.recall(key("mesh"), lambda: pytest.fail("it is there"))
        assert (first.vertices == mesh(1).vertices).all()
        assert store.files(key("pictures"))["sub/c.png"] == b"c1"
        assert main.run(["verify", str(results)]) == 0
    assert "all unchanged" in capsys.readouterr().out


def test_what_cannot_be_written_is_one_sentence(results: Path) -> None:
    before = contents(results)
    with read_only(results), pytest.raises(StorageError, match=r"no permission \(Read-only file system\)"):
        make(Store(results), "mesh", 2)
    with read_only(results.parent), pytest.raises(StorageError, match="no permission"):
        make(Store(results.parent / "other"), "mesh", 2)
    assert contents(results) == before


@pytest.mark.slow
def test_a_disk_that_is_really_read_only(results: Path) -> None:
    """The whole of it in another process, below a mount that may only be read."""
    mount = f"mount --bind {results} {results} && mount -o remount,ro,bind {results}"
    if subprocess.run(["unshare", "-rm", "sh", "-c", mount], capture_output=True).returncode:
        pytest.skip("mounting is not permitted here; the injected EROFS above ran")
    verified = f"{sys.executable} -m mammometry verify {results}"
    written = f"{sys.executable} {HERE / 'small_products.py'} {results} 2"
    script = f"{mount} && {verified} && {written}"
    done = subprocess.run(["unshare", "-rm", "sh", "-c", script], capture_output=True, text=True)
    assert done.returncode == 1
    assert "all unchanged" in done.stdout
    assert "(Read-only file system)" in done.stderr.splitlines()[-1]
