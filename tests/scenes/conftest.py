"""A tiny virtual session, rendered once a test run: one pair of cameras at a tenth of the reference size."""

import io
import json
import shutil
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import pytest
from tests.made_once import made_once

from mammometry.cli import main, simulation
from mammometry.simulate.recipe import SessionRecipe

TINY = SessionRecipe(rig="reference:front", subject="plaster_2", scale=0.1, seed=7, poses=8)
"""A cast of whose rim one pair sees more than half, and poses enough to calibrate by: nothing is refused by default."""
TRUE_CC = 426.4
TINY_SETTINGS = """\
# Coarse, so that a run takes seconds (coarser ones lose the rim).
[surface.extract]
cube_mm = 1.0
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

    def make(folder: Path) -> None:
        answer = io.StringIO()
        with pytest.MonkeyPatch.context() as patch, redirect_stdout(answer):
            patch.setattr(simulation, "_DEMO_RECIPE", TINY)
            command = ["demo", str(folder / "session"), "--settings", str(tiny_settings), "--json"]
            assert main.run(command) == 0, answer.getvalue()
        (folder / "answer.json").write_text(answer.getvalue())

    folder = made_once(tmp_path_factory, "tiny-demo", make)
    table: dict[str, Any] = json.loads((folder / "answer.json").read_text())
    return table


@pytest.fixture(scope="session")
def tiny_finished_original(tiny_demo: dict[str, Any]) -> Path:
    """The tiny session with all its results; copy it before you change it."""
    return Path(tiny_demo["session"])


@pytest.fixture(scope="session")
def tiny_original(tmp_path_factory: pytest.TempPathFactory, tiny_finished_original: Path) -> Iterator[Path]:
    """The tiny session without results; copy it before you change it."""
    folder = tmp_path_factory.mktemp("tiny") / "session"
    yield Path(shutil.copytree(tiny_finished_original, folder, ignore=shutil.ignore_patterns("results")))
    assert not (folder / "results").exists(), "a test wrote results into the original: let it use the fixture `tiny`"


@pytest.fixture
def tiny(tmp_path: Path, tiny_original: Path) -> Path:
    """A copy of the tiny session without results."""
    return Path(shutil.copytree(tiny_original, tmp_path / tiny_original.name))


@pytest.fixture
def tiny_finished(tmp_path: Path, tiny_finished_original: Path) -> Path:
    """A copy of the tiny session with all its results, of the same name: its report shows it."""
    return Path(shutil.copytree(tiny_finished_original, tmp_path / tiny_finished_original.name))
