"""How much memory the process has held, and what becomes of memory that is no longer used."""

import ctypes
import sys
from contextlib import suppress
from functools import cache

_MMAP_THRESHOLD = -3  # glibc's name for the size from which memory is asked of the system piece by piece
_LEAST_BYTES = 1 << 23
"""8 MB: smaller than an image's working arrays, so that all of these are given back. Chosen by eye."""
_BYTES_A_UNIT = 1 if sys.platform == "darwin" else 1024
"""Unit of `ru_maxrss`: bytes on macOS, KiB elsewhere (getrusage(2))."""
_MIB = 1 << 20


@cache
def return_freed_arrays() -> None:
    """Have the memory of large arrays go back to the system once they are freed. Without glibc, do nothing.

    glibc soon takes arrays of up to 32 MB from heaps of its own, one a thread, and keeps what is freed for the next:
    the arrays of one step of the matching would stay resident beside those of the following ones.
    """
    with suppress(OSError, AttributeError, TypeError):  # another C library
        ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, _LEAST_BYTES)


def peak_memory_mb() -> float | None:
    """Return the most memory that this process or a finished child has held, MB to 0.1. None on Windows."""
    try:
        import resource
    except ImportError:  # Windows has no such module
        return None
    most = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return round(most * _BYTES_A_UNIT / _MIB, 1)
