"""What the C library does with memory that is no longer used."""

import ctypes
from contextlib import suppress
from functools import cache

_MMAP_THRESHOLD = -3  # glibc's name for the size from which memory is asked of the system piece by piece
_LEAST_BYTES = 1 << 23


@cache
def return_freed_arrays() -> None:
    """Have the memory of large arrays go back to the system once they are freed; without glibc, do nothing.

    glibc soon takes arrays of up to 32 MB from heaps of its own, one a thread, and keeps what is freed for the next:
    the arrays of one step of the matching would stay resident beside those of the following ones.
    """
    with suppress(OSError, AttributeError, TypeError):  # another C library
        ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, _LEAST_BYTES)
