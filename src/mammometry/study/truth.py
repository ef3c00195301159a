"""What is true of a virtual capture, as a value."""

from __future__ import annotations

from collections.abc import Mapping

from mammometry.base.value import value
from mammometry.geometry import Array, Float64, Rig, Transform, TriangleMesh


@value(eq=False)
class Truth:
    """Everything in the rig's frame, mm."""

    rig: Rig
    """The cameras that took the photographs, and their pairs."""
    rig_from_target: Mapping[str, Transform]
    """Pose → where the calibration target was. Empty where it is not known."""
    mesh: TriangleMesh
    """The subject as it stood."""
    volumes_cc: Mapping[str, float]
    """``model``, or the patient's ``left`` and ``right`` → true volume, cc. Empty where a volume means nothing."""
    boundaries: Mapping[str, Float64[Array, "n 3"]]
    """The same names → true closed boundary curve. Empty where there is none."""
