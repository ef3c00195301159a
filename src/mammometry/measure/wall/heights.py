"""Walls as heights over a chart, and the charts.

The boundary is not exactly at such a height. `through` spreads the misfit harmonically inwards, so that every wall
meets the skin exactly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator, RBFInterpolator

from mammometry.base.errors import MeasureError
from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Float64
from mammometry.measure.boundary.cast_base import frame_towards
from mammometry.measure.solid.cut import OpenPart
from mammometry.measure.solid.patch import Closed, Patch, harmonic, sew
from mammometry.measure.solid.untangle import signed_area_mm2
from mammometry.measure.trunk.thorax import Trunk

Height: TypeAlias = Callable[[Float64[Array, "n 2"]], Float64[Array, " n"]]
"""Height over a chart at flat coordinates, mm."""

SPACING_MM = 2.5
"""Spacing of a wall's inner points, mm. It reproduces Scherk's surface over 100 mm to 0.15 mm
(tests/unit/measure/test_walls.py). Not critical."""
_PLATE_KNOTS = 240  # most knots of a thin plate; not critical
_SAME_PLACE_DIGITS = 6  # decimals of mm to which knots are compared: coincident knots make the spline singular
_CELL_MM = 4.0  # side of the cells over which scattered points are averaged; not critical
_LEAST_COVERED = 0.95  # least share of the base that a layer must cover; not critical


@runtime_checkable
class Chart(Protocol):
    """Coordinates in which a wall is a height over a plane region."""

    def flatten(self, points_world: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """Flat coordinates (two) and height (the third) of world points, mm."""
        ...

    def world(self, places: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """World points, mm (the inverse)."""
        ...


@value(eq=False)
class PlaneChart:
    """Heights over a plane."""

    origin: Float64[Array, 3]
    """A point on it, mm, world frame."""
    frame: Float64[Array, "3 3"]
    """Rows: two directions in the plane and its normal, towards the breast. World frame."""

    def flatten(self, points_world: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """Coordinates in the plane and height over it, mm."""
        return (points_world - self.origin) @ self.frame.T

    def world(self, places: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """World points, mm."""
        return self.origin + places @ self.frame


def best_plane(part: OpenPart) -> PlaneChart:
    """Least-squares plane through the opening, whose loops run counter-clockwise about its normal."""
    points = part.mesh.vertices[np.concatenate(part.loops)]
    origin = points.mean(axis=0)
    frame = frame_towards(np.linalg.svd(points - origin, full_matrices=False)[2][2])
    if sum(signed_area_mm2((part.mesh.vertices[loop] - origin) @ frame[:2].T) for loop in part.loops) < 0:
        frame = frame_towards(-frame[2])
    return PlaneChart(origin=origin, frame=frame)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrunkChart:
    """(half width × θ, y) and the distance from the trunk's axis."""

    trunk: Trunk

    def flatten(self, points_world: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """Flat coordinates and distance from the axis, mm."""
        return self.trunk.cylindrical(points_world)

    def world(self, places: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """World points, mm."""
        return self.trunk.world(places)


def through(part: OpenPart, chart: Chart, height: Height | None = None, *, subject: str) -> Closed:
    """Skin closed by a height over a chart, plus the misfit on the opening, harmonic inside.

    Raises:
        MeasureError: the flattened opening crosses itself, or the height is not known everywhere inside it.
    """
    loops = tuple(chart.flatten(part.mesh.vertices[loop]) for loop in part.loops)

    def lift(patch: Patch) -> Float64[Array, "k 3"]:
        smooth = np.zeros(len(patch.points)) if height is None else height(patch.points)
        rise = smooth + harmonic(patch, np.concatenate(loops)[:, 2:] - smooth[: patch.n_loop, None])[:, 0]
        return chart.world(np.concatenate([patch.points, rise[:, None]], axis=1)[patch.n_loop :])

    return sew(part, tuple(loop[:, :2] for loop in loops), lift, spacing_mm=SPACING_MM, subject=subject)


def plate(places: Float64[Array, "n 3"]) -> Height:
    """Thin-plate spline through evenly chosen points."""
    knots = places[np.unique(np.linspace(0, len(places) - 1, min(_PLATE_KNOTS, len(places))).astype(int))]
    knots = knots[np.sort(np.unique(knots[:, :2].round(_SAME_PLACE_DIGITS), axis=0, return_index=True)[1])]
    spline = RBFInterpolator(knots[:, :2], knots[:, 2], kernel="thin_plate_spline", degree=1)

    def height(flat: Float64[Array, "n 2"]) -> Float64[Array, " n"]:
        found: Float64[Array, " n"] = spline(flat)
        return found

    return height


def layer(places: Float64[Array, "n 3"], subject: str) -> Height:
    """Height interpolated linearly between the means of 4 mm cells of scattered points.

    Raises:
        MeasureError: the returned function is called with too few positions between the scattered points.
    """
    cell = np.round(places[:, :2] / _CELL_MM).astype(np.int64)
    _, number = np.unique(cell, axis=0, return_inverse=True)
    number = number.ravel()
    count = np.bincount(number)
    means = np.stack([np.bincount(number, places[:, axis]) / count for axis in range(3)], axis=1)

    def height(flat: Float64[Array, "n 2"]) -> Float64[Array, " n"]:
        found: Float64[Array, " n"] = np.full(len(flat), np.nan)
        if len(means) > 3:
            found = LinearNDInterpolator(means[:, :2], means[:, 2])(flat)
        known = np.isfinite(found)
        if known.mean() < _LEAST_COVERED:
            raise MeasureError(
                subject,
                found=f"a surface that covers {100 * known.mean():.0f} % of the breast's base",
                expected=f"at least {100 * _LEAST_COVERED:.0f} %",
                remedy="Check that it is in the session's world frame, in mm, or choose --set measure.wall=default",
                mesh_remedy="Check that it is in the mesh's frame, in its unit, or choose --set measure.wall=default",
            )
        found[~known] = NearestNDInterpolator(flat[known], found[known])(flat[~known])
        return found

    return height
