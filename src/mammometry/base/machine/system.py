"""Differences between systems. Nothing else names modules and functions that one lacks.

Tested on Linux. Where Windows has no counterpart, the function does nothing there.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

WINDOWS = os.name == "nt"
_BYTES_A_UNIT = 1 if sys.platform == "darwin" else 1024
"""Unit of `ru_maxrss`: bytes on macOS, KiB elsewhere (getrusage(2))."""
_MIB = 1 << 20  # bytes in a MiB


def allowed_cores() -> int:
    """Number of cores that the system lets this process use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def peak_memory_mb() -> float:
    """Peak memory of this process or a finished child, MB to 0.1. On Windows of this process alone."""
    if WINDOWS:
        import psutil

        return round(float(psutil.Process().memory_info().peak_wset) / _MIB, 1)
    import resource

    most = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return round(most * _BYTES_A_UNIT / _MIB, 1)


def limit_memory(most_bytes: int) -> None:
    """Give this process so much address space at most, for good. Windows sets no such limit."""
    if not WINDOWS:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (most_bytes, most_bytes))


def lower_priority() -> None:
    """Let other processes come first, for good."""
    import psutil

    psutil.Process().nice(psutil.BELOW_NORMAL_PRIORITY_CLASS if WINDOWS else 10)


def own_group() -> dict[str, Any]:
    """Arguments of `subprocess.Popen` for a child that does not hear Ctrl-C at the terminal."""
    if WINDOWS:
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}  # type: ignore[attr-defined]
    return {"start_new_session": True}


def sync_folder(folder: Path) -> None:
    """Wait until the names in a folder are on the disk. Windows keeps them itself.

    Raises:
        OSError: the disk refuses.
    """
    if WINDOWS:
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


_TRIM_THRESHOLD, _MMAP_MAX, _ARENA_MAX = -1, -4, -8  # mallopt(3): the numbers of what it sets
_KEPT_BYTES = 1 << 28
"""256 MB of freed memory are kept for reuse at the heap's end at most. Chosen by eye."""


@cache
def reuse_freed_memory() -> None:
    """Take all arrays from one heap, and keep what was freed for reuse.

    Does nothing without glibc. glibc asks the system for each large array anew, which clears every page that it hands
    out: a sixth of a torso's processor seconds (docs/decisions/0042). And threads have a heap each, in which the arrays
    of one matching step stay beside those of the next.
    """
    with suppress(OSError, AttributeError, TypeError):  # another C library
        library = ctypes.CDLL(None)
        for what, value in ((_MMAP_MAX, 0), (_TRIM_THRESHOLD, _KEPT_BYTES), (_ARENA_MAX, 1)):
            library.mallopt(what, value)
