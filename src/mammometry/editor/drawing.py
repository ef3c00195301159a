"""Drawn curves, projected onto the surface and measured immediately.

The surface is simplified, so that a volume takes less than a second. The final number comes from ``mammometry
measure``, which measures the saved curve on the full mesh.

An existing curve is edited by handles, a few of its own points. If a handle is moved, the curve is redrawn up to the
next handle on either side. All other points remain unchanged.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import get_args

import numpy as np
from scipy.interpolate import CubicSpline

from mammometry.base.errors import MeasureError
from mammometry.geometry.arrays import Array, Float64, Int64
from mammometry.geometry.nearest import closest_on_mesh
from mammometry.measure.boundary.boundary import DRAWN_RIM_SIGMA_MM, Boundary, BreastName, given_boundary
from mammometry.measure.boundary.trace import check_curve, crossing_points
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.volume import volumes
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.report.models import thinned
from mammometry.surface.repair.repair import RepairedSurface

TRIANGLES = 120_000  # of the simplified surface: a volume then takes less than a second
_STEP_MM = 2.0  # spacing of a drawn curve's points: finer than the path along which it is cut, 3 mm
_HANDLE_MM = 18.0  # spacing of the handles; affects only the page
_FEWEST_HANDLES = 8  # fewest handles of a small curve; affects only the page
_TANGENT_MM = 5.0  # length over which a curve's direction is averaged where a new piece joins it: two to three points
_DIGITS = 4  # decimals of new points in mm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LiveVolume:
    """Volume of one breast while it is drawn."""

    curve_world: Float64[Array, "n 3"]
    """The closed curve on the surface, mm, world frame."""
    volume_cc: float | None
    """None if the curve does not enclose a solid; `problem` is the reason."""
    interval_cc: tuple[float, float] | None
    problem: str | None
    crossings_world: Float64[Array, "k 3"] = field(default_factory=lambda: np.empty((0, 3)))
    """Points at which the curve crosses itself, mm, world frame; there is then no volume."""
    preliminary: bool = True
    """Whether it is from the simplified surface, not from the full measurement."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Handle:
    """A point of a boundary that can be dragged."""

    point_world: Float64[Array, 3]
    """Position, mm, world frame."""
    at: int | None = None
    """Index in the original curve if the handle was not moved, else None."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrawingBoard:
    """The surface for drawing."""

    surface: RepairedSurface
    """Simplified; world frame, mm."""
    frame: Float64[Array, "3 3"]
    settings: MeasureSettings

    def measure(
        self,
        curves_world: Mapping[str, Float64[Array, "n 3"]],
        automatic: Mapping[str, Boundary] | None = None,
        wanted: Collection[str] | None = None,
    ) -> dict[str, LiveVolume]:
        """Volumes inside closed curves.

        Args:
            curves_world: breast → its boundary, mm, world frame.
            automatic: boundaries that were found automatically. A curve equal to one of them is measured as automatic.
            wanted: breasts to measure; None: all.
        """
        kept = {name: boundary for name, boundary in (automatic or {}).items() if name in curves_world}
        drawn: dict[str, Boundary] = {}
        problems: dict[str, str] = {}
        for name, curve in curves_world.items():
            if name in kept and np.array_equal(kept[name].points_world, curve):
                drawn[name] = kept[name]
                continue
            try:
                drawn[name] = given_boundary(_breast(name), curve, self.surface, rim_sigma_mm=DRAWN_RIM_SIGMA_MM)
            except MeasureError as error:
                problems[name] = str(error)
        live = {}
        for name, curve in curves_world.items():
            if wanted is not None and name not in wanted:
                continue
            measured = None
            if name in drawn:
                try:
                    measured = self._measured(drawn[name], tuple(drawn.values()))
                except MeasureError as error:
                    problems[name] = str(error)
            live[name] = LiveVolume(
                curve_world=curve,
                volume_cc=None if measured is None else measured.volume_cc,
                interval_cc=None if measured is None else measured.interval_cc,
                problem=problems.get(name),
                crossings_world=crossing_points(curve),
            )
        return live

    def check(self, name: str, curve_world: Float64[Array, "n 3"]) -> None:
        """Raise a MeasureError if a curve is open, crosses itself or is off the surface."""
        check_curve(name, curve_world, self.surface.mesh)

    def laid(self, points_world: Float64[Array, "k 3"]) -> Float64[Array, "n 3"]:
        """Smooth closed curve through points, on the surface: a periodic cubic spline over the arc length."""
        closed = np.concatenate([points_world, points_world[:1]])
        along = _along(closed)
        at = np.linspace(0.0, along[-1], max(int(along[-1] / _STEP_MM), 12), endpoint=False)
        return self._on_surface(CubicSpline(along, closed, bc_type="periodic")(at))

    def edited(self, curve_world: Float64[Array, "n 3"], handles: Sequence[Handle]) -> Float64[Array, "m 3"]:
        """Curve after some of its handles were moved, added or removed.

        Points between two unchanged neighbouring handles (`handle_indices`) remain unchanged. Each other piece is a
        smooth curve through its handles that continues the direction of the unchanged parts.

        Args:
            curve_world: the original curve, mm, world frame.
            handles: in order around it, at least three.
        """
        held = handle_indices(curve_world)
        following = dict(zip(held, np.roll(held, -1), strict=True))
        count = len(handles)
        kept = [
            handle.at is not None and following.get(handle.at) == other.at
            for handle, other in zip(handles, [*handles[1:], handles[0]], strict=True)
        ]
        if all(kept):
            return curve_world
        places = [handle.point_world if handle.at is None else curve_world[handle.at] for handle in handles]
        if not any(kept):
            return self.laid(np.array(places))
        pieces = []
        # Start after a new piece, so that the curve closes with one of its short steps.
        k = begin = next(i for i in range(count) if kept[i] and not kept[i - 1])
        while k < begin + count:
            at, to = handles[k % count].at, handles[(k + 1) % count].at
            if kept[k % count]:
                assert at is not None and to is not None  # noqa: PT018  # kept pieces have both ends on the curve
                pieces.append(_between(curve_world, at, to))
                k += 1
                continue
            end = k + 1
            while not kept[end % count]:
                end += 1
            last = handles[end % count].at
            assert at is not None and last is not None  # noqa: PT018  # a kept piece ends, and another begins
            through = np.array([places[i % count] for i in range(k, end + 1)])
            pieces += [curve_world[at][None], self._joined(curve_world, at, last, through)]
            k = end
        return np.concatenate(pieces)

    def _joined(
        self, curve_world: Float64[Array, "n 3"], first: int, last: int, through: Float64[Array, "k 3"]
    ) -> Float64[Array, "m 3"]:
        """New piece between two unchanged points of a curve, without these points."""
        along = _along(through)
        steps = max(round(along[-1] / _STEP_MM), 2)
        spline = CubicSpline(
            along, through, bc_type=((1, _direction(curve_world, first, -1)), (1, -_direction(curve_world, last, 1)))
        )
        return self._on_surface(spline(np.linspace(0.0, along[-1], steps + 1)[1:-1]))

    def _on_surface(self, points_world: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        return np.round(closest_on_mesh(points_world, self.surface.mesh).points, _DIGITS)

    def _measured(self, boundary: Boundary, boundaries: tuple[Boundary, ...]) -> VolumeMeasurement:
        breast = OpenBreast(
            boundary=boundary, surface=self.surface, settings=self.settings, boundaries=boundaries, frame=self.frame
        )
        return volumes.measure(boundary, chest_wall.fit(breast), self.settings)


def drawing_board(
    surface: RepairedSurface, frame: Float64[Array, "3 3"], settings: MeasureSettings, *, triangles: int = TRIANGLES
) -> DrawingBoard:
    """A repaired surface, simplified for drawing."""
    mesh, origin = thinned(surface.mesh, triangles)
    small = RepairedSurface(
        mesh=mesh,
        provenance=surface.provenance[origin],
        sigma_mm=surface.sigma_mm[origin],
        pair_bits=surface.pair_bits[origin],
        pair_names=surface.pair_names,
        convergence=surface.convergence,
    )
    return DrawingBoard(surface=small, frame=frame, settings=settings)


def handle_indices(curve_world: Float64[Array, "n 3"]) -> Int64[Array, " k"]:
    """Indices of a closed curve's evenly spaced handles: eight or more, or three of a short curve."""
    along = _along(np.concatenate([curve_world, curve_world[:1]]))
    count = max(int(along[-1] / _HANDLE_MM), _FEWEST_HANDLES)
    if len(curve_world) <= count:
        return np.arange(len(curve_world))
    wanted = np.linspace(0.0, along[-1], count, endpoint=False)
    nearest = np.unique(np.abs(along[:-1, None] - wanted).argmin(axis=0))
    return (
        nearest if len(nearest) >= 3 else np.linspace(0, len(curve_world), _FEWEST_HANDLES, endpoint=False).astype(int)
    )


def _along(points: Float64[Array, "n 3"]) -> Float64[Array, " n"]:
    """Distance along a polyline, mm. Strictly increasing, even if a point occurs twice."""
    return np.concatenate([[0.0], np.cumsum(np.maximum(np.linalg.norm(np.diff(points, axis=0), axis=1), 1e-6))])


def _between(curve: Float64[Array, "n 3"], first: int, last: int) -> Float64[Array, "m 3"]:
    """Points of a closed curve from the first index up to, but without, the last."""
    return curve[first:last] if first < last else np.concatenate([curve[first:], curve[:last]])


def _direction(curve: Float64[Array, "n 3"], at: int, step: int) -> Float64[Array, 3]:
    """Unit direction of a closed curve at a point, from the points before (step -1) or after it (step 1)."""
    k = at
    for _ in range(len(curve) - 1):
        k = (k + step) % len(curve)
        if np.linalg.norm(curve[at] - curve[k]) >= _TANGENT_MM:
            break
    towards = curve[at] - curve[k]
    return towards / max(float(np.linalg.norm(towards)), 1e-9)


def _breast(name: str) -> BreastName:
    assert name in get_args(BreastName), name
    return name  # type: ignore[return-value]
