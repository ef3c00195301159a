"""Replacement of a flattened boundary that crosses itself by a simple curve."""

from __future__ import annotations

import numpy as np

from mammometry.geometry.arrays import Array, Float64, Int64

_ROUNDS = 20  # rounds of removing crossings, after which a circle is used; not critical


def uncrossed(loop: Float64[Array, "n 2"]) -> Float64[Array, "n 2"]:
    """A closed curve without self-crossings. The curve itself if it has none.

    On overhanging skin, a curve that is simple on the surface may cross itself in a flat map. Points between the two
    passes of a crossing are put on a straight line. A curve that still crosses itself is replaced by a circle.

    Args:
        loop: corners in order, the first not repeated, mm.
    """
    simple = loop
    for _ in range(_ROUNDS):
        crossings = self_crossings(simple)
        if not len(crossings):
            return simple
        simple = simple.copy()
        for first, second in crossings:
            between = _shorter_arc(simple, int(first), int(second))
            ends = simple[(between[0] - 1) % len(loop)], simple[(between[-1] + 1) % len(loop)]
            share = np.arange(1, len(between) + 1)[:, None] / (len(between) + 1)
            simple[between] = (1 - share) * ends[0] + share * ends[1]
    return rounded(loop)


def rounded(loop: Float64[Array, "n 2"]) -> Float64[Array, "n 2"]:
    """Circle of the same length and direction as a closed curve, mm."""
    steps = np.linalg.norm(loop - np.roll(loop, 1, axis=0), axis=1)
    around = np.sign(signed_area_mm2(loop)) * 2 * np.pi * np.cumsum(steps) / steps.sum()
    radius = steps.sum() / (2 * np.pi)
    return np.asarray(loop.mean(axis=0) + radius * np.stack([np.cos(around), np.sin(around)], axis=1))


def signed_area_mm2(loop: Float64[Array, "n 2"]) -> float:
    """Area inside a closed loop, mm², positive if counter-clockwise."""
    x, y = (loop - loop.mean(axis=0)).T
    return float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2)


def self_crossings(loop: Float64[Array, "n 2"]) -> Int64[Array, "k 2"]:
    """Pairs of edges of a closed curve that cross. Edge i runs from corner i to the next."""
    a, b = loop, np.roll(loop, -1, axis=0)
    low, high = np.minimum(a, b), np.maximum(a, b)
    order = np.argsort(low[:, 0], kind="stable")
    last = np.searchsorted(low[order, 0], high[order, 0], side="right")
    found = []
    for place, edge in enumerate(order):  # edges to the right whose boxes overlap
        others = order[place + 1 : last[place]]
        others = others[(low[others, 1] <= high[edge, 1]) & (high[others, 1] >= low[edge, 1])]
        apart = (others - edge) % len(loop)
        others = others[(apart > 1) & (apart < len(loop) - 1)]
        if len(others):
            here = _side(a[edge], b[edge], a[others]) * _side(a[edge], b[edge], b[others]) < 0
            crossing = _side(a[others], b[others], a[edge]) * _side(a[others], b[others], b[edge]) < 0
            found += [(min(edge, other), max(edge, other)) for other in others[here & crossing]]
    return np.array(sorted(found), dtype=np.int64).reshape(-1, 2)


def _side(
    start: Float64[Array, "... 2"], end: Float64[Array, "... 2"], points: Float64[Array, "... 2"]
) -> Float64[Array, " n"]:
    """Twice the signed area of triangles of line and point: positive left of the line."""
    along, away = end - start, points - start
    return np.atleast_1d(along[..., 0] * away[..., 1] - along[..., 1] * away[..., 0])


def _shorter_arc(loop: Float64[Array, "n 2"], first: int, second: int) -> Int64[Array, " k"]:
    """Corners between two edges, along the shorter part of the curve."""
    forth = np.arange(first + 1, second + 1)
    back = np.arange(second + 1, first + 1 + len(loop)) % len(loop)
    return forth if len(forth) <= len(back) else back
