"""Functions that differ between operating systems.

Tested on Linux. Functions without an equivalent on Windows do nothing there.
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
_MIB = 1 << 20  # bytes per MiB


def allowed_cores() -> int:
    """Number of cores that the system allows this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def peak_memory_mb() -> float:
    """Peak memory of this process or of a finished child, MB, to 0.1. On Windows, of this process only."""
    if WINDOWS:
        import psutil

        return round(float(psutil.Process().memory_info().peak_wset) / _MIB, 1)
    import resource

    most = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return round(most * _BYTES_A_UNIT / _MIB, 1)


def limit_memory(most_bytes: int) -> None:
    """Limit the address space of this process permanently. Does nothing on Windows."""
    if not WINDOWS:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (most_bytes, most_bytes))


def lower_priority() -> None:
    """Lower the priority of this process permanently."""
    import psutil

    psutil.Process().nice(psutil.BELOW_NORMAL_PRIORITY_CLASS if WINDOWS else 10)


def own_group() -> dict[str, Any]:
    """Arguments of `subprocess.Popen` for a child that does not receive Ctrl-C from the terminal."""
    if WINDOWS:
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}  # type: ignore[attr-defined]
    return {"start_new_session": True}


def sync_folder(folder: Path) -> None:
    """Wait until the entries of a folder are on the disk. Does nothing on Windows.

    Raises:
        OSError: the disk reports an error.
    """
    if WINDOWS:
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


_TRIM_THRESHOLD, _MMAP_MAX, _ARENA_MAX = -1, -4, -8  # mallopt(3): numbers of its parameters
_KEPT_BYTES = 1 << 28
"""Most freed memory that is kept at the end of the heap for reuse: 256 MB. Affects speed only."""


@cache
def reuse_freed_memory() -> None:
    """Allocate all arrays from one heap and keep freed memory for reuse.

    Does nothing without glibc. By default, glibc requests each large array from the system, which clears every page.
    This takes a sixth of the processor time for a torso (docs/decisions/0042). It also gives each thread its own heap,
    so that the arrays of one matching step remain allocated during the next.
    """
    with suppress(OSError, AttributeError, TypeError):  # another C library
        library = ctypes.CDLL(None)
        for what, value in ((_MMAP_MAX, 0), (_TRIM_THRESHOLD, _KEPT_BYTES), (_ARENA_MAX, 1)):
            library.mallopt(what, value)


def return_freed_memory() -> None:
    """Return freed memory to the system. Does nothing without glibc.

    Small values between freed arrays prevent the heap from shrinking by itself, so each product would need memory in
    addition to that of the earlier ones.
    """
    with suppress(OSError, AttributeError, TypeError):  # another C library
        ctypes.CDLL(None).malloc_trim(0)
