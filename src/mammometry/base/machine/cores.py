"""Work divided among the processor's cores, and the memory that it takes."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import cache
from typing import TypeVar

from threadpoolctl import threadpool_limits

_R = TypeVar("_R")
_T = TypeVar("_T")

CORES = "MAMMOMETRY_CORES"
"""Environment variable: most cores that a process may use."""
_BLAS_THREADS = "OPENBLAS_NUM_THREADS"
_BANDS_PER_CORE = 4  # so that the cores end together where some bands take longer; chosen by eye


def available_cores() -> int:
    """Number of cores that this process may use.

    All that the system allows, or fewer if ``MAMMOMETRY_CORES`` says so.
    """
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    wanted = os.environ.get(CORES, "")
    return min(count, max(1, int(wanted))) if wanted.isdecimal() else count


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Have BLAS use no threads of its own inside.

    Products are made side by side and our matrices are small: threads of BLAS on top would wait for each other. And
    its sums come out the same to the last bit, however many cores there are. SciPy has a BLAS of its own, which may be
    loaded only inside: it reads the environment then.
    """
    before = os.environ.get(_BLAS_THREADS)
    os.environ[_BLAS_THREADS] = "1"
    try:
        with threadpool_limits(limits=1, user_api="blas"):
            yield
    finally:
        if before is None:
            os.environ.pop(_BLAS_THREADS, None)
        else:
            os.environ[_BLAS_THREADS] = before


def in_bands(work: Callable[[slice], _R], count: int) -> list[_R]:
    """Run lock-free work on consecutive parts of `count` things, in threads.

    Returns the parts' results in order. There are more parts than cores, since some take longer than others, and at
    least one.
    """
    size = max(1, -(-count // (available_cores() * _BANDS_PER_CORE)))
    return each_at_once(work, [slice(first, first + size) for first in range(0, max(count, 1), size)])


def each_at_once(work: Callable[[_T], _R], things: Sequence[_T]) -> list[_R]:
    """Run lock-free work on each of a few things, in threads. Returns the results in order."""
    with ThreadPoolExecutor(available_cores()) as pool:
        return list(pool.map(work, things))


_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8  # mallopt(3): the numbers of what it sets
_LEAST_BYTES = 1 << 23
"""8 MB: smaller than an image's working arrays, so that all of them are returned. Chosen by eye."""
_KEPT_BYTES = 1 << 27
"""128 MB of smaller ones are kept for reuse at most. Chosen by eye."""
_BYTES_A_UNIT = 1 if sys.platform == "darwin" else 1024
"""Unit of `ru_maxrss`: bytes on macOS, KiB elsewhere (getrusage(2))."""
_MIB = 1 << 20  # bytes in a MiB


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


def peak_memory_mb() -> float | None:
    """Peak memory of this process or a finished child, MB to 0.1. None on Windows."""
    try:
        import resource
    except ImportError:  # Windows has no such module
        return None
    most = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return round(most * _BYTES_A_UNIT / _MIB, 1)
