"""The numbered examples run as they stand."""

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).resolve().parents[2] / "examples").glob("[0-9][0-9]_*.py"))
SAID = {
    "01_measure": ("model: ", "report.html"),
    "02_stage_by_stage": ("2 cameras", "front: ", "watertight: True", "model: "),
    "03_change_a_setting": ("made again: surface/repaired, surface/mesh, surface/model, surface/previews",),
}


def test_every_example_is_tested() -> None:
    assert {path.stem for path in EXAMPLES} == set(SAID)


@pytest.mark.slow
@pytest.mark.parametrize(
    "path",
    [pytest.param(path, marks=[] if path.stem.startswith("01") else [pytest.mark.slow]) for path in EXAMPLES],
    ids=lambda path: path.stem,
)
def test_example(path: Path, tiny_finished: Path, tiny_settings: Path) -> None:
    command = [sys.executable, str(path), str(tiny_finished), str(tiny_settings)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for words in SAID[path.stem]:
        assert words in done.stdout
