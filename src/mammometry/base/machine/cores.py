"""Work divided among the processor's cores."""

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
"""Environment variable: most cores that a process may use."""
_BLAS_THREADS = "OPENBLAS_NUM_THREADS"
_BANDS_PER_CORE = 4  # so that the cores end together where some bands take longer; chosen by eye


def available_cores() -> int:
    """Number of cores that this process may use, fewer if ``MAMMOMETRY_CORES`` says so."""
    count = allowed_cores()
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
