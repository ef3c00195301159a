"""The dotted cylinder: rows and columns of square dots, a label beyond the last row of each column."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from mammometry.base.errors import SettingsError
from mammometry.calibration.targets.sheet import ConvexBody, PrintedSheet, TargetHits
from mammometry.calibration.targets.target import TARGETS, Target, require_grid, require_measured, require_positive
from mammometry.geometry.arrays import Array, Bool, Float64, read_only

_LEAST_DOTS = 3
"""Fewest rows and columns: two columns would not show the curvature."""
_GIRTH_SLACK = 1e-3
"""Share by which the columns may exceed the circumference, since the radius is rounded."""
_CLOSING_PITCH = 1e-2
"""Largest gap between last and first column of a closed cylinder, as a share of a pitch."""


@TARGETS.add("dotted-cylinder")
@dataclass(frozen=True, slots=True, kw_only=True)
class DottedCylinderTarget(Target):
    """A surveyed cylinder covered with dots.

    Frame: z along the axis towards the labelled end, which is up; z = 0 at row 0, the row farthest from the labels;
    column 0 at +x; columns count counterclockwise seen from above, which is to the right in an upright image. Ids are
    ``row · columns + column``.

    Raises:
        ValueError: too few dots, a size that is not positive, or columns that overlap around the cylinder.
    """

    is_surveyed: ClassVar[bool] = True
    size_key: ClassVar[str] = "radius_mm"

    dots: tuple[int, int]
    """Rows along the axis, and all columns around it."""
    radius_mm: float
    """Radius of the printed surface, mm."""
    row_pitch_mm: float
    """Distance between neighbouring rows along the axis, mm."""
    column_pitch_mm: float
    """Distance between neighbouring columns along the arc, mm."""
    dot_mm: float | None = None
    """Side of a dot, mm. If not given it is measured in the images."""
    scale_std: float | None = None
    """Relative standard uncertainty of all lengths, from the survey. None: unknown."""

    def __post_init__(self) -> None:
        require_grid("dots", self.dots, _LEAST_DOTS)
        require_positive(radius_mm=self.radius_mm, row_pitch_mm=self.row_pitch_mm, column_pitch_mm=self.column_pitch_mm)
        if self.dot_mm is not None and not 0 < self.dot_mm < min(self.row_pitch_mm, self.column_pitch_mm):
            raise ValueError(f"dot_mm must be between 0 and the smaller pitch, found {self.dot_mm}")
        around_mm = self.dots[1] * self.column_pitch_mm
        girth_mm = 2 * math.pi * self.radius_mm
        if around_mm > girth_mm * (1 + _GIRTH_SLACK):
            raise ValueError(
                f"{self.dots[1]} columns of {self.column_pitch_mm} mm need {around_mm:.1f} mm, but "
                f"the circumference is {girth_mm:.1f} mm"
            )
        require_measured(scale_std=self.scale_std)

    @property
    def closes(self) -> bool:
        """Whether the columns go all the way around, so that the last is next to the first."""
        girth_mm = 2 * math.pi * self.radius_mm
        return abs(self.dots[1] * self.column_pitch_mm - girth_mm) < _CLOSING_PITCH * self.column_pitch_mm

    @property
    def points_target(self) -> Float64[Array, "n 3"]:
        """Dot centres by id, cylinder frame, mm."""
        rows, columns = self.dots
        row, column = (grid.ravel() for grid in np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"))
        return read_only(self.on_surface(column * self.column_pitch_mm, row * self.row_pitch_mm))

    def on_surface(self, arc_mm: Float64[Array, "*n"], height_mm: Float64[Array, "*n"]) -> Float64[Array, "*n 3"]:
        """Points of the printed surface, cylinder frame, mm, from arc length and height, mm."""
        angle_rad = arc_mm / self.radius_mm
        return np.stack(
            [self.radius_mm * np.cos(angle_rad), self.radius_mm * np.sin(angle_rad), np.asarray(height_mm, np.float64)],
            axis=-1,
        )

    def caption(self) -> str:
        """Describe the print in one line."""
        rows, columns = self.dots
        return (
            f"dotted cylinder, {rows} rows every {self.row_pitch_mm:g} mm, {columns} columns every "
            f"{self.column_pitch_mm:g} mm; labels up, wrapped to a radius of {self.radius_mm:g} mm including the paper"
        )

    def sheet(self) -> PrintedSheet:
        """Return the sheet to wrap around the cylinder.

        Raises:
            SettingsError: there are more columns than labels.
        """
        return wrap_sheet(self)

    @property
    def body(self) -> ConvexBody:
        """The closed tube."""
        return CylinderBody(target=self)


_END_ROWS = (1.0, 1.8)
"""Length of the tube beyond its first and last rows of dots, in row pitches, with space for the labels."""
_WHOLE_ROWS = (0.8, 1.5)
"""Part of the tube beyond its first and last rows that must be in the image, in row pitches: the label strip."""
_HULL_POINTS = 48
"""Points on each end's circle. The chords are within 0.3 % of the radius."""
_LABEL_UP = 0.9
"""Centre of a label beyond the last row, in row pitches: the middle of the strip that `find_cylinder` unrolls."""
_LABEL_CELLS = 4
"""Cells along each side of a label: 65 536 different labels."""
_LABEL_SHARE = 0.7
"""Side of a label, in pitches."""
_DOT_SHARE = 0.5
"""Side of a dot whose size is not given, in pitches."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CylinderBody(ConvexBody):
    """A white tube with dots and labels. Its labels are random cells, unlike those on the printed sheet."""

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
        """Whether both ends of every visible column are in the image."""
        rows, columns = self.target.dots
        below, above = _WHOLE_ROWS
        arc = np.tile(np.arange(columns) * self.target.column_pitch_mm, 2)
        height = np.repeat([-below, rows - 1 + above], columns) * self.target.row_pitch_mm
        shown = seen.reshape(self.target.dots).any(axis=0)
        return bool(in_picture(self.target.on_surface(arc, height)[np.tile(shown, 2)]).all())

    def meet(self, origins: Float64[Array, "n 3"], directions: Float64[Array, "n 3"]) -> TargetHits:
        """Intersect rays with the tube's side, or else with one of the white lids."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return self._met(origins, directions)

    def _met(self, origins: Float64[Array, "n 3"], directions: Float64[Array, "n 3"]) -> TargetHits:
        target = self.target
        o, d = origins[:, :2], directions[:, :2]
        a, b = (d * d).sum(axis=1), (o * d).sum(axis=1)
        root = np.sqrt(b * b - a * ((o * o).sum(axis=1) - target.radius_mm**2))  # NaN: the ray misses the cylinder
        points = origins + ((-b - root) / a)[:, None] * directions
        low, high = self._ends_mm
        side = (points[:, 2] >= low) & (points[:, 2] <= high)
        normals = points * np.array([1.0, 1.0, 0.0]) / target.radius_mm
        white = np.where(side, np.where(self._dark(points), 0.0, 1.0), np.nan)
        for height, sign in ((low, -1.0), (high, 1.0)):
            lid = origins + ((height - origins[:, 2]) / directions[:, 2])[:, None] * directions
            on_lid = ~side & (sign * directions[:, 2] < 0) & (np.hypot(lid[:, 0], lid[:, 1]) <= target.radius_mm)
            points[on_lid], normals[on_lid], white[on_lid] = lid[on_lid], [0.0, 0.0, sign], 1.0
        return TargetHits(points=points, normals=normals, white=white)

    @property
    def _ends_mm(self) -> tuple[float, float]:
        """Heights of the tube's ends, mm."""
        below, above = _END_ROWS
        return -below * self.target.row_pitch_mm, (self.target.dots[0] - 1 + above) * self.target.row_pitch_mm

    def _dark(self, points: Float64[Array, "n 3"]) -> Bool[Array, " n"]:
        """Mask of points of the side that are ink: dots and label cells."""
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
        """Mask of points beyond the last row that are ink. Each column has its own random square of cells."""
        columns = self.target.dots[1]
        cells = np.random.default_rng(columns).random((columns, _LABEL_CELLS, _LABEL_CELLS)) < 0.5
        x = np.floor((across / _LABEL_SHARE + 0.5) * _LABEL_CELLS)
        y = np.floor((above - (_LABEL_UP - _LABEL_SHARE / 2)) / _LABEL_SHARE * _LABEL_CELLS)
        inside = (x >= 0) & (y >= 0) & (x < _LABEL_CELLS) & (y < _LABEL_CELLS)
        index = np.where(inside, column, 0).astype(np.int64) % columns
        return inside & cells[index, np.where(inside, y, 0).astype(np.int64), np.where(inside, x, 0).astype(np.int64)]


