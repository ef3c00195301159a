"""Memory: freed arrays go back to the system, seen in a process of its own; the peak is at least what is held."""

import platform
import subprocess
import sys

import psutil
import pytest

from mammometry.base.machine.system import peak_memory_mb

PROGRAM = """
import numpy as np, psutil
from mammometry.base.machine.system import return_freed_arrays
return_freed_arrays()
first = np.ones(31 << 20, np.uint8)  # its release would raise glibc's own threshold to as much
del first
kept = [np.ones(30 << 20, np.uint8) for _ in range(10)]
last = np.ones(30 << 20, np.uint8)  # at the heap's end: keeps what lies before it from being trimmed
full = psutil.Process().memory_info().rss
del kept
print((full - psutil.Process().memory_info().rss) >> 20)
"""


@pytest.mark.slow
@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="there is nothing to be set on another C library")
def test_what_arrays_took_goes_back_to_the_system() -> None:
    freed_mb = int(subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, check=True, text=True).stdout)
    assert freed_mb >= 290


def test_the_peak_is_at_least_what_is_held_now() -> None:
    peak_mb = peak_memory_mb()
    held_mb = psutil.Process().memory_info().rss / (1 << 20)
    assert held_mb - 1 < peak_mb < held_mb + 16384
