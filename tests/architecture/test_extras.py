"""Measuring and reporting need no extra; what needs one says which, in a sentence."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

_EXTRAS = (
    *("django", "uvicorn", "asgiref", "distributed", "dask", "bokeh", "pyarrow", "fsspec", "s3fs", "sshfs"),
    *("allauth", "argon2", "axes", "auditlog", "whitenoise", "psycopg", "pydicom", "pynetdicom", "highdicom", "fhir"),
    *("pypylon", "gi", "gphoto2", "mitsuba", "pi_heif"),
)
_WITHOUT = f"""
import importlib.abc, sys

class Absent(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {_EXTRAS!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Absent())
"""
_IMPORT_ALL = """
import importlib, pkgutil
import mammometry
for module in pkgutil.walk_packages(mammometry.__path__, "mammometry.", onerror=lambda name: None):
    if module.name.endswith("__main__"):
        continue
    try:
        importlib.import_module(module.name)
    except ModuleNotFoundError:
        print(module.name)
"""
_MAY_NEED_ONE = (
    *("mammometry.clinic", "mammometry.hospital", "mammometry.editor.server", "mammometry.web.local"),
    *("mammometry.web.server", "mammometry.capture.page", "mammometry.batch.worker_resources"),
)


def without_extras(code: str) -> "subprocess.CompletedProcess[str]":
    """Run Python code where no library of an extra can be imported."""
    return subprocess.run(
        [sys.executable, "-c", _WITHOUT + code], capture_output=True, text=True, timeout=120, check=False
    )


@pytest.mark.slow
def test_what_measures_and_reports_imports_no_extra() -> None:
    done = without_extras(_IMPORT_ALL)
    assert done.returncode == 0, done.stderr
    failed = done.stdout.split()
    assert any(name.startswith("mammometry.clinic") for name in failed), "has this test lost its object?"
    assert [name for name in failed if not name.startswith(_MAY_NEED_ONE)] == []


_COMMANDS = {
    "edit": ["edit", "session"],
    "batch": ["batch", "session", "--out", "out"],
    "clinic": ["clinic", "init", "clinic"],
    "hospital": ["export", "fhir", "session", "--out", "out"],
}
"""Extra → words of a command that needs it."""
_RUN_ALL = f"""
import contextlib, io, json
from mammometry.cli.main import run
found = {{}}
for extra, words in {_COMMANDS!r}.items():
    with contextlib.redirect_stderr(io.StringIO()) as said:
        code = run(words)
    found[extra] = code, said.getvalue()
print(json.dumps(found))
"""


@pytest.mark.slow
def test_what_needs_an_extra_names_it(tmp_path: Path) -> None:
    (tmp_path / "session").mkdir()
    (tmp_path / "session" / "session.toml").touch()
    done = without_extras(f"import os; os.chdir({str(tmp_path)!r})\n{_RUN_ALL}")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert set(found) == set(_COMMANDS)
    for extra, (code, said) in found.items():
        assert code != 0
        assert f"Run pip install 'mammometry[{extra}]'" in " ".join(said.split()), said
        assert "Traceback" not in said
