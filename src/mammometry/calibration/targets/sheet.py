"""The printed sheet, as dark shapes on white paper, and the target as a solid for the simulation.

Independent of cameras and light. A ray is an origin and a direction in the target's frame, mm.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from mammometry.geometry.arrays import Array, Bool, Float64, UInt8

DARK, WHITE, MARKER = 0, 1, 2
"""Content of a square of a `SheetPattern`."""


def _none(columns: int) -> np.ndarray:
    return np.zeros((0, columns))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PrintedSheet:
    """Dark shapes in millimetres, x right and y down. A board's sheet is in the board's frame."""

    extent_mm: Float64[Array, "2 2"]
    """First and last printed corner (x, y). The white border is outside."""
    rectangles: Float64[Array, "n 4"] = field(default_factory=lambda: _none(4))
    """x, y, width and height, mm. Without overlaps."""
    discs: Float64[Array, "k 3"] = field(default_factory=lambda: _none(3))
    """x and y of the centre, and radius, mm."""
    cut_at_sides: bool = False
    """Whether the left and right edges are marked for cutting."""

    def is_dark(self, places_mm: Float64[Array, "n 2"]) -> Bool[Array, " n"]:
        """Mask of the positions (x, y) of the paper that are ink."""
        x, y = places_mm[:, 0], places_mm[:, 1]
        dark: Bool[Array, " n"] = np.zeros(len(places_mm), bool)
        for left, top, width, height in self.rectangles:
            dark |= (x >= left) & (x <= left + width) & (y >= top) & (y <= top + height)
        for centre_x, centre_y, radius in self.discs:
            dark |= np.hypot(x - centre_x, y - centre_y) <= radius
        return dark


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SheetPattern:
    """A regular pattern on a board. The simulation's kernel draws it with exact edges."""

    grid: Literal["squares", "circles", "staggered"]
    """Squares from the frame's origin, or circles with the first one centred there. Staggered: every second row
    shifted."""
    count: tuple[int, int]
    """Columns and rows."""
    pitch_mm: float
    """Side of a square, or distance between neighbouring circles. If staggered: between rows, and half of it in a
    row."""
    mark_mm: float
    """Side of a marker in the centre of its square, or radius of a circle."""
    cells: UInt8[Array, "rows columns c c"]
    """Content of each square: [j, i, 0, 0] is `DARK`, `WHITE` or `MARKER`. A marker's cells start at [1, 1], with 0 for
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TargetHits:
    """First intersections of rays with a target, target frame."""

    points: Float64[Array, "n 3"]
    normals: Float64[Array, "n 3"]
    """Outward unit normals of the surface there."""
    white: Float64[Array, " n"]
    """1 on paper, 0 on ink, NaN if the ray misses the target."""


class ConvexBody(ABC):
    """A convex body with the target's points on its surface."""

    __slots__ = ()

    attitude: ClassVar[Literal["facing", "upright", "any"]]
    """Placement: printed side towards the cameras, z axis up in all images, or rotated at random."""
    comes_measured: ClassVar[bool] = False
    """Whether each virtual photograph has a table of its image points."""

    @property
    @abstractmethod
    def normals_target(self) -> Float64[Array, "n 3"]:
        """Outward unit normals of the surface at the target's points."""

    @property
    @abstractmethod
    def middle_mm(self) -> Float64[Array, 3]:
        """Centre of the target, mm, which is placed at the centre of the rig."""

    @property
    @abstractmethod
    def hull_target(self) -> Float64[Array, "n 3"]:
        """Points whose images enclose the target's, mm."""

    @property
    def looks_alike_turned(self) -> bool:
        """Whether half a turn gives the same image, so that its numbering is ambiguous."""
        return False

    @property
    def pattern(self) -> SheetPattern | None:
        """The regular pattern of a flat body. Otherwise None."""
        return None

    @abstractmethod
    def is_whole(
        self, seen: Bool[Array, " n"], in_picture: Callable[[Float64[Array, "m 3"]], Bool[Array, " m"]]
    ) -> bool:
        """Whether enough of the target is in the image to identify points.

        Args:
            seen: mask of the target's points that are in the image and face the camera.
            in_picture: returns the mask of points, target frame, that are in the image.
        """

    @abstractmethod
    def meet(self, origins: Float64[Array, "n 3"], directions: Float64[Array, "n 3"]) -> TargetHits:
        """Find the rays' first intersections with the surface, and what is printed there."""
