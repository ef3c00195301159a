"""Directions spread evenly over the sphere."""

import numpy as np

from mammometry.geometry.arrays import Array, Float64


def even_directions(count: int) -> Float64[Array, "k 3"]:
    """Unit vectors spread evenly over the sphere on a Fibonacci spiral, from z = 1 to z = −1."""
    place = np.arange(count) + 0.5
    z = 1.0 - 2.0 * place / count
    azimuth = place * np.pi * (3.0 - np.sqrt(5.0))
    ring = np.sqrt(1.0 - z * z)
    return np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], axis=1)
