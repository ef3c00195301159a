"""The rounded membrane: the default wall of a torso's breast."""

from __future__ import annotations

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.geometry.arrays import Array, Float64
from mammometry.measure.solid.sew import Closed
from mammometry.measure.wall.heights import TrunkChart, through
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.measure.wall.registry import TORSO_WALLS, add_wall

_USUAL_PER_MM = 0.0033
"""Curvature along the body of a flat chest: mean of real women, 1/mm (docs/decisions/0029)."""
_GOES_ON = 0.5
"""Share of the curvature beside a breast that goes on behind it: between .3 and .9 in five families with known chests,
and the one with which their errors are least (docs/decisions/0029)."""


@add_wall(
    TORSO_WALLS,
    name="rounded-membrane",
    place=0,
    flat_u95_mm=3.8,  # the scatter of the cylinder membrane on 145 breasts, 1.9 mm, without its mean (decision 29)
    definition="a membrane stretched over the boundary, in the trunk's cylindrical coordinates, and rounded from top "
    "to bottom as chests are: by a quarter of the sum of the curvature of the skin beside both breasts and that of "
    "real women's chests",
)
def rounded_membrane(breast: OpenBreast) -> Closed:
    """Radius from the trunk's axis whose Laplacian over (θ, y) is constant, fixed on the boundary."""
    curvature = _GOES_ON * _curvature_per_mm(breast)

    def bent(flat: Float64[Array, "n 2"]) -> Float64[Array, " n"]:
        return np.asarray(-curvature * flat[:, 1] ** 2 / 2)

    return through(breast.part, TrunkChart(trunk=breast.trunk), bent, subject="rounded-membrane wall")


def _curvature_per_mm(breast: OpenBreast) -> float:
    """Curvature of the chest along the body, 1/mm: the mean of what the skin beside shows and what is usual.

    Skin beside breasts is no chest without one: folds, armpits and a hanging breast's slope bend it. So what it shows
    counts no more than real women's mean, and never as less than none or more than twice that.
    """
    try:
        thorax = breast.thorax
    except MeasureError:  # too little skin was seen beside the breasts
        return _USUAL_PER_MM
    rim = breast.trunk.cylindrical(breast.part.mesh.vertices[np.concatenate(breast.part.loops)])
    shown = float(thorax.bend_per_mm(rim[:, :2]).mean())
    return (_USUAL_PER_MM + float(np.clip(shown, 0.0, 2 * _USUAL_PER_MM))) / 2
