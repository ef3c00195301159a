"""A machine searches for faults of trust: files spoilt by chance end in success or in one sentence.

The seed is fixed; MAMMOMETRY_MUTATIONS_SEED starts from another. MAMMOMETRY_MUTATIONS is how many are tried,
MAMMOMETRY_MUTATIONS_CASES of which cases (``info,run``).
A failure prints what was done: the same seed and case do it again.
"""

import contextlib
import hashlib
import json
import os
import re
import select
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from random import Random

import pytest
from mutation import spoil
from mutation_cases import CASES, Case, prepared

from mammometry.io.sealed import DIGEST, sealed

SEED = int(os.environ.get("MAMMOMETRY_MUTATIONS_SEED", "16"))
COUNT = int(os.environ.get("MAMMOMETRY_MUTATIONS", "200"))
WANTED = os.environ.get("MAMMOMETRY_MUTATIONS_CASES", ",".join(case.name for case in CASES)).split(",")
PARTS = 2
MOST_SECONDS = 60
MOST_MB = 4096
LONGEST = 1500  # characters of a sentence: what was found must not fill the screen
OUR_CODES = range(3, 10)


class Worker:
    """The process that runs the commands; another one after a crash or a command without end."""

    def __init__(self, folder: Path) -> None:
        self._said = folder / "said.txt"
        self._process: subprocess.Popen[str] | None = None

    def run(self, arguments: list[str]) -> tuple[int | str, float, str]:
        """Exit code, or how the process ended; peak of memory, MB; all that was said."""
        if self._process is None:
            environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "MPLBACKEND": "agg"}
            self._process = subprocess.Popen(
                [sys.executable, str(Path(__file__).with_name("mutation_worker.py"))],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment,
            )  # fmt: skip
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        self._said.write_text("")
        process.stdin.write(json.dumps({"arguments": arguments, "said": str(self._said)}) + "\n")
        process.stdin.flush()
        ready, _, _ = select.select([process.stdout], [], [], MOST_SECONDS)
        answer = json.loads(process.stdout.readline() or "{}") if ready else {}
        if not answer:
            self.end()
        ended = f"still at work after {MOST_SECONDS} s" if not ready else f"a crash ({process.returncode})"
        said = self._said.read_text(encoding="utf-8", errors="backslashreplace")
        return answer.get("code", ended), answer.get("peak_mb", 0.0), said

    def end(self) -> None:
        if self._process is not None:
            if self._process.poll() is None:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    self._process.wait(timeout=1)
                self._process.kill()
            self._process.communicate()
            self._process = None


@pytest.fixture(scope="module")
def worker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Worker]:
    one = Worker(tmp_path_factory.mktemp("said"))
    yield one
    one.end()


@pytest.fixture(scope="module")
def originals(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("originals")


def files_of(folder: Path) -> dict[str, str]:
    """Digest of every file."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def confirmed(folder: Path, file: Path, before: bytes, after: bytes) -> bool:
    """Have the records say that a spoilt file is as it was written; whether one of them could."""
    if file.name == "provenance.json":
        with contextlib.suppress(ValueError, RecursionError):
            table = json.loads(after)
            if isinstance(table, dict) and table.pop(DIGEST, None) and table:
                file.write_bytes(sealed(table))
                return True
        return False
    old, new = (hashlib.sha256(content).hexdigest().encode() for content in (before, after))
    for path in folder.rglob("results/*/provenance.json"):
        text = path.read_bytes()
        if old in text:
            size = rb'"bytes": %d(?=,\s*"sha256": "%s")' % (len(before), old)
            table = json.loads(re.sub(size, b'"bytes": %d' % len(after), text).replace(old, new))
            table.pop(DIGEST)
            path.write_bytes(sealed(table))
            return True
    return False


def spoilt(case: Case, folder: Path, rng: Random) -> str:
    """Spoil one file, now and then a second one; what was done."""
    done = []
    for _ in range(rng.choice((1, 1, 1, 1, 2))):
        path = rng.choice(sorted(path for path in folder.glob(rng.choice(case.spoilt)) if path.is_file()))
        before = path.read_bytes()
        after, said = spoil(path.name, before, rng)
        path.write_bytes(after)
        if "results" in path.parts and rng.random() < 0.5 and confirmed(folder, path, before, after):
            said += ", and its record says so"
        done.append(f"{path.relative_to(folder)}: {said}")
    return "; ".join(done)


def complaints(case: Case, code: int | str, peak_mb: float, said: str, changed: list[str]) -> list[str]:
    """All that is wrong with how a command ended."""
    wrong = [f"changed {name}" for name in changed]
    if peak_mb > MOST_MB:
        wrong.append(f"took {peak_mb:.0f} MB")
    if code == 0 or code in case.verdicts:
        return wrong
    if code not in OUR_CODES:
        return [*wrong, f"ended with {code}"]
    one_sentence = said.startswith("mammometry: ") and said.count("\n") == 1 and said[:-1].isprintable()
    if not one_sentence or len(said) > LONGEST:
        wrong.append(f"said no one sentence of at most {LONGEST} characters")
    return wrong


def attempt(number: int, cases: list[Case], worker: Worker, originals: Path, folder: Path) -> str:
    """Spoil and run once; what is wrong, or nothing."""
    case = cases[number % len(cases)]
    rng = Random(f"{case.name} {number}")
    here = folder / "case"
    shutil.copytree(prepared(case, originals), here)
    (folder / "outside").mkdir()
    done = spoilt(case, here, rng)
    before = files_of(folder)
    code, peak_mb, said = worker.run([argument.format(here=here) for argument in case.arguments])
    after = files_of(folder)
    ours = tuple(f"case/{name}" for name in case.writes)
    changed = [
        name
        for name in sorted(before.keys() | after.keys())
        if before.get(name) != after.get(name) and not any(name == own or name.startswith(f"{own}/") for own in ours)
    ]
    wrong = complaints(case, code, peak_mb, said, changed)
    shutil.rmtree(folder)
    return f"{case.name} {number}: {done}\n  {'; '.join(wrong)}\n  said: {said[-600:]!r}" if wrong else ""


@pytest.mark.slow
@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.requirement("R-IN-1")
def test_spoilt_files_end_in_success_or_one_sentence(
    worker: Worker, originals: Path, tmp_path: Path, part: int
) -> None:
    """Half of them in each part, so that parts can take turns."""
    cases = [case for case in CASES if case.name in WANTED]
    numbers = range(SEED + part * COUNT // PARTS, SEED + (part + 1) * COUNT // PARTS)
    wrong = [attempt(number, cases, worker, originals, tmp_path / str(number)) for number in numbers]
    assert not any(wrong), f"seed {SEED}\n" + "\n".join(filter(None, wrong))
