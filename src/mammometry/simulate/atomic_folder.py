"""A new folder that is complete or absent, whatever interrupts its making."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

_MAKER = "maker.json"
_LOCK = ".lock"


@contextmanager
def made_whole(out: Path) -> Iterator[Path]:
    """Yield a hidden folder that becomes `out` on success.

    Otherwise it is removed. It is in a workplace beside `out` that names its owner and is locked while it is filled.
    The system lifts the lock however its maker ends: a workplace of the same `out` without a lock was left by a killed
    maker, and is removed first. A folder without the marker of a workplace is left alone, whatever its name.

    Raises:
        OSError: the disk is full or may not be written, or something else has taken the place of `out`.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    prefix = f".{out.name}.simulate-"
    for left in sorted(out.parent.iterdir()):
        if left.name.startswith(prefix) and _is_workplace(left, out):
            _remove_unlocked(left)
    workplace = Path(tempfile.mkdtemp(prefix=prefix, dir=out.parent))
    try:
        with FileLock(workplace / _LOCK):
            (workplace / _MAKER).write_text(json.dumps(_claim(workplace, out)), encoding="utf-8")
            made = workplace / "made"
            made.mkdir()
            yield made
            if os.path.lexists(out):
                out.rmdir()  # fails unless it is an empty folder
            made.replace(out)
    finally:
        shutil.rmtree(workplace, ignore_errors=True)


def _claim(workplace: Path, out: Path) -> dict[str, str]:
    return {"workplace of mammometry": workplace.name, "for": out.name}


def _is_workplace(folder: Path, out: Path) -> bool:
    """Whether a folder is marked as a workplace for `out`. A copied or renamed one is not."""
    try:
        record = json.loads((folder / _MAKER).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
    return not folder.is_symlink() and record == _claim(folder, out)


def _remove_unlocked(workplace: Path) -> None:
    try:
        with FileLock(workplace / _LOCK, blocking=False):
            shutil.rmtree(workplace, ignore_errors=True)
    except (Timeout, OSError):
        return  # somebody is still filling it
