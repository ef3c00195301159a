"""Two runs at once in one session: the second is told who is at work, and nothing is lost."""

import errno
import fcntl
import json
import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from small_products import NAMES, contents, key, make

from mammometry.base.errors import BusyError, StorageError
from mammometry.io.results.lock import HOLDER, LOCK, MARKER
from mammometry.io.results.store import Store

HERE = Path(__file__).parent
HOLD = """
import errno, fcntl, sys
if sys.argv[2] == "no locks":
    def flock(*_):
        raise OSError(errno.ENOLCK, "No locks available")
    fcntl.flock = flock
from pathlib import Path
from mammometry.io.results.store import Store
with Store(Path(sys.argv[1])).taken():
    print("taken", flush=True)
    sys.stdin.read()
"""


@pytest.fixture(params=["locks", "no locks"])
def drive(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """A drive that knows locks, and one that answers ENOLCK as some network drives do."""
    kind: str = request.param
    if kind == "no locks":

        def flock(*_: object) -> None:
            raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

        monkeypatch.setattr(fcntl, "flock", flock)
    return kind


@pytest.fixture
def results(tmp_path: Path) -> Path:
    (tmp_path / "results").mkdir()
    return tmp_path / "results"


@pytest.fixture
def other_run(results: Path, drive: str) -> Iterator[subprocess.Popen[str]]:
    """Another process at work in the results."""
    command = [sys.executable, "-c", HOLD, str(results), drive]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "taken\n"
        yield process
        process.kill()


@pytest.mark.slow
@pytest.mark.requirement("R-LOSS-4")
def test_the_second_run_is_told_who_is_at_work(results: Path, drive: str, other_run: subprocess.Popen[str]) -> None:
    with pytest.raises(StorageError) as caught, Store(results).taken():
        pass
    said = str(caught.value)
    assert f"(process {other_run.pid} on {platform.node()}, since 20" in said
    assert (f"remove {MARKER} there" in said) == (drive == "no locks")
    assert "\n" not in said
    other_run.communicate("")
    with Store(results).taken():
        pass
    assert sorted(path.name for path in results.iterdir()) == [LOCK]


def test_a_killed_run_keeps_nobody_out(results: Path, other_run: subprocess.Popen[str]) -> None:
    other_run.kill()
    other_run.wait()
    store = Store(results)
    with store.taken():
        make(store, "mesh")
    assert store.has(key("mesh"))
    assert HOLDER not in os.listdir(results)


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["no locks"], indirect=True)
def test_a_marker_of_another_computer_is_respected(results: Path, drive: str) -> None:
    (results / MARKER).write_text("123\nelsewhere\n")
    about = {"pid": 123, "host": "elsewhere", "since": "2026-01-31T10:00:00+00:00"}
    (results / HOLDER).write_text(json.dumps(about))
    with (
        pytest.raises(StorageError, match=r"\b123 .*elsewhere, .*2026-01-31 10:00:00") as caught,
        Store(results).taken(),
    ):
        pass
    assert ".lock-marker" in str(caught.value)
    (results / MARKER).unlink()
    with Store(results).taken():
        pass


@pytest.mark.parametrize("note", ["", "{", "[]", '{"pid": "x"}', '{"pid": 1e99, "host": "a", "since": "2026-01-31"}',
                                  '{"pid": 1, "host": "a\\nb", "since": "2026-01-31"}', "[" * 100_000])  # fmt: skip
def test_a_note_that_says_nothing(results: Path, note: str) -> None:
    first = Store(results)
    with first.taken():
        (results / HOLDER).write_text(note)
        with pytest.raises(BusyError), Store(results).taken():
            pass


@pytest.mark.slow
@pytest.mark.requirement("R-LOSS-4")
def test_runs_that_start_together_all_end_well(results: Path, tmp_path: Path) -> None:
    command = [sys.executable, str(HERE / "small_products.py"), str(results)]
    runs = [subprocess.Popen([*command, version], stderr=subprocess.PIPE, text=True) for version in "121"]
    for run in runs:
        _, said = run.communicate(timeout=120)
        assert run.returncode == 0, said
    alone = Store(tmp_path / "alone")
    (last,) = {version for version in (1, 2) if Store(results).has(key("mesh", version))}
    store = Store(results)
    with alone.taken(), store.taken():
        for name in NAMES:
            assert store.has(key(name, last))
            make(alone, name, last)
    assert contents(results) == contents(tmp_path / "alone")
