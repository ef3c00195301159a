"""The cylinder membrane, from which the layer before the muscle is counted."""

from __future__ import annotations

from mammometry.measure.solid.sew import Closed
from mammometry.measure.wall.heights import TrunkChart, through
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.measure.wall.registry import TORSO_WALLS, add_wall


@add_wall(
    TORSO_WALLS,
    name="cylinder-membrane",
    place=1,
    flat_u95_mm=4.5,  # 4.1 on 145 breasts, which tell that limit to 3.7 to 4.5
    definition="a membrane stretched over the boundary, in the trunk's cylindrical coordinates (the distance from "
    "the axis is harmonic); the breast is what lies in front of it",
)
def cylinder_membrane(breast: OpenBreast) -> Closed:
    """Harmonic radius from the trunk's axis, fixed on the boundary. Harmonic over (θ, y)."""
    return through(breast.part, TrunkChart(trunk=breast.trunk), subject="cylinder-membrane wall")
