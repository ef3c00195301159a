"""Walls that follow skin beside the breasts, on the other side, or measured separately."""

from __future__ import annotations

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.measure.boundary.prominence import MIN_PROMINENCE_MM
from mammometry.measure.solid.patch import Closed
from mammometry.measure.trunk.thorax import on_trunk
from mammometry.measure.wall.heights import Chart, TrunkChart, best_plane, layer, through
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.measure.wall.registry import CAST_WALLS, TORSO_WALLS, add_wall


@add_wall(
    TORSO_WALLS,
    name="thorax-fit",
    place=1,
    flat_u95_mm=7.0,
    definition="the thorax fitted to the skin beside both breasts (Fourier radius around the trunk's axis), "
    "its misfit on the boundary spread smoothly inwards",
)
def thorax_fit(breast: OpenBreast) -> Closed:
    """Thorax fitted to the skin beside the breasts, with its misfit on the boundary spread harmonically."""
    thorax = breast.thorax
    return through(breast.part, TrunkChart(trunk=thorax.trunk), thorax.radius_mm, subject="thorax-fit wall")


_AROUND_MM = 10.0  # margin of skin around the mirrored boundary, so that the layer covers all of it
_CORE = 0.7  # share of the boundary's half extent in which a breast on the other side is looked for; not critical
_STANDING_OUT = 0.95
"""Quantile of the bulge in this core that is compared with the prominence of a breast, so that 5 % outliers do not
matter."""


@add_wall(
    TORSO_WALLS,
    name="mirrored",
    place=3,
    definition="the other side's skin, on which no breast stands, mirrored in the trunk's mid-sagittal plane, "
    "its misfit on the boundary spread smoothly inwards",
)
def mirrored(breast: OpenBreast) -> Closed:
    """Skin of the other, flat side, mirrored at the trunk's mid-sagittal plane (θ = 0).

    Raises:
        MeasureError: there is a breast on the other side, or it is not visible.
    """
    part, trunk, thorax, skin = breast.part, breast.trunk, breast.thorax, breast.skin
    other = trunk.cylindrical(skin.points_world) * [-1.0, 1.0, 1.0]
    rim = trunk.cylindrical(part.mesh.vertices[np.concatenate(part.loops)])
    low, high = rim[:, :2].min(axis=0), rim[:, :2].max(axis=0)
    near = ((other[:, :2] > low - _AROUND_MM) & (other[:, :2] < high + _AROUND_MM)).all(axis=1)
    other = other[near & on_trunk(other, trunk)]
    core = np.linalg.norm((other[:, :2] - (low + high) / 2) / ((high - low) / 2), axis=1) < _CORE
    bulge = other[core, 2] - thorax.radius_mm(other[core, :2] * [-1.0, 1.0])
    if not core.any() or np.quantile(bulge, _STANDING_OUT) > MIN_PROMINENCE_MM:
        raise MeasureError(
            "mirrored wall",
            found="a breast on the other side" if core.any() else "no visible skin on the other side",
            expected="a flat other side, to be mirrored",
            remedy="Choose another wall with --set measure.wall=default",
        )
    return through(part, TrunkChart(trunk=trunk), layer(other, "mirrored wall"), subject="mirrored wall")


_NEAR_MM = 60.0  # margin of the measured surface around the opening, in each coordinate; not critical


@add_wall(
    TORSO_WALLS,
    name="measured",
    place=4,
    measured=True,
    definition="the wall measured separately (wall.ply), its misfit on the boundary spread smoothly inwards",
)
def measured_wall(breast: OpenBreast) -> Closed:
    """The separately measured chest behind the opening.

    Raises:
        MeasureError: it is missing, or does not cover the opening.
    """
    return _measured(breast, TrunkChart(trunk=breast.trunk))


@add_wall(
    CAST_WALLS,
    name="measured",
    place=4,
    measured=True,
    definition="the cast's back measured separately (wall.ply), its misfit on the rim spread smoothly inwards",
)
def measured_back(breast: OpenBreast) -> Closed:
    """A cast's separately measured back.

    Raises:
        MeasureError: it is missing, or does not cover the opening.
    """
    return _measured(breast, best_plane(breast.part))


def _measured(breast: OpenBreast, chart: Chart) -> Closed:
    """A breast closed by its measured back, which is a single layer over the chart."""
    part, back = breast.part, breast.back
    if back is None:
        raise MeasureError(
            "measured wall",
            found="no separately measured wall",
            expected="a mesh of the wall in the same frame",
            remedy="Add wall.ply to the session, or choose --set measure.wall=default",
            mesh_remedy="Give it with --wall, or choose --set measure.wall=default",
        )
    places = chart.flatten(np.concatenate([back.vertices, back.corners().mean(axis=1)]))
    rim = chart.flatten(part.mesh.vertices[np.concatenate(part.loops)])
    within = (places > rim.min(axis=0) - _NEAR_MM) & (places < rim.max(axis=0) + _NEAR_MM)
    return through(part, chart, layer(places[within.all(axis=1)], "measured wall"), subject="measured wall")
