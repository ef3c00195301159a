"""A wall that continues the slope of the skin around the breast."""

from __future__ import annotations

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.nearest import point_tree
from mammometry.measure.solid.sew import Closed
from mammometry.measure.trunk.thorax import on_trunk
from mammometry.measure.wall.heights import TrunkChart, plate, through
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.measure.wall.registry import TORSO_WALLS, add_wall

_RING_MM = (12.0, 24.0)  # skin this far outside the boundary gives the slope; docs/decisions/0009 has what came of it
_SECTORS = 120  # directions around the boundary; the ring's skin in each gives one knot; chosen by eye
_FEWEST_SECTORS = 60  # that must hold skin; chosen by eye
_STEEPEST = 0.8
"""Slope of the ring's skin against the boundary, in the trunk's coordinates, above which it is no chest. Chosen by eye:
folds made slopes of up to 12 on real women."""
_NOT_BREAST = 0.8
"""Skin nearer to the breast's own skin than this share of its distance from the boundary belongs to the breast, which
may hang over its fold. Without this, volumes were 108 cc too large (docs/decisions/0009). Chosen by eye."""


@add_wall(
    TORSO_WALLS,
    name="tangent-continuous",
    place=2,
    definition="a thin plate in the trunk's cylindrical coordinates through the boundary and the skin 12 to "
    "24 mm outside it, so that it continues that skin's slope",
)
def tangent_continuous(breast: OpenBreast) -> Closed:
    """A plate through the boundary that continues the slope outside it.

    It goes through the boundary and the skin 12 to 24 mm outside. Distances are those laid flat around the trunk: skin
    that is near in space may lie under a fold, at the same place.

    Raises:
        MeasureError: no skin was seen there, or only around less than half of the boundary.
    """
    part, trunk = breast.part, breast.trunk
    rim = trunk.cylindrical(part.mesh.vertices[np.concatenate(part.loops)])
    flat = trunk.cylindrical(breast.beside)
    away, nearest = (np.asarray(array) for array in point_tree(rim[:, :2]).query(flat[:, :2]))
    near = (away > _RING_MM[0]) & (away < _RING_MM[1]) & on_trunk(flat, trunk)
    near &= np.abs(flat[:, 2] - rim[nearest, 2]) < _STEEPEST * away
    ring, away = flat[near], away[near]
    off_breast = np.asarray(point_tree(part.mesh.vertices).query(breast.beside[near])[0]) > _NOT_BREAST * away
    knots = _one_each(ring[off_breast], rim)
    if len(knots) < _FEWEST_SECTORS:
        raise MeasureError(
            "tangent-continuous wall",
            found=f"skin {_RING_MM[0]:.0f} to {_RING_MM[1]:.0f} mm outside the boundary in {len(knots)} of {_SECTORS} "
            "directions",
            expected=f"{_FEWEST_SECTORS} or more",
            remedy="Choose another wall with --set measure.wall=default",
        )
    even = rim[np.linspace(0, len(rim) - 1, _SECTORS).astype(int)]
    return through(
        part, TrunkChart(trunk=trunk), plate(np.concatenate([even, knots])), subject="tangent-continuous wall"
    )


def _one_each(ring: Float64[Array, "n 3"], rim: Float64[Array, "m 3"]) -> Float64[Array, "k 3"]:
    """The ring's median place in each direction from the boundary's middle that holds skin."""
    offset = ring[:, :2] - rim[:, :2].mean(axis=0)
    sector = ((np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi) + 0.5) * _SECTORS).astype(int) % _SECTORS
    found = [np.median(ring[sector == number], axis=0) for number in range(_SECTORS) if (sector == number).any()]
    return np.array(found).reshape(-1, 3)
