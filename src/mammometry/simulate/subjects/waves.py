"""Smooth random fields over space, and an easing step."""

from __future__ import annotations

import math

import numpy as np

from mammometry.geometry.arrays import Array, Float64


def waves(points: Array, rng: np.random.Generator, *, shortest_mm: float, longest_mm: float) -> Float64[Array, " n"]:
    """Sum of a few plane waves in random directions, about unit amplitude."""
    total = np.zeros(len(points))
    count = 10
    for _ in range(count):
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        length = math.exp(rng.uniform(math.log(shortest_mm), math.log(longest_mm)))
        total += np.sin(points @ direction * (2 * math.pi / length) + rng.uniform(0.0, 2 * math.pi))
    return total * math.sqrt(2.0 / count)


def smoothstep(low: float, high: float, value: Array) -> Array:
    """Ease from 0 at `low` to 1 at `high`, flat at both.

    `low` may be the greater.
    """
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)
