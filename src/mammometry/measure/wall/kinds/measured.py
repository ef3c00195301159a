"""A separately measured wall: a second scan, or a cast's back."""

from __future__ import annotations

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.measure.solid.sew import Closed
from mammometry.measure.wall.heights import Chart, TrunkChart, best_plane, layer, through
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.measure.wall.registry import CAST_WALLS, TORSO_WALLS, add_wall

_NEAR_MM = 60.0  # the measured surface is taken this far around the opening, in every coordinate; chosen by eye


@add_wall(
    TORSO_WALLS,
    name="measured",
    place=4,
    measured=True,
    definition="the wall measured separately (wall.ply), its misfit on the boundary spread smoothly inwards",
)
def measured_wall(breast: OpenBreast) -> Closed:
    """A separately measured chest, as far as it is behind the opening.

    Raises:
        MeasureError: there is none, or it does not cover the opening.
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
    """A cast's back that was measured by itself.

    Raises:
        MeasureError: there is none, or it does not cover the opening.
    """
    return _measured(breast, best_plane(breast.part))


def _measured(breast: OpenBreast, chart: Chart) -> Closed:
    """Close a breast with its measured back, as one layer.

    The coordinates are chosen so that the back is one layer.
    """
    part, back = breast.part, breast.back
    if back is None:
        raise MeasureError(
            "measured wall",
            found="no wall that was measured by itself",
            expected="one, as a mesh in the same frame",
            remedy="Add wall.ply to the session, or choose --set measure.wall=default",
            mesh_remedy="Give it with --wall, or choose --set measure.wall=default",
        )
    places = chart.flatten(np.concatenate([back.vertices, back.corners().mean(axis=1)]))
    rim = chart.flatten(part.mesh.vertices[np.concatenate(part.loops)])
    within = (places > rim.min(axis=0) - _NEAR_MM) & (places < rim.max(axis=0) + _NEAR_MM)
    return through(part, chart, layer(places[within.all(axis=1)], "measured wall"), subject="measured wall")
