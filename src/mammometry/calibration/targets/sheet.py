"""What is printed, as dark shapes on white paper: PDF and virtual pictures are drawn from it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from mammometry.geometry.arrays import Array, Bool, Float64, UInt8

DARK, WHITE, MARKER = 0, 1, 2
"""What is printed in a square of a `Pattern`."""


def _none(columns: int) -> np.ndarray:
    return np.zeros((0, columns))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sheet:
    """Dark shapes in millimetres, x right and y down. A board's sheet is in the board's frame."""

    extent_mm: Float64[Array, "2 2"]
    """First and last printed corner (x, y). The white border is outside."""
    rectangles: Float64[Array, "n 4"] = field(default_factory=lambda: _none(4))
    """x, y, width and height, mm. No two overlap."""
    discs: Float64[Array, "k 3"] = field(default_factory=lambda: _none(3))
    """x and y of the centre, and radius, mm."""
    cut_at_sides: bool = False
    """Whether the left and right edges are marked for cutting."""

    def is_dark(self, places_mm: Float64[Array, "n 2"]) -> Bool[Array, " n"]:
        """Tell which places (x, y) of the paper are ink."""
        x, y = places_mm[:, 0], places_mm[:, 1]
        dark: Bool[Array, " n"] = np.zeros(len(places_mm), bool)
        for left, top, width, height in self.rectangles:
            dark |= (x >= left) & (x <= left + width) & (y >= top) & (y <= top + height)
        for centre_x, centre_y, radius in self.discs:
            dark |= np.hypot(x - centre_x, y - centre_y) <= radius
        return dark


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pattern:
    """A regular pattern on a board, drawn with exact edges. The simulation's kernel draws it."""

    grid: Literal["squares", "circles", "staggered"]
    """Squares from the frame's origin. Or circles, from a centre there, with every second row shifted if staggered."""
    count: tuple[int, int]
    """Columns and rows."""
    pitch_mm: float
    """Side of a square. Distance of neighbouring circles. If staggered, of rows, and half the distance in a row."""
    mark_mm: float
    """Side of a marker in the middle of its square, or radius of a circle."""
    cells: UInt8[Array, "rows columns c c"]
    """Content of each square: [j, i, 0, 0] is `DARK`, `WHITE` or `MARKER`. A marker's cells start at [1, 1], 0 for
    black. Empty (0, 0, 1, 1) for circles."""

    def rectangles(self) -> Float64[Array, "n 4"]:
        """Dark squares and dark marker cells: x, y, width and height, mm."""
        side, margin = self.pitch_mm, (self.pitch_mm - self.mark_mm) / 2
        dark: list[tuple[float, float, float, float]] = []
        for row, line in enumerate(self.cells):
            for column, cells in enumerate(line):
                if cells[0, 0] == DARK:
                    dark.append((column * side, row * side, side, side))
                elif cells[0, 0] == MARKER:
                    bits = cells[1:, 1:]
                    cell = self.mark_mm / len(bits)
                    left, top = column * side + margin, row * side + margin
                    dark += [(left + j * cell, top + i * cell, cell, cell) for i, j in np.argwhere(bits == 0)]
        return np.array(dark, dtype=np.float64).reshape(-1, 4)
