"""The measured breasts in pictures: their names, the patient's left, skin and wall."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.measure.volume.volume import VolumeMeasurement

NAMES: Mapping[str, str] = {"model": "cast", "left": "patient's left breast", "right": "patient's right breast"}


def patient_left(measurements: Sequence[VolumeMeasurement]) -> Float64[Array, 3] | None:
    """Direction towards the patient's left, world frame; None unless both breasts were measured."""
    middles = {measured.name: measured.boundary_world.mean(axis=0) for measured in measurements}
    return middles["left"] - middles["right"] if "left" in middles and "right" in middles else None


def wall_faces(measured: VolumeMeasurement) -> Bool[Array, " m"]:
    """Faces of the closed solid that belong to its wall."""
    return np.arange(len(measured.closed.faces)) >= measured.skin_faces
