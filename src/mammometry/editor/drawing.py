"""What is drawn, laid onto the surface and measured while it is drawn.

The surface is thinned for this, so that a volume follows within a moment; the number that counts is the one that
``mammometry measure`` makes of the saved curve on the full mesh.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import get_args

import numpy as np
from scipy.interpolate import CubicSpline

from mammometry.errors import MeasureError
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.camera import Rig
from mammometry.geometry.nearest import closest_on_mesh
from mammometry.measure import chest_wall, volume
from mammometry.measure.boundary import Boundary, BreastName, given_boundary
from mammometry.measure.settings import MeasureSettings
from mammometry.report.models import thinned
from mammometry.surface.repair import RepairedSurface

TRIANGLES = 120_000
_STEP_MM = 2.0
_HANDLE_MM = 18.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LiveVolume:
    """One breast as it is drawn."""

    curve_world: Float64[Array, "n 3"]
    """The closed curve on the surface, mm, world frame."""
    volume_cc: float | None
    """None where the curve encloses no solid; `problem` says why."""
    interval_cc: tuple[float, float] | None
    problem: str | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrawingBoard:
    """The surface that is drawn on."""

    surface: RepairedSurface
    """Thinned; world frame, mm."""
    rig: Rig
    settings: MeasureSettings

    def measure(self, handles_world: Mapping[str, Float64[Array, "k 3"]]) -> dict[str, LiveVolume]:
        """Lay closed curves through handles onto the surface, and measure what they enclose.

        Args:
            handles_world: breast → at least three points of its boundary, in order, mm, world frame.
        """
        curves = {name: self.laid(handles) for name, handles in handles_world.items()}
        drawn: dict[str, Boundary] = {}
        problems: dict[str, str] = {}
        for name, curve in curves.items():
            try:
                drawn[name] = given_boundary(_breast(name), curve, self.surface)
            except MeasureError as error:
                problems[name] = str(error)
        found = {}
        for name, curve in curves.items():
            measured = None
            if name in drawn:
                try:
                    measured = self._measured(drawn[name], tuple(drawn.values()))
                except MeasureError as error:
                    problems[name] = str(error)
            found[name] = LiveVolume(
                curve_world=curve,
                volume_cc=None if measured is None else measured.volume_cc,
                interval_cc=None if measured is None else measured.interval_cc,
                problem=problems.get(name),
            )
        return found

    def laid(self, handles_world: Float64[Array, "k 3"]) -> Float64[Array, "n 3"]:
        """A smooth closed curve through the handles (periodic cubic spline over their distances), on the surface."""
        closed = np.concatenate([handles_world, handles_world[:1]])
        along = np.concatenate([[0.0], np.cumsum(np.maximum(np.linalg.norm(np.diff(closed, axis=0), axis=1), 1e-6))])
        at = np.linspace(0.0, along[-1], max(int(along[-1] / _STEP_MM), 12), endpoint=False)
        return closest_on_mesh(CubicSpline(along, closed, bc_type="periodic")(at), self.surface.mesh).points

    def _measured(self, boundary: Boundary, boundaries: tuple[Boundary, ...]) -> volume.VolumeMeasurement:
        wall = chest_wall.fit(boundary, self.surface, self.settings, boundaries=boundaries, rig=self.rig)
        return volume.measure(boundary, wall, self.settings)


def drawing_board(
    surface: RepairedSurface, rig: Rig, settings: MeasureSettings, *, triangles: int = TRIANGLES
) -> DrawingBoard:
    """Thin a repaired surface for drawing on it."""
    mesh, origin = thinned(surface.mesh, triangles)
    small = RepairedSurface(
        mesh=mesh,
        provenance=surface.provenance[origin],
        sigma_mm=surface.sigma_mm[origin],
        pair_bits=surface.pair_bits[origin],
        pair_names=surface.pair_names,
        convergence=surface.convergence,
    )
    return DrawingBoard(surface=small, rig=rig, settings=settings)


def handles_of(curve_world: Float64[Array, "n 3"], spacing_mm: float = _HANDLE_MM) -> Float64[Array, "k 3"]:
    """Few points of a closed curve, evenly along it, to take hold of: at least eight."""
    closed = np.concatenate([curve_world, curve_world[:1]])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], max(int(along[-1] / spacing_mm), 8), endpoint=False)
    return np.stack([np.interp(at, along, closed[:, axis]) for axis in range(3)], axis=1)


def _breast(name: str) -> BreastName:
    assert name in get_args(BreastName), name
    return name  # type: ignore[return-value]
