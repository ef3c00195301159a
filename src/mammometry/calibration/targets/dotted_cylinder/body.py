"""The dotted cylinder as a solid: a tube with lids. Rays meet it exactly."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from mammometry.calibration.targets.body import Body, Hits
from mammometry.calibration.targets.kinds.cylinder import DottedCylinderTarget
from mammometry.geometry.arrays import Array, Bool, Float64

_END_ROWS = (1.0, 1.8)
"""Reach of the tube beyond its first and last rows of dots, in row pitches, with room for the labels."""
_WHOLE_ROWS = (0.8, 1.5)
"""Part of the tube beyond its first and last rows that must be in the picture, in row pitches: the labels' strip."""
_HULL_POINTS = 48
"""Points on each end's circle. The chords are within 0.3 % of the radius."""
_LABEL_ROWS = (0.55, 1.25)
"""Strip of labels beyond the last row, in row pitches, inside the strip that `find_cylinder` unrolls."""
_LABEL_CELLS = 4
"""Cells along each side of a label: 65 536 different labels."""
_LABEL_WIDTH = 0.7
"""Width of a label, in column pitches."""
_DOT_SHARE = 0.5
"""Side of a dot whose size is not given, in pitches."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CylinderBody(Body):
    """A white tube with dots and labels. Its labels are random cells, others than on the printed sheet."""

    attitude: ClassVar[Literal["facing", "upright", "any"]] = "upright"

    target: DottedCylinderTarget

    @property
    def normals_target(self) -> Float64[Array, "n 3"]:
        """Away from the axis."""
        return np.asarray(self.target.points_target * np.array([1.0, 1.0, 0.0]) / self.target.radius_mm)

    @property
    def middle_mm(self) -> Float64[Array, 3]:
        """Middle of the dots' extent, mm."""
        points = self.target.points_target
        return 0.5 * (points.min(axis=0) + points.max(axis=0))

    @property
    def hull_target(self) -> Float64[Array, "n 3"]:
        """Both ends' circles, mm."""
        arc = np.tile(np.linspace(0.0, 2 * math.pi * self.target.radius_mm, _HULL_POINTS), 2)
        return self.target.on_surface(arc, np.repeat(self._ends_mm, _HULL_POINTS))

    def is_whole(
        self, seen: Bool[Array, " n"], in_picture: Callable[[Float64[Array, "m 3"]], Bool[Array, " m"]]
    ) -> bool:
        """Whether both ends of every visible column are in the picture."""
        rows, columns = self.target.dots
        below, above = _WHOLE_ROWS
        arc = np.tile(np.arange(columns) * self.target.column_pitch_mm, 2)
        height = np.repeat([-below, rows - 1 + above], columns) * self.target.row_pitch_mm
        shown = seen.reshape(self.target.dots).any(axis=0)
        return bool(in_picture(self.target.on_surface(arc, height)[np.tile(shown, 2)]).all())

    def meet(self, origins: Float64[Array, "n 3"], directions: Float64[Array, "n 3"]) -> Hits:
        """Meet the tube's side, else one of the white lids."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return self._met(origins, directions)

    def _met(self, origins: Float64[Array, "n 3"], directions: Float64[Array, "n 3"]) -> Hits:
        target = self.target
        o, d = origins[:, :2], directions[:, :2]
        a, b = (d * d).sum(axis=1), (o * d).sum(axis=1)
        root = np.sqrt(b * b - a * ((o * o).sum(axis=1) - target.radius_mm**2))  # NaN: beside the cylinder
        points = origins + ((-b - root) / a)[:, None] * directions
        low, high = self._ends_mm
        side = (points[:, 2] >= low) & (points[:, 2] <= high)
        normals = points * np.array([1.0, 1.0, 0.0]) / target.radius_mm
        white = np.where(side, np.where(self._dark(points), 0.0, 1.0), np.nan)
        for height, sign in ((low, -1.0), (high, 1.0)):
            lid = origins + ((height - origins[:, 2]) / directions[:, 2])[:, None] * directions
            on_lid = ~side & (sign * directions[:, 2] < 0) & (np.hypot(lid[:, 0], lid[:, 1]) <= target.radius_mm)
            points[on_lid], normals[on_lid], white[on_lid] = lid[on_lid], [0.0, 0.0, sign], 1.0
        return Hits(points=points, normals=normals, white=white)

    @property
    def _ends_mm(self) -> tuple[float, float]:
        """Heights of the tube's ends, mm."""
        below, above = _END_ROWS
        return -below * self.target.row_pitch_mm, (self.target.dots[0] - 1 + above) * self.target.row_pitch_mm

    def _dark(self, points: Float64[Array, "n 3"]) -> Bool[Array, " n"]:
        """Whether points of the side are ink: dots and label cells."""
        target = self.target
        arc = np.arctan2(points[:, 1], points[:, 0]) * target.radius_mm / target.column_pitch_mm
        column = np.round(arc)
        across, row = arc - column, points[:, 2] / target.row_pitch_mm
        near = np.clip(np.round(row), 0, target.dots[0] - 1)
        half = 0.5 * (target.dot_mm or _DOT_SHARE * min(target.row_pitch_mm, target.column_pitch_mm))
        dark = np.abs(across) * target.column_pitch_mm <= half
        dark &= np.abs(row - near) * target.row_pitch_mm <= half
        dark |= self._label_dark(column, across, row - (target.dots[0] - 1))
        return np.asarray(dark)

    def _label_dark(self, column: Array, across: Array, above: Array) -> Array:
        """Whether places beyond the last row are ink. Each column has its own random square of cells."""
        columns = self.target.dots[1]
        cells = np.random.default_rng(columns).random((columns, _LABEL_CELLS, _LABEL_CELLS)) < 0.5
        low, high = _LABEL_ROWS
        x = np.floor((across / _LABEL_WIDTH + 0.5) * _LABEL_CELLS)
        y = np.floor((above - low) / (high - low) * _LABEL_CELLS)
        inside = (x >= 0) & (y >= 0) & (x < _LABEL_CELLS) & (y < _LABEL_CELLS)
        index = np.where(inside, column, 0).astype(np.int64) % columns
        return inside & cells[index, np.where(inside, y, 0).astype(np.int64), np.where(inside, x, 0).astype(np.int64)]
