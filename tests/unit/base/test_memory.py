"""Memory: what was freed is used again, seen in a process of its own; the peak is at least what is held."""

import platform
import subprocess
import sys

import psutil
import pytest

from mammometry.base.machine.system import peak_memory_mb

PROGRAM = """
import resource, numpy as np, psutil
from mammometry.base.machine.system import reuse_freed_memory
reuse_freed_memory()
def faults(): return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
held = psutil.Process().memory_info().rss
begun, first = faults(), np.ones(100 << 20, np.uint8)
once = faults() - begun
del first
begun, again = faults(), np.ones(100 << 20, np.uint8)
print(once, faults() - begun)
kept = [np.ones(100 << 20, np.uint8) for _ in range(10)]
del again, kept
print((psutil.Process().memory_info().rss - held) >> 20)
"""


@pytest.mark.slow
@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="there is nothing to be set on another C library")
def test_what_an_array_took_is_used_again_and_most_of_much_goes_back() -> None:
    said = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, check=True, text=True).stdout
    once, again, kept_mb = map(int, said.split())
    assert once > 40  # pages of 4 KB or 2 MB
    assert again < once / 4
    assert kept_mb <= 300  # of 1,000


PINNED = """
import numpy as np, psutil
from mammometry.base.machine.system import return_freed_memory, reuse_freed_memory
reuse_freed_memory()
def held_mb(): return psutil.Process().memory_info().rss >> 20
begun = held_mb()
large, small = [], []
for _ in range(200):
    large.append(np.ones(1 << 20, np.uint8))
    small.append(np.ones(1 << 10, np.uint8))
del large
print(held_mb() - begun)
return_freed_memory()
print(held_mb() - begun)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="there is nothing to be set on another C library")
def test_freed_memory_between_values_that_are_kept_goes_back_when_asked() -> None:
    said = subprocess.run([sys.executable, "-c", PINNED], capture_output=True, check=True, text=True).stdout
    before_mb, after_mb = map(int, said.split())
    assert before_mb > 150  # of 200: the small arrays between them keep the heap from shrinking
    assert after_mb < 20


def test_the_peak_is_at_least_what_is_held_now() -> None:
    peak_mb = peak_memory_mb()
    held_mb = psutil.Process().memory_info().rss / (1 << 20)
    assert held_mb - 1 < peak_mb < held_mb + 16384
