"""Create a folder completely or not at all, even after a crash."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from mammometry.base.errors import SessionError

_MAKER = "maker.json"
_LOCK = ".lock"


def require_new(out: Path, *, found: str = "something there already") -> None:
    """Require that a path does not exist or is an empty folder.

    Args:
        out: the folder to make.
        found: what is there, for the message.

    Raises:
        SessionError: `out` is in use.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise SessionError(
            str(out),
            found=found,
            expected="a folder that does not exist yet, or an empty one",
            remedy="Choose another name, or remove it",
        )


@contextmanager
def whole_folder(out: Path) -> Iterator[Path]:
    """Yield a hidden folder that becomes `out` on success and is removed on failure.

    It is in a working folder next to `out`, which is marked as ours and locked. The lock is released when its process
    dies, so an unlocked working folder for the same `out` was left by a killed process, and is removed first. Folders
    without our mark are never removed.

    Raises:
        OSError: the disk is full or not writable, or another process has created `out`.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    prefix = f".{out.name}.making-"
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
                out.rmdir()  # fails if it is not empty
            made.replace(out)
    finally:
        shutil.rmtree(workplace, ignore_errors=True)


def _claim(workplace: Path, out: Path) -> dict[str, str]:
    return {"workplace of mammometry": workplace.name, "for": out.name}


def _is_workplace(folder: Path, out: Path) -> bool:
    """Whether a folder is marked as a working folder for `out`. Copied or renamed ones are not."""
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
        return  # another process is filling it
