"""A wall for a torso with one breast: the other side, mirrored."""

from __future__ import annotations

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.measure.boundary.standing import FEWEST_MM
from mammometry.measure.solid.sew import Closed
from mammometry.measure.trunk.thorax import on_trunk
from mammometry.measure.wall.heights import TrunkChart, layer, through
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.measure.wall.registry import TORSO_WALLS, add_wall

_AROUND_MM = 10.0  # skin this far outside the mirrored boundary is taken too, so that the layer ends beyond it
_CORE = 0.7  # share of the boundary's half extent within which a breast on the other side is looked for; by eye
_STANDING_OUT = 0.95  # quantile of the bulge there that says whether one stands; by eye, leaves room for outliers


@add_wall(
    TORSO_WALLS,
    name="mirrored",
    place=3,
    definition="the other side's skin, on which no breast stands, mirrored in the trunk's mid-sagittal plane, "
    "its misfit on the boundary spread smoothly inwards",
)
def mirrored(breast: OpenBreast) -> Closed:
    """The other side's skin without a breast, mirrored at the trunk's mid-sagittal plane (θ = 0).

    Raises:
        MeasureError: the other side bears a breast, or was not seen.
    """
    part, trunk, thorax, skin = breast.part, breast.trunk, breast.thorax, breast.skin
    other = trunk.cylindrical(skin.points_world) * [-1.0, 1.0, 1.0]
    rim = trunk.cylindrical(part.mesh.vertices[np.concatenate(part.loops)])
    low, high = rim[:, :2].min(axis=0), rim[:, :2].max(axis=0)
    near = ((other[:, :2] > low - _AROUND_MM) & (other[:, :2] < high + _AROUND_MM)).all(axis=1)
    other = other[near & on_trunk(other, trunk)]
    core = np.linalg.norm((other[:, :2] - (low + high) / 2) / ((high - low) / 2), axis=1) < _CORE
    bulge = other[core, 2] - thorax.radius_mm(other[core, :2] * [-1.0, 1.0])
    if not core.any() or np.quantile(bulge, _STANDING_OUT) > FEWEST_MM:
        raise MeasureError(
            "mirrored wall",
            found="a breast on the other side" if core.any() else "no skin seen on the other side",
            expected="a flat other side, to be mirrored",
            remedy="Choose another wall with --set measure.wall=default",
        )
    return through(part, TrunkChart(trunk=trunk), layer(other, "mirrored wall"), subject="mirrored wall")
