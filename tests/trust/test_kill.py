"""kill -9 at random moments of a run: nothing that was finished is lost, and a rerun gives equal bytes.

`test_power_loss` replays every step of a run of small products; here real processes are killed.
"""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from small_products import NAMES, contents

from mammometry.io.results.records import read_records
from mammometry.io.results.store import Store
from mammometry.io.results.verify import verify

ON_AND_ON = """
import itertools, sys
from pathlib import Path
sys.path.insert(0, {here!r})
from small_products import NAMES, make
from mammometry.io.results.store import Store
store = Store(Path(sys.argv[1]))
with store.taken():
    for version in itertools.count(int(sys.argv[2])):
        for name in NAMES:
            print(version, name, flush=True)
            make(store, name, version)
"""


def versions(results: Path) -> dict[str, int]:
    """Stage/product → version of all that is recorded; checks that each is whole."""
    findings = verify(results)
    assert not findings.damaged
    assert not findings.unrecorded
    stages = [path for path in results.iterdir() if path.is_dir() and not path.name.startswith(".")]
    return {f"{path.name}/{name}": record.version for path in stages for name, record in read_records(path)[0].items()}


@pytest.mark.slow
@pytest.mark.requirement("R-LOSS-1")
def test_killed_while_results_are_renewed_on_and_on(tmp_path: Path) -> None:
    results, chance, before = tmp_path / "results", random.Random(3), dict[str, int]()
    for _ in range(50):
        script = ON_AND_ON.format(here=str(Path(__file__).parent))
        command = [sys.executable, "-c", script, str(results), str(max(before.values(), default=0) + 1)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            for _ in range(chance.randint(3, 9)):
                process.stdout.readline()
            time.sleep(chance.uniform(0.0, 0.02))
            os.kill(process.pid, signal.SIGKILL)
        with Store(results).taken():  # tidies up
            pass
        now = versions(results)
        assert all(now[name] >= version for name, version in before.items())
        before = now
    assert len(before) == len(NAMES)
    assert max(before.values()) > 50  # it did get on in between


@pytest.mark.slow
@pytest.mark.parametrize("part", range(2))
@pytest.mark.requirement("R-LOSS-1")
def test_killed_again_and_again_in_whole_runs(
    tiny_original: Path, tiny_finished_original: Path, tiny_settings: Path, tmp_path: Path, part: int
) -> None:
    """Ten times in each part, so that parts can take turns."""
    session = shutil.copytree(tiny_original, tmp_path / tiny_original.name)  # its name stands in the report
    results, chance, done = session / "results", random.Random(11 + part), 0
    wanted, finished = same_bytes(tiny_finished_original / "results"), dict[str, int]()
    command = [sys.executable, "-m", "mammometry", "run", str(session), "--settings", str(tiny_settings), "--json"]
    for _ in range(10):
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        try:
            process.wait(timeout=chance.uniform(1.0, 15.0))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if results.is_dir():
            with Store(results).taken():
                pass
            now = versions(results)
            assert set(now) >= set(finished)
            finished = now
        if process.returncode == 0:
            assert same_bytes(results) == wanted
            shutil.rmtree(results)
            finished, done = {}, done + 1
    assert subprocess.run(command, stdout=subprocess.DEVNULL, check=False).returncode == 0
    assert same_bytes(results) == wanted


def same_bytes(results: Path) -> dict[str, bytes]:
    """All results that are to be equal whenever they are made: the report alone tells how long it took."""
    return {name: data for name, data in contents(results).items() if not name.startswith("report/")}
