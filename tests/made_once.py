"""What is costly to make is made once a test run, whichever of its workers needs it first."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from filelock import FileLock


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], None]) -> Path:
    """Give a folder that `make` fills, once for all workers of a run; whoever changes it changes a copy.

    Args:
        factory: pytest's own.
        name: of the folder, one for each thing that is made.
        make: called with the folder, empty. If it raises, the next that asks tries again.
    """
    root = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        root = root.parent  # one below it for each worker
    folder, done = root / f"shared-{name}", root / f"shared-{name}.done"
    with FileLock(f"{folder}.lock"):
        if not done.exists():
            folder.mkdir()
            make(folder)
            done.touch()
    return folder
