"""The dotted cylinder: rows and columns of square dots, with labels.

A label is beyond the last row of each column.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from mammometry.base.photograph import Photograph
from mammometry.calibration.features.found_points import Cause, FoundPoints
from mammometry.calibration.targets.body import Body
from mammometry.calibration.targets.registry import TARGETS
from mammometry.calibration.targets.sheet import Sheet
from mammometry.calibration.targets.target import Target, require_grid, require_measured, require_positive
from mammometry.geometry.arrays import Array, Float64, read_only

_LEAST_DOTS = 3
"""Rows and columns: two columns would not show the curvature."""
_GIRTH_SLACK = 1e-3
"""Share by which the columns may exceed the girth, since the radius is rounded."""
_CLOSING_PITCH = 1e-2
"""The columns close if they fill the girth to this share of a pitch."""


@TARGETS.add("dotted-cylinder")
@dataclass(frozen=True, slots=True, kw_only=True)
class DottedCylinderTarget(Target):
    """A cylinder covered with dots, surveyed.

    Frame: z along the axis towards the labelled end, which is up; z = 0 at row 0, the row farthest from the labels;
    column 0 at +x; columns count counterclockwise seen from above, which is to the right in a picture taken upright.
    Ids are ``row · columns + column``.

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
    """Distance of neighbouring rows along the axis, mm."""
    column_pitch_mm: float
    """Distance of neighbouring columns along the arc, mm."""
    dot_mm: float | None = None
    """Side of a dot, mm. Measured in the pictures where not given."""
    scale_std: float | None = None
    """Relative standard uncertainty of all lengths, from the survey. None: not known."""

    def __post_init__(self) -> None:
        require_grid("dots", self.dots, _LEAST_DOTS)
        require_positive(radius_mm=self.radius_mm, row_pitch_mm=self.row_pitch_mm, column_pitch_mm=self.column_pitch_mm)
        if self.dot_mm is not None and not 0 < self.dot_mm < min(self.row_pitch_mm, self.column_pitch_mm):
            raise ValueError(f"dot_mm must lie between 0 and the smaller pitch, found {self.dot_mm}")
        around_mm = self.dots[1] * self.column_pitch_mm
        girth_mm = 2 * math.pi * self.radius_mm
        if around_mm > girth_mm * (1 + _GIRTH_SLACK):
            raise ValueError(
                f"{self.dots[1]} columns of {self.column_pitch_mm} mm need {around_mm:.1f} mm, "
                f"the girth is {girth_mm:.1f} mm"
            )
        require_measured(scale_std=self.scale_std)

    @property
    def closes(self) -> bool:
        """Whether the columns go all the way round. Then the last is the first one's neighbour."""
        girth_mm = 2 * math.pi * self.radius_mm
        return abs(self.dots[1] * self.column_pitch_mm - girth_mm) < _CLOSING_PITCH * self.column_pitch_mm

    @property
    def points_target(self) -> Float64[Array, "n 3"]:
        """Dot centres by id, cylinder frame, mm."""
        rows, columns = self.dots
        row, column = (grid.ravel() for grid in np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"))
        return read_only(self.on_surface(column * self.column_pitch_mm, row * self.row_pitch_mm))

    def on_surface(self, arc_mm: Float64[Array, "*n"], height_mm: Float64[Array, "*n"]) -> Float64[Array, "*n 3"]:
        """Points of the printed surface, cylinder frame, mm.

        Unrolled coordinates are along the arc and along the axis.
        """
        angle_rad = arc_mm / self.radius_mm
        return np.stack(
            [self.radius_mm * np.cos(angle_rad), self.radius_mm * np.sin(angle_rad), np.asarray(height_mm, np.float64)],
            axis=-1,
        )

    def find(
        self, photograph: Photograph, *, search_width_px: int, window_squares: float
    ) -> FoundPoints | Cause | None:
        """Find the dots, their columns counted from the first one seen. See `find_cylinder`."""
        from mammometry.calibration.targets.dotted_cylinder.find import find_cylinder

        return find_cylinder(photograph, self, search_width_px=search_width_px)

    def number_alike(self, found: Mapping[str, FoundPoints]) -> Mapping[str, FoundPoints]:
        """Number the columns of all photographs alike, by their labels.

        Raises:
            CalibrationError: a photograph's labels agree with no other's, or there are too many columns.
        """
        from mammometry.calibration.targets.dotted_cylinder.labels import numbered_alike

        return numbered_alike(found)

    def caption(self) -> str:
        """Describe the print in one line."""
        rows, columns = self.dots
        return (
            f"dotted cylinder, {rows} rows every {self.row_pitch_mm:g} mm, {columns} columns every "
            f"{self.column_pitch_mm:g} mm; labels up, round a radius of {self.radius_mm:g} mm over the paper"
        )

    def sheet(self) -> Sheet:
        """Return the sheet to wrap round the cylinder.

        Raises:
            SettingsError: there are more columns than labels.
        """
        from mammometry.calibration.targets.dotted_cylinder.strips import wrap_sheet

        return wrap_sheet(self)

    @property
    def body(self) -> Body:
        """The closed tube."""
        from mammometry.calibration.targets.dotted_cylinder.body import CylinderBody

        return CylinderBody(target=self)
