"""Points along closed polygons, by arc length."""

from __future__ import annotations

import numpy as np

from mammometry.geometry.arrays import Array, Float64


def closed_length_mm(corners: Float64[Array, "n 3"]) -> float:
    """Length of a closed polygon with corners (n, 3), mm. The last corner joins the first."""
    return float(_distances(_closed(corners))[-1])


def points_along(corners: Float64[Array, "n 3"], at_mm: Float64[Array, " m"]) -> Float64[Array, "m 3"]:
    """Points (m, 3), mm, of a closed polygon (n, 3), mm, at arc lengths from its first corner."""
    loop = _closed(corners)
    along = _distances(loop)
    return np.stack([np.interp(at_mm, along, loop[:, axis]) for axis in range(3)], axis=1)


def evenly_spaced(corners: Float64[Array, "n 3"], count: int) -> Float64[Array, "m 3"]:
    """Points (count, 3), mm, at equal distances along a closed polygon, starting at its first corner."""
    return points_along(corners, np.linspace(0.0, closed_length_mm(corners), count, endpoint=False))


def _closed(corners: Float64[Array, "n 3"]) -> Float64[Array, "k 3"]:
    return np.concatenate([corners, corners[:1]])


def _distances(loop: Float64[Array, "k 3"]) -> Float64[Array, " k"]:
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(loop, axis=0), axis=1))])
