"""Prior knowledge of a camera's lens.

It comes from a rig's last calibration, or from values to be kept.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mammometry.base.value import value
from mammometry.calibration.adjust.projection import INTRINSIC_NAMES, intrinsics_of
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.camera import Camera

LENS_NAMES = INTRINSIC_NAMES[:9]
"""Parameters of which something may be known beforehand."""


@value(eq=False)
class CameraPrior:
    """A camera's earlier lens, each parameter free, fixed or softly held.

    Only the lens is kept. Where the camera stands is found again, so that a moved camera is detected and not pulled
    back.
    """

    camera: Camera
    """Its matrix and distortion count."""
    std: Mapping[str, float]
    """Parameter (``fx_px`` … ``k3``) → standard deviation, px or dimensionless. Zero fixes it. Missing ones are free.
    """

    def __post_init__(self) -> None:
        for name, std in self.std.items():
            if name not in LENS_NAMES or not (np.isfinite(std) and std >= 0):
                raise ValueError(f"{self.camera.name}: no prior can have a standard deviation of {std} in {name}")

    @property
    def intrinsics(self) -> Float64[Array, 10]:
        """The values in the order of `INTRINSIC_NAMES`."""
        return intrinsics_of(self.camera)

    @property
    def intrinsics_std(self) -> Float64[Array, 10]:
        """Standard deviations of the intrinsics' pull. Infinite if free, or fixed and in need of none."""
        return np.array([self.std.get(name) or np.inf for name in INTRINSIC_NAMES])

    @property
    def fixed(self) -> frozenset[str]:
        """Names of the parameters that stay."""
        return frozenset(name for name, std in self.std.items() if std == 0)
