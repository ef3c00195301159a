"""Pictures of the breasts: names, front view, skin and wall."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mammometry.geometry.arrays import Array, Bool
from mammometry.measure.volume.measurement import VolumeMeasurement

NAMES: Mapping[str, str] = {"model": "cast", "left": "patient's left breast", "right": "patient's right breast"}


def wall_faces(measured: VolumeMeasurement) -> Bool[Array, " m"]:
    """Faces of the closed solid that belong to its wall."""
    return np.arange(len(measured.closed.faces)) >= measured.skin_faces
