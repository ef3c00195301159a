"""Boards of dark circles, in a square or a staggered grid."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import ClassVar

import numpy as np

from mammometry.calibration.targets.board import Board
from mammometry.calibration.targets.sheet import PrintedSheet, SheetPattern
from mammometry.calibration.targets.target import TARGETS, require_grid, require_positive
from mammometry.geometry.arrays import Array, Float64, read_only

_LEAST_CIRCLES = 2
"""Fewest circles in a row, and rows."""


@TARGETS.add("circles")
@dataclass(frozen=True, slots=True, kw_only=True)
class CirclesTarget(Board):
    """A board of dark circles on white.

    Origin at the first circle's centre, x right, y down, z into the board; ids row by row.

    Raises:
        ValueError: fewer than 2 × 2 circles, or circles that would touch.
    """

    size_key: ClassVar[str] = "pitch_mm"

    grid: tuple[int, int]
    """Circles in a row, and rows."""
    pitch_mm: float
    """Symmetric: distance between neighbours, mm. Asymmetric (as in OpenCV): distance between rows, half of that in a
    row."""
    diameter_mm: float
    """Diameter of a circle, mm."""
    asymmetric: bool = False
    """Whether every second row is shifted by half a step."""

    def __post_init__(self) -> None:
        Board.__post_init__(self)
        require_grid("grid", self.grid, _LEAST_CIRCLES)
        require_positive(pitch_mm=self.pitch_mm, diameter_mm=self.diameter_mm)
        if self.diameter_mm >= self.nearest_mm:
            raise ValueError(
                f"circles with diameter_mm {self.diameter_mm} touch at a distance of {self.nearest_mm:.3f} mm"
            )

    @property
    def nearest_mm(self) -> float:
        """Distance from a circle's centre to the nearest other one, mm."""
        return self.pitch_mm * (math.sqrt(2.0) if self.asymmetric else 1.0)

    @property
    def points_target(self) -> Float64[Array, "n 3"]:
        """Circle centres by id, board frame, mm."""
        column, row = (grid.ravel().astype(np.float64) for grid in np.meshgrid(*map(np.arange, self.grid)))
        x = 2.0 * column + row % 2 if self.asymmetric else column
        return read_only(np.stack([x, row, np.zeros_like(x)], axis=1) * self.pitch_mm)

    @property
    def edge_mm(self) -> float:
        """Length of the pattern along x, mm, from the first column's centres to the last one's."""
        return float(np.ptp(self.points_target[:, 0]))

    @property
    def extent_mm(self) -> Float64[Array, "2 2"]:
        """Corners of the rectangle around all circles, mm."""
        points = self.points_target[:, :2]
        return np.array([points.min(axis=0), points.max(axis=0)]) + self.diameter_mm * np.array([[-0.5], [0.5]])

    @property
    def looks_alike_turned(self) -> bool:
        """Whether half a turn gives the same grid: if square, or staggered with an even number of rows."""
        return not self.asymmetric or self.grid[1] % 2 == 0

    def mistaken(self) -> Iterator[tuple[str, CirclesTarget]]:
        """Yield boards with rows and columns swapped, or one more or less."""
        columns, rows = self.grid
        counts = [(rows, columns), *((columns + a, rows + b) for a, b in product((1, 0, -1), repeat=2) if a or b)]
        for grid in counts:
            if min(grid) >= _LEAST_CIRCLES:
                yield f"grid = [{grid[0]}, {grid[1]}]", replace(self, grid=grid)

    @property
    def pattern(self) -> SheetPattern:
        """The grid of circles."""
        return SheetPattern(
            grid="staggered" if self.asymmetric else "circles",
            count=self.grid,
            pitch_mm=self.pitch_mm,
            mark_mm=0.5 * self.diameter_mm,
            cells=np.zeros((0, 0, 1, 1), dtype=np.uint8),
        )

    def sheet(self) -> PrintedSheet:
        """Return the discs."""
        centres = self.points_target[:, :2]
        discs = np.column_stack([centres, np.full(len(centres), self.diameter_mm / 2)])
        return PrintedSheet(extent_mm=self.extent_mm, discs=discs)

    def caption(self) -> str:
        """Describe the print in one line."""
        grid = f"{'staggered ' if self.asymmetric else ''}{self.grid[0]} × {self.grid[1]}"
        return f"circles, {grid}, pitch {self.pitch_mm:g} mm, diameter {self.diameter_mm:g} mm"
