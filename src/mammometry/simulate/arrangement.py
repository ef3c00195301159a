"""What stands where in a virtual session."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.camera import Rig
from mammometry.geometry.transform import Transform
from mammometry.simulate.disturbances.exposure import Exposure
from mammometry.simulate.rendering.objects.things import Thing
from mammometry.simulate.subjects.solid import Solid


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Arrangement:
    """What stands where in a virtual session. Rig frame, mm."""

    exposure: Exposure
    """Cameras, then and now. Films, flashes and moments."""
    lights: Float64[Array, "l 4"]
    """Each calibration flash: position, and irradiance × mm² at distance 1."""
    rig_from_target: Mapping[str, Transform]
    """Pose → where the calibration target is held."""
    solid: Solid
    """The subject, in its own frame."""
    rig_from_solid: Transform
    """Where the subject stands."""
    things: tuple[Thing, ...] = ()
    """What else stands about."""

    @property
    def rig(self) -> Rig:
        """The true cameras at the calibration."""
        return self.exposure.rig
