"""A fixed piece of work as unit of time, to compare machines and loads.

    python -m benchmarks.speed.reference

A compiled loop over an image (a blur, whose every step needs the one before) and a sort in NumPy, on one core. It never
changes and is no part of the package. Benchmarks time it before and after what they measure, and print seconds beside
multiples of its own.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numba import njit

_SIDE = 2000  # of the image, pixels
_SWEEPS = 20
_SORTED = 4_000_000


@dataclass(kw_only=True)
class Reference:
    """Mean of the work's times before and after a block; NaN inside it."""

    wall_s: float = float("nan")
    processor_s: float = float("nan")

    def __str__(self) -> str:
        return f"reference work: {self.wall_s:.2f} s by the clock, {self.processor_s:.2f} processor s"


@njit(cache=True)
def _swept(image: np.ndarray) -> float:
    for _ in range(_SWEEPS):
        for row in range(1, image.shape[0]):
            for column in range(1, image.shape[1]):
                image[row, column] = 0.5 * image[row, column] + 0.25 * (image[row - 1, column] + image[row, column - 1])
    return image[-1, -1]


def work() -> tuple[float, float]:
    """Do the work once: seconds by the clock and of the processor."""
    rng = np.random.default_rng(0)
    image, numbers = rng.random((_SIDE, _SIDE)), rng.random(_SORTED)
    wall, processor = time.monotonic(), time.process_time()
    _swept(image)
    np.sort(numbers)
    return time.monotonic() - wall, time.process_time() - processor


@contextmanager
def beside() -> Iterator[Reference]:
    """Time the work before and after the block. The mean is known when the block has ended."""
    work()  # compiled
    before, reference = work(), Reference()
    yield reference
    after = work()
    reference.wall_s, reference.processor_s = (0.5 * (a + b) for a, b in zip(before, after, strict=True))


if __name__ == "__main__":
    with beside() as found:
        pass
    print(found)
