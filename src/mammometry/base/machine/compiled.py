"""How kernels are compiled.

All kernels share their options, so that numba compiles once what they have in common, such as the making of arrays.
None is compiled with ``parallel=True``, which takes several times as long: kernels hold no lock, and where it is worth
it `cores.in_bands` divides their work among threads. A kernel copies parts of arrays element by element: an assignment
of slices makes numba compile the text of the error that it would raise, which takes a second.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit

from mammometry.base.machine.kernel_cache import choose_cpu, keep

choose_cpu()


def kernel(function: Callable[..., Any]) -> Any:
    """Compile in strict IEEE arithmetic: x / 0 is infinite or NaN."""
    return keep(njit(nogil=True, error_model="numpy")(function))


def fast_kernel(function: Callable[..., Any]) -> Any:
    """Compile so that sums may be taken in any order. Neither infinity nor NaN may occur."""
    return keep(njit(nogil=True, error_model="numpy", fastmath=True)(function))


def small_kernel(function: Callable[..., Any]) -> Any:
    """Compile what other kernels call for every pixel.

    It is copied into them, since calls cost more than the little that it computes, and rounds as `kernel` does.
    """
    return keep(njit(nogil=True, error_model="numpy", forceinline=True)(function))
