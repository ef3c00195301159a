"""A rigid object with surveyed points, marked by round dots."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from mammometry.calibration.targets.sheet import ConvexBody, TargetHits
from mammometry.calibration.targets.target import TARGETS, Target, require_measured, require_positive
from mammometry.geometry.arrays import Array, Bool, Float64, read_only

_LEAST_POINTS = 4
"""Fewest points. Three have up to four poses in one image; a fourth makes the pose unique (Fischler and Bolles
1981)."""


@TARGETS.add("points")
@dataclass(frozen=True, slots=True, kw_only=True)
class PointsTarget(Target):
    """Surveyed points in the object's own frame, which is the world. Ids are indices in the list.

    Raises:
        ValueError: fewer than four points, or a coordinate that is not finite.
    """

    is_surveyed: ClassVar[bool] = True
    size_key: ClassVar[str] = "points_mm"

    points_mm: tuple[tuple[float, float, float], ...]
    """Surveyed coordinates, mm."""
    dot_diameter_mm: float | None = None
    """Diameter of the points' round dots, mm, if they have any."""
    scale_std: float | None = None
    """Relative standard uncertainty of all lengths, from the survey. None: unknown."""

    def __post_init__(self) -> None:
        if len(self.points_mm) < _LEAST_POINTS:
            raise ValueError(f"points_mm needs at least {_LEAST_POINTS} points, found {len(self.points_mm)}")
        if not np.isfinite(np.asarray(self.points_mm)).all():
            raise ValueError("points_mm has a coordinate that is not a finite number")
        if self.dot_diameter_mm is not None:
            require_positive(dot_diameter_mm=self.dot_diameter_mm)
        require_measured(scale_std=self.scale_std)

    @property
    def points_target(self) -> Float64[Array, "n 3"]:
        """Surveyed points by id, mm."""
        return read_only(np.array(self.points_mm, dtype=np.float64))

    @property
    def body(self) -> DottedBox:
        """A box around the origin: the only such object in the simulation."""
        return DottedBox(target=self)


@dataclass(frozen=True, slots=True, kw_only=True)
class DottedBox(ConvexBody):
    """A white cube around the origin with round dots on its faces."""

    attitude: ClassVar[Literal["facing", "upright", "any"]] = "any"
    comes_measured: ClassVar[bool] = True

    target: PointsTarget

    @property
    def normals_target(self) -> Float64[Array, "n 3"]:
        """Normal of the face on which each point lies."""
        points = self.target.points_target
        normals = np.zeros_like(points)
        axis = np.abs(points).argmax(axis=1)
        rows = np.arange(len(points))
        normals[rows, axis] = np.sign(points[rows, axis])
        return normals

    @property
    def middle_mm(self) -> Float64[Array, 3]:
        """Middle of the points' extent, mm."""
        points = self.target.points_target
        return 0.5 * (points.min(axis=0) + points.max(axis=0))

    @property
    def hull_target(self) -> Float64[Array, "n 3"]:
        """The cube's corners, mm."""
        return self._half_mm * np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])

    def is_whole(
        self, seen: Bool[Array, " n"], in_picture: Callable[[Float64[Array, "m 3"]], Bool[Array, " m"]]
    ) -> bool:
        """True: any part of the list is enough."""
        return True

    def meet(self, origins: Float64[Array, "n 3"], directions: Float64[Array, "n 3"]) -> TargetHits:
        """Meet the cube's faces by the slab method (Kay and Kajiya 1986)."""
        from scipy.spatial import cKDTree

        dots, half = self.target.points_target, self._half_mm
        with np.errstate(divide="ignore", invalid="ignore"):
            enter = (-np.sign(directions) * half - origins) / directions
            leave = (np.sign(directions) * half - origins) / directions
        axis = np.argmax(enter, axis=1)
        rows = np.arange(len(origins))
        t = enter[rows, axis]
        points = origins + t[:, None] * directions
        normals = np.zeros_like(points)
        normals[rows, axis] = -np.sign(directions[rows, axis])
        white = np.where((t > 0) & (t <= leave.min(axis=1)), 1.0, np.nan)
        radius = 0.5 * (self.target.dot_diameter_mm or 0.0)
        hit = np.flatnonzero(np.isfinite(white))
        white[hit[cKDTree(dots).query(points[hit])[0] <= radius]] = 0.0
        return TargetHits(points=points, normals=normals, white=white)

    @property
    def _half_mm(self) -> float:
        """Half the cube's side, mm: the dots are on its faces."""
        return float(np.abs(self.target.points_target).max())
