"""What stands where in a virtual session."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.camera import Rig
from mammometry.geometry.transform import Transform
from mammometry.simulate.subjects.solid import Solid


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Arrangement:
    """What stands where in a virtual session. Rig frame, mm."""

    rig: Rig
    """The true cameras."""
    lights: Float64[Array, "l 4"]
    """Position, and irradiance × mm² at distance 1, of each flash."""
    rig_from_target: Mapping[str, Transform]
    """Pose → where the calibration target is held."""
    solid: Solid
    """The subject, in its own frame."""
    rig_from_solid: Transform
    """Where the subject stands."""
