"""A run under ``--all-must-run`` names what it did not run, and fails where it should have."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from tests.not_run import MAY_SKIP, not_run

CASES = """
import os, signal, pytest

@pytest.mark.skip(reason="{reason}")
def test_skipped(): pass

def test_passes(): pass

def test_that_ends_the_run():
    if {is_cut}: os.kill(os.getpid(), signal.SIGINT)

def test_last(): pass
"""


@pytest.mark.parametrize(
    ("reason", "is_cut", "code", "printed"),
    [
        ("no Chromium", False, 1, ["ERROR not run: test_cases.py::test_skipped: Skipped: no Chromium"]),
        (MAY_SKIP[0], True, 2, [f"not reached: test_cases.py::test_{name}" for name in ("that_ends_the_run", "last")]),
    ],
)
def test_a_run_names_what_it_did_not_run(
    tmp_path: Path, repository: Path, reason: str, is_cut: bool, code: int, printed: list[str]
) -> None:
    (tmp_path / "test_cases.py").write_text(CASES.format(reason=reason, is_cut=is_cut))
    (tmp_path / "conftest.py").write_text(
        "from tests.not_run import NotRun\ndef pytest_configure(config): config.pluginmanager.register(NotRun())\n"
    )
    command = [sys.executable, "-m", "pytest", "-q", "-ra", "-p", "no:cacheprovider", "--rootdir=."]
    environment = os.environ | {
        "PYTHONPATH": str(repository),
        "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
        "PYTEST_ADDOPTS": "",
    }
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stdout
    lines = done.stdout.splitlines()
    assert [line for line in lines if line.startswith(("ERROR", "not reached"))] == printed
    assert any(line.startswith("SKIPPED") and reason in line for line in lines)  # all of them, at the end


def test_what_may_be_skipped_is_not_named() -> None:
    reasons = [f"Skipped: {MAY_SKIP[0]} (shared/data)", "Skipped: no Chromium"]
    assert not_run(zip(("a", "b"), reasons, strict=True)) == ["b: Skipped: no Chromium"]


def test_each_reason_that_counts_is_one_of_a_test(repository: Path) -> None:
    texts = [
        path.read_text(encoding="utf-8") for path in (repository / "tests").rglob("*.py") if path.stem != "not_run"
    ]
    assert [reason for reason in MAY_SKIP if not any(f'"{reason}' in text for text in texts)] == []


@pytest.mark.parametrize(
    ("printed", "code", "again", "expected"),
    [
        ("[gw0] [ 50%] PASSED a", 0, 9, 0),
        ("[gw0] [ 50%] FAILED a", 2, 1, 1),
        ("[gw0] [ 50%] FAILED a", 2, 0, 0),  # it falls beside other work only
        ("[gw1] [ 50%] ERROR a", 124, 1, 1),  # and the other worker was at work until the time ran out
        ("ERROR not run: a: no Chromium", 2, 5, 1),
        ("no tests", 2, 9, 1),
        ("not reached: a", 124, 9, 0),
        ("not reached: a", 137, 9, 0),
    ],
)
def test_ci_fails_with_its_slow_tests(
    repository: Path, tmp_path: Path, printed: str, code: int, again: int, expected: int
) -> None:
    """All but its last step is left out."""
    once = f"case $* in *last-failed*) exit {again};; esac; echo '{printed}'; exit {code}"
    for name, script in {"make": "", "python3": "", "apt-get": "", "timeout": once}.items():
        _write_program(tmp_path / "bin" / name, script)
    _write_program(tmp_path / ".venv/bin/python", "")
    (tmp_path / ".ci").mkdir()
    script = shutil.copy(repository / ".ci/run", tmp_path / ".ci/run")
    environment = os.environ | {"PATH": f"{tmp_path}/bin:{os.environ['PATH']}"}
    done = subprocess.run(["bash", script], env=environment, capture_output=True, text=True, check=False)
    assert bool(done.returncode) == bool(expected), done.stdout
    assert printed in done.stdout


def _write_program(path: Path, script: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
