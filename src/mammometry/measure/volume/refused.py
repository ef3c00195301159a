"""A side that was outlined and not measured: why."""

from __future__ import annotations

from typing import Literal, cast

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.measure.boundary.breasts import NoBreast
from mammometry.measure.volume.volumes import measure_volume
from mammometry.measure.wall.open_breast import OpenBreast


def refused_side(breast: OpenBreast) -> NoBreast:
    """Why a side of a torso has no volume, by another attempt.

    Args:
        breast: whose volume was refused.

    Raises:
        ValueError: it can be measured.
    """
    points = breast.boundary.points_world
    vertices = breast.surface.mesh.vertices
    try:
        measure_volume(breast)
    except MeasureError as error:
        return NoBreast(
            name=cast(Literal["left", "right"], breast.boundary.name),
            place_world=vertices[np.linalg.norm(vertices - points.mean(axis=0), axis=1).argmin()],
            standing=None,
            why=str(error),
            unclear=True,
            refused=True,
        )
    raise ValueError(f"the {breast.boundary.name} side can be measured")
