"""Distribute work over the processor's cores."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

from threadpoolctl import threadpool_limits

from mammometry.base.machine.system import allowed_cores

_R = TypeVar("_R")
_T = TypeVar("_T")

CORES = "MAMMOMETRY_CORES"
"""Environment variable: largest number of cores that a process uses."""
_BLAS_THREADS = "OPENBLAS_NUM_THREADS"
_BANDS_PER_CORE = 4  # bands take different times; more of them keep all cores busy; affects speed only


def available_cores() -> int:
    """Number of cores that this process may use, limited by ``MAMMOMETRY_CORES``."""
    count = allowed_cores()
    wanted = os.environ.get(CORES, "")
    return min(count, max(1, int(wanted))) if wanted.isdecimal() else count


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread inside the block.

    Products are computed in parallel and their matrices are small, so BLAS threads would wait for each other. Sums are
    then also equal to the last bit on any number of cores. If SciPy's own BLAS is loaded inside the block, it reads the
    limit from environment variables.
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
    """Run lock-free work in threads on consecutive slices of `count` items.

    Returns the results in order. There are more slices than cores, because some take longer; there is at least one.
    """
    size = max(1, -(-count // (available_cores() * _BANDS_PER_CORE)))
    return map_in_threads(work, [slice(first, first + size) for first in range(0, max(count, 1), size)])


def map_in_threads(work: Callable[[_T], _R], things: Sequence[_T]) -> list[_R]:
    """Run lock-free work on each of a few items, in threads. Returns the results in order."""
    with ThreadPoolExecutor(available_cores()) as pool:
        return list(pool.map(work, things))
