"""Two scans of one analytic body: a front with asymmetric bumps, of which each scan shows a part."""

from __future__ import annotations

import numpy as np

from mammometry.geometry import Array, Float64, TriangleMesh, UInt8
from mammometry.measure.merging.fusion import ColouredMesh

_BUMPS = np.array(
    [[-60.0, -10.0, 55.0, 45.0], [70.0, 15.0, 40.0, 38.0], [0.0, 110.0, -22.0, 40.0], [-20.0, -110.0, 14.0, 25.0]]
)
"""Middle x and y, height and radius of each bump, mm."""
SIDE_MM = 5.0


def height_mm(x: Float64[Array, " n"], y: Float64[Array, " n"], lift_mm: float = 0.0) -> Float64[Array, " n"]:
    """Height of the body's skin. `lift_mm` raises the second bump, as another posture does."""
    total = -((x / 160.0) ** 2) * 60.0 - (y / 400.0) ** 2 * 20.0
    for number, (u, v, tall, radius) in enumerate(_BUMPS):
        total = total + (tall + lift_mm * (number == 1)) * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * radius**2))
    return total


def part(low_mm: float, high_mm: float, *, lift_mm: float = 0.0, seed: int = 0) -> TriangleMesh:
    """The body's skin between two heights on the y axis, with noise of 0.1 mm."""
    x, y = np.meshgrid(np.arange(-150.0, 151.0, SIDE_MM), np.arange(low_mm, high_mm + 0.1, SIDE_MM))
    noise = 0.1 * np.random.default_rng(seed).normal(size=x.size)
    points = np.column_stack([x.ravel(), y.ravel(), height_mm(x.ravel(), y.ravel(), lift_mm) + noise])
    number = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (corner.ravel() for corner in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return TriangleMesh(vertices=points, faces=faces.astype(np.int32))


def painted(mesh: TriangleMesh, grey: int) -> ColouredMesh:
    """A mesh in one grey."""
    colours: UInt8[Array, "n 3"] = np.full((len(mesh.vertices), 3), grey, dtype=np.uint8)
    return ColouredMesh(mesh=mesh, colours=colours)
