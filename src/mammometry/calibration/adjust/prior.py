"""What is known of a camera's lens beforehand: a rig's last calibration, or values that are to stay as they are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from mammometry.calibration.adjust.projection import INTRINSIC_NAMES, intrinsics_of
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.camera import Camera

LENS_NAMES = INTRINSIC_NAMES[:9]
"""Parameters of which something may be known beforehand."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraPrior:
    """A camera's lens as it was, each parameter free, fixed or held softly.

    Only the lens is carried over: where the camera stood is found again, since a camera that was moved must be found
    out, not be drawn back.
    """

    camera: Camera
    """Its matrix and distortion count."""
    std: Mapping[str, float]
    """Parameter (``fx_px`` … ``k3``) → standard deviation in px or none. Zero fixes it. One that is absent is free."""

    def __post_init__(self) -> None:
        for name, std in self.std.items():
            if name not in LENS_NAMES or not (np.isfinite(std) and std >= 0):
                raise ValueError(f"{self.camera.name}: no prior can have a standard deviation of {std} in {name}")
        object.__setattr__(self, "std", MappingProxyType(dict(self.std)))

    @property
    def intrinsics(self) -> Float64[Array, 10]:
        """The values in the order of `INTRINSIC_NAMES`."""
        return intrinsics_of(self.camera)

    @property
    def intrinsics_std(self) -> Float64[Array, 10]:
        """Their standard deviations, infinite where they are free, and where they are fixed and need no pull."""
        return np.array([self.std.get(name) or np.inf for name in INTRINSIC_NAMES])

    @property
    def fixed(self) -> frozenset[str]:
        """Names of the parameters that stay."""
        return frozenset(name for name, std in self.std.items() if std == 0)
