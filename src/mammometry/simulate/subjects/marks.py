"""Marks on the skin: scars, folds of loose skin, drains' marks, paddles, tattoos.

They are in the plane of a breast's (former) base: x to the side, y up, mm from its centre. They raise or lower the
skin, and multiply its colour by factors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mammometry.geometry.arrays import Array, Float32, Float64
from mammometry.simulate.subjects.solid import smoothstep

_SOFT_MM = 1.5  # half the width over which a mark's colour fades; made up

Point = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class SkinMark:
    """One mark: a line with a width, a spot (a line of one point), or a field (a closed line)."""

    side: str
    """Side of the breast in whose plane it is: "left" or "right"."""
    line_mm: tuple[Point, ...]
    """Points along it."""
    half_width_mm: float
    """Half-width of the coloured area."""
    colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Factors on the skin's red, green and blue."""
    height_mm: float = 0.0
    """Height above the skin, negative for a groove."""
    slope_mm: float = 4.0
    """Distance over which the relief fades (standard deviation)."""
    filled: bool = False
    """Whether the line is closed and its interior is marked."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Marked:
    """Effect of marks on a mesh's vertices."""

    height_mm: Mapping[str, Float64[Array, " n"]]
    """Side → height by which the skin is lifted along that breast's axis."""
    tint: Float32[Array, "n 3"]
    """Factors on the skin's colour."""


def mark(marks: Sequence[SkinMark], places_mm: Mapping[str, Float64[Array, "n 2"]]) -> Marked | None:
    """Sum of the marks at vertices with positions in each breast's plane. None without marks."""
    if not marks:
        return None
    count = len(next(iter(places_mm.values())))
    height = {side: np.zeros(count) for side in places_mm}
    tint = np.ones((count, 3))
    for painted in marks:
        place = places_mm[painted.side]
        away = distance_mm(place, painted.line_mm)
        if painted.filled:
            away = np.where(_within(place, painted.line_mm), 0.0, away)
        share = smoothstep(painted.half_width_mm + _SOFT_MM, painted.half_width_mm - _SOFT_MM, away)
        tint *= 1.0 + share[:, None] * (np.array(painted.colour) - 1.0)
        height[painted.side] += painted.height_mm * np.exp(-0.5 * (away / painted.slope_mm) ** 2)
    return Marked(height_mm=height, tint=tint.astype(np.float32))


def distance_mm(place: Float64[Array, "n 2"], line: Sequence[Point]) -> Float64[Array, " n"]:
    """Distance of positions from a polyline, or from a point."""
    corners = np.array(line, dtype=np.float64)
    nearest: Float64[Array, " n"] = np.linalg.norm(place - corners[0], axis=1)
    for start, end in pairwise(corners):
        along = end - start
        share = np.clip((place - start) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
        nearest = np.minimum(nearest, np.linalg.norm(place - start - share[:, None] * along, axis=1))
    return nearest


def _within(place: Float64[Array, "n 2"], outline: Sequence[Point]) -> Array:
    """Whether positions are inside a closed line: a ray to the side crosses it an odd number of times."""
    x, y = place.T
    inside = np.zeros(len(place), dtype=bool)
    corners = np.array(outline)
    for (ax, ay), (bx, by) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        crosses = (ay > y) != (by > y)
        with np.errstate(divide="ignore", invalid="ignore"):
            inside ^= crosses & (x < (bx - ax) * (y - ay) / (by - ay) + ax)
    return inside
