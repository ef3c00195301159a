"""The measured breasts in pictures: their names, the front view, skin and wall."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mammometry.geometry.arrays import Array, Bool
from mammometry.job.inputs import Inputs
from mammometry.measure.boundary.boundary import TorsoSides
from mammometry.measure.boundary.breasts import NoBreast
from mammometry.measure.volume.volume import VolumeMeasurement

NAMES: Mapping[str, str] = {"model": "cast", "left": "patient's left breast", "right": "patient's right breast"}


def absent_of(sides: TorsoSides, inputs: Inputs) -> tuple[NoBreast, ...]:
    """Sides without a breast, but for those on which a boundary was drawn."""
    return tuple(side for side in sides.absent if side.name not in inputs.boundaries)


def wall_faces(measured: VolumeMeasurement) -> Bool[Array, " m"]:
    """Faces of the closed solid that belong to its wall."""
    return np.arange(len(measured.closed.faces)) >= measured.skin_faces
