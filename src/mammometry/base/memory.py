"""Peak memory of the process, and the return of freed memory."""

import ctypes
import sys
from contextlib import suppress
from functools import cache

_MMAP_THRESHOLD = -3  # glibc's name for the size from which memory is asked of the system piece by piece
_LEAST_BYTES = 1 << 23
"""8 MB: smaller than an image's working arrays, so that all of them are returned. Chosen by eye."""
_BYTES_A_UNIT = 1 if sys.platform == "darwin" else 1024
"""Unit of `ru_maxrss`: bytes on macOS, KiB elsewhere (getrusage(2))."""
_MIB = 1 << 20  # bytes in a MiB


@cache
def return_freed_arrays() -> None:
    """Return the memory of large arrays to the system once freed.

    Does nothing without glibc. glibc soon takes arrays of up to 32 MB from one heap a thread and keeps freed memory
    for reuse. Without this call, the arrays of one matching step stay resident beside those of the next.
    """
    with suppress(OSError, AttributeError, TypeError):  # another C library
        ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, _LEAST_BYTES)


def peak_memory_mb() -> float | None:
    """Peak memory of this process or a finished child, MB to 0.1.

    None on Windows.
    """
    try:
        import resource
    except ImportError:  # Windows has no such module
        return None
    most = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return round(most * _BYTES_A_UNIT / _MIB, 1)
