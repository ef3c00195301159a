"""The return of freed memory to the system."""

import ctypes
from contextlib import suppress
from functools import cache

_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8  # mallopt(3): the numbers of what it sets
_LEAST_BYTES = 1 << 23
"""8 MB: smaller than an image's working arrays, so that all of them are returned. Chosen by eye."""
_KEPT_BYTES = 1 << 27
"""128 MB of smaller ones are kept for reuse at most. Chosen by eye."""


@cache
def return_freed_arrays() -> None:
    """Return the memory of large arrays to the system once freed.

    Does nothing without glibc. glibc soon takes arrays of up to 32 MB from one heap a thread and keeps freed memory
    for reuse. Without this call, the arrays of one matching step stay resident beside those of the next. Smaller ones
    come from one heap for all threads begun afterwards, which gives less back: the system clears each page that it
    hands out, a fifth of a torso's time.
    """
    with suppress(OSError, AttributeError, TypeError):  # another C library
        library = ctypes.CDLL(None)
        for what, value in ((_MMAP_THRESHOLD, _LEAST_BYTES), (_TRIM_THRESHOLD, _KEPT_BYTES), (_ARENA_MAX, 1)):
            library.mallopt(what, value)
