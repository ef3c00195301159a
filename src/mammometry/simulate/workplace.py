"""A new folder that is whole or not there, whatever interrupts its making."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

if sys.platform != "win32":
    import fcntl


@contextmanager
def made_whole(out: Path) -> Iterator[Path]:
    """Give a hidden folder beside `out` that becomes `out` when the block ends well, and is removed when it does not.

    While it is being filled, its maker holds a lock on it, which the system lifts however the maker ends. What a killed
    maker left of the same `out` is therefore known by its lock being free, and removed first; a folder that somebody
    else is still filling is left alone.

    Raises:
        OSError: the disk is full or may not be written.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    prefix = f".{out.name}.simulate-"
    for left in sorted(out.parent.glob(f"{_escaped(prefix)}*")):
        if (lock := _locked(left)) is not None:
            shutil.rmtree(left, ignore_errors=True)
            os.close(lock)
    folder = Path(tempfile.mkdtemp(prefix=prefix, dir=out.parent))
    lock = _locked(folder)
    try:
        yield folder
        folder.chmod(0o755)
        if out.exists():
            out.rmdir()
        folder.replace(out)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    finally:
        if lock is not None:
            os.close(lock)


def _locked(folder: Path) -> int | None:
    """A descriptor that holds the folder's lock; None where somebody else holds it, or there are no such locks."""
    if sys.platform == "win32":
        return None
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


def _escaped(name: str) -> str:
    """The name as a pattern that only it matches."""
    return "".join(f"[{letter}]" if letter in "*?[" else letter for letter in name)
