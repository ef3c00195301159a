"""A tiny virtual session, rendered once a test run: one pair of cameras at a tenth of the reference size."""

import io
import json
import shutil
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import pytest

from mammometry.cli import main, simulation

TINY = {"rig": "reference:front", "subject": "plaster_5", "scale": 0.1, "seed": 7, "poses": 4}
TINY_SETTINGS = """\
# Coarse, so that a run takes seconds (coarser ones lose the rim).
# Four poses of so small pictures do not calibrate well: measure all the same.
[calibration.quality]
focal_std_refuse = 0.01
[surface.extract]
cube_mm = 1.0
# They show the rim in 32 of 72 directions, with gaps of a few degrees where larger ones have none.
[measure.base_rim]
minimum_sectors = 24
"""


@pytest.fixture(scope="session")
def tiny_settings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Settings file for the tiny session."""
    path = tmp_path_factory.mktemp("settings") / "tiny.toml"
    path.write_text(TINY_SETTINGS)
    return path


@pytest.fixture(scope="session")
def tiny_demo(tmp_path_factory: pytest.TempPathFactory, tiny_settings: Path) -> dict[str, Any]:
    """What `mammometry demo --json` answers when its session is the tiny one."""
    folder = tmp_path_factory.mktemp("tiny-demo") / "session"
    answer = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(answer):
        patch.setattr(simulation, "_DEMO_SESSION", TINY)
        assert main.run(["demo", str(folder), "--settings", str(tiny_settings), "--json"]) == 0, answer.getvalue()
    table: dict[str, Any] = json.loads(answer.getvalue())
    return table


@pytest.fixture(scope="session")
def tiny_finished_original(tiny_demo: dict[str, Any]) -> Path:
    """The tiny session with all its results; copy it before you change it."""
    return Path(tiny_demo["session"])


@pytest.fixture(scope="session")
def tiny_original(tmp_path_factory: pytest.TempPathFactory, tiny_finished_original: Path) -> Path:
    """The tiny session without results; copy it before you change it."""
    folder = tmp_path_factory.mktemp("tiny") / "session"
    return Path(shutil.copytree(tiny_finished_original, folder, ignore=shutil.ignore_patterns("results")))


@pytest.fixture
def tiny(tmp_path: Path, tiny_original: Path) -> Path:
    """A copy of the tiny session without results."""
    return Path(shutil.copytree(tiny_original, tmp_path / tiny_original.name))


@pytest.fixture
def tiny_finished(tmp_path: Path, tiny_finished_original: Path) -> Path:
    """A copy of the tiny session with all its results, of the same name: its report shows it."""
    return Path(shutil.copytree(tiny_finished_original, tmp_path / tiny_finished_original.name))
