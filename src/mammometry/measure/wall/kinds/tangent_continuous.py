"""A wall that continues the slope of the skin around the breast."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from mammometry.base.errors import MeasureError
from mammometry.measure.solid.sew import Closed
from mammometry.measure.trunk.thorax import on_trunk
from mammometry.measure.wall.heights import TrunkChart, plate, through
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.measure.wall.registry import TORSO_WALLS, add_wall

_RING_MM = (12.0, 24.0)  # skin this far outside the boundary gives the slope; docs/decisions/0009 has what came of it
_RING_KNOTS = 240  # points of that skin, and of boundary and skin together in the plate; chosen by eye
_NOT_BREAST = 0.8
"""Skin nearer to the breast's own skin than this share of its distance from the boundary belongs to the breast, which
may hang over its fold. Without this rule volumes were 108 cc too large (docs/decisions/0009). Chosen by eye."""


@add_wall(
    TORSO_WALLS,
    name="tangent-continuous",
    place=2,
    definition="a thin plate in the trunk's cylindrical coordinates through the boundary and the skin 12 to "
    "24 mm outside it, so that it continues that skin's slope",
)
def tangent_continuous(breast: OpenBreast) -> Closed:
    """A plate through the boundary and the skin 12 to 24 mm outside it, whose slope it so continues.

    Raises:
        MeasureError: no skin was seen there.
    """
    part, trunk, beside = breast.part, breast.trunk, breast.beside
    rim = part.mesh.vertices[np.concatenate(part.loops)]
    away = np.asarray(cKDTree(rim).query(beside, distance_upper_bound=_RING_MM[1])[0])
    near = (away > _RING_MM[0]) & (away < _RING_MM[1])
    beside, away = beside[near], away[near]
    off_breast = np.asarray(cKDTree(part.mesh.vertices).query(beside)[0]) > _NOT_BREAST * away  # which may hang over
    flat = trunk.cylindrical(beside)
    ring = flat[off_breast & on_trunk(flat, trunk)]
    if len(ring) < _RING_KNOTS:
        raise MeasureError(
            "tangent-continuous wall",
            found=f"{len(ring)} points of skin {_RING_MM[0]:.0f} to {_RING_MM[1]:.0f} mm outside the boundary",
            expected=f"{_RING_KNOTS} or more",
            remedy="Choose another wall with --set measure.wall=default",
        )
    around = np.argsort(np.arctan2(*(ring[:, :2] - trunk.cylindrical(rim)[:, :2].mean(axis=0)).T[::-1]))
    knots = [trunk.cylindrical(rim), ring[around]]
    even = [places[np.linspace(0, len(places) - 1, _RING_KNOTS // 2).astype(int)] for places in knots]
    return through(part, TrunkChart(trunk=trunk), plate(np.concatenate(even)), subject="tangent-continuous wall")
