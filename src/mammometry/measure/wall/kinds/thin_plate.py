"""A wall as a thin plate would bend through the boundary."""

from __future__ import annotations

import numpy as np

from mammometry.measure.solid.sew import Closed
from mammometry.measure.wall.heights import best_plane, plate, through
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.measure.wall.registry import CAST_WALLS, TORSO_WALLS, add_wall


@add_wall(
    TORSO_WALLS,
    CAST_WALLS,
    name="thin-plate",
    place=6,
    flat_u95_mm=6.5,
    definition="the plate of least bending through the boundary: a thin-plate spline over its best plane",
)
def thin_plate(breast: OpenBreast) -> Closed:
    """Plate of least bending through the boundary. A thin-plate spline over its best plane (Duchon)."""
    part = breast.part
    chart = best_plane(part)
    rim = chart.flatten(part.mesh.vertices[np.concatenate(part.loops)])
    return through(part, chart, plate(rim), subject="thin-plate wall")
