"""Walls of a cast: the plane or the convex cylinder through its rim."""

from __future__ import annotations

from dataclasses import replace

from mammometry.measure.boundary.cast_base import Base
from mammometry.measure.solid.patch import Closed, sew
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.measure.wall.registry import CAST_WALLS, add_wall

_SPACING_MM = 2.0  # spacing of the inner points of a curved base; not critical
_FLAT = "the cast's own flat base: the plane through the rim that the photographs show"


@add_wall(CAST_WALLS, name="plane", place=0, definition=_FLAT)
def flat_base(breast: OpenBreast) -> Closed:
    """A cast closed by the plane through its rim."""
    return _closed_by(breast.base_as("plane"), breast)


@add_wall(
    CAST_WALLS,
    name="convex-cylinder",
    place=1,
    definition="the cast's own curved base: a circular cylinder, bent away from the viewer, through the rim that the "
    "photographs show",
)
def curved_base(breast: OpenBreast) -> Closed:
    """A cast closed by the cylinder through its rim, or by the plane if the rim is flat."""
    return _closed_by(breast.base_as("convex-cylinder"), breast)


def _closed_by(base: Base, breast: OpenBreast) -> Closed:
    """Part of a cast above a base, closed by the base."""
    part = breast.above(base)
    closed = sew(
        part,
        tuple(base.flatten(part.mesh.vertices[loop]) for loop in part.loops),
        lambda patch: base.lift(patch.points[patch.n_loop :]),
        spacing_mm=None if base.is_plane else _SPACING_MM,
        subject="base of the model",
    )
    return replace(closed, kind=base.kind, definition=_definition(base))


def _definition(base: Base) -> str:
    if base.is_plane:
        return _FLAT
    return (
        "the cast's own curved base: the circular cylinder, radius "
        f"{1 / base.curvature_per_mm:.0f} mm, bent away from the viewer, through the rim that the photographs show"
    )