_SHEET_DOT_SHARE = 0.45
"""Default side of a dot, in pitches."""
_SHEET_LABEL_CELLS = 6
"""Cells along each side of a label."""
_ABOVE_ROWS = 1.5
"""Height of the sheet above the last row, in row pitches: the label strip and a little more."""


def column_labels(columns: int) -> Bool[Array, "c 6 6"]:
    """Cells of the label beyond each column, ``[column, row, cell]``.

    True is dark. They are upright, and are the inner cells of the markers of OpenCV's 6 × 6 dictionary, which differ
    from each other in many cells.

    Raises:
        SettingsError: more columns than there are labels.
    """
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_1000)
    if columns > len(dictionary.bytesList):
        raise SettingsError(
            "target",
            found=f"{columns} columns of dots",
            expected=f"at most {len(dictionary.bytesList)}, since each needs a label",
            remedy="Print fewer columns, or label them by hand",
        )
    return np.stack([np.asarray(dictionary.generateImageMarker(k, 8))[1:-1, 1:-1] < 128 for k in range(columns)])


def wrap_sheet(target: DottedCylinderTarget) -> PrintedSheet:
    """Return the sheet to wrap around a cylinder, mm.

    Its origin is its upper left corner. The sheet is as wide as all columns. Column 0 is the leftmost, row 0 the
    lowest, and the labels are above the last row.

    Raises:
        SettingsError: there are more columns than labels.
    """
    rows, columns = target.dots
    dx, dy = target.column_pitch_mm, target.row_pitch_mm
    side = target.dot_mm if target.dot_mm else _SHEET_DOT_SHARE * min(dx, dy)
    cell = _LABEL_SHARE * min(dx, dy) / _SHEET_LABEL_CELLS
    dark = []
    for column, label in enumerate(column_labels(columns)):
        x = (column + 0.5) * dx
        dark += [(x - side / 2, (rows + 0.5 - row) * dy - side / 2, side, side) for row in range(rows)]
        left, top = x - _SHEET_LABEL_CELLS / 2 * cell, (_ABOVE_ROWS - _LABEL_UP) * dy - _SHEET_LABEL_CELLS / 2 * cell
        dark += [(left + j * cell, top + i * cell, cell, cell) for i, j in np.argwhere(label)]
    return PrintedSheet(
        extent_mm=np.array([[0.0, 0.0], [columns * dx, (rows + _ABOVE_ROWS) * dy]]),
        rectangles=np.array(dark, dtype=np.float64),
        cut_at_sides=True,
    )
