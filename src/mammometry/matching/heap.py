"""Memory that was freed, given back to the system."""

import ctypes
from collections.abc import Callable
from functools import cache


def give_back() -> None:
    """Let the allocator return what it keeps of freed arrays, where it can (glibc's malloc_trim); else do nothing.

    glibc takes arrays below 32 MB from heaps of its own, one a thread, and keeps what is freed for the next: arrays of
    one level stay resident beside those of the next. It takes milliseconds.
    """
    trim = _trim()
    if trim is not None:
        trim(0)


@cache
def _trim() -> Callable[[int], int] | None:
    try:
        found: Callable[[int], int] = ctypes.CDLL(None).malloc_trim
    except (OSError, AttributeError, TypeError):  # another C library
        return None
    return found
