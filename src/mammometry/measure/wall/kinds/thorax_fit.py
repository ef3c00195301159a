"""A wall that follows the thorax beside the breasts."""

from __future__ import annotations

from mammometry.measure.solid.sew import Closed
from mammometry.measure.wall.heights import TrunkChart, through
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.measure.wall.registry import TORSO_WALLS, add_wall


@add_wall(
    TORSO_WALLS,
    name="thorax-fit",
    place=1,
    flat_u95_mm=7.0,
    definition="the thorax fitted to the skin beside both breasts (Fourier radius around the trunk's axis), "
    "its misfit on the boundary spread smoothly inwards",
)
def thorax_fit(breast: OpenBreast) -> Closed:
    """Thorax fitted to the skin beside the breasts, its misfit on the boundary spread harmonically."""
    thorax = breast.thorax
    return through(breast.part, TrunkChart(trunk=thorax.trunk), thorax.radius_mm, subject="thorax-fit wall")
