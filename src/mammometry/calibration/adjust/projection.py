"""Projection of many points with analytic derivatives, and priors on lenses.

The model is that of `geometry.camera.Camera` plus a skew. The lens is `geometry.lens`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mammometry.base.value import value
from mammometry.geometry import Array, Camera, Float64, lens

INTRINSIC_NAMES = ("fx_px", "fy_px", "cx_px", "cy_px", *lens.COEFFICIENTS, "skew_px")
"""Order of a camera's ten intrinsic values in the adjustment. The skew is the change of u with the distorted y. It is
zero in all cameras calibrated here; only published calibrations of older cameras have one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Projection:
    """Image points and their derivatives."""

    uv: Float64[Array, "n 2"]
    """Distorted pixels."""
    by_point: Float64[Array, "n 2 3"]
    """Derivative by the point in the camera's frame, px/mm."""
    by_intrinsics: Float64[Array, "n 2 10"]
    """Derivative by the intrinsics in the order of `INTRINSIC_NAMES`."""


def intrinsics_of(camera: Camera) -> Float64[Array, 10]:
    """A camera's intrinsic values in the order of `INTRINSIC_NAMES`. Without skew."""
    return np.array([*camera.intrinsics, *camera.distortion, 0.0])


def project(points_camera: Float64[Array, "n 3"], intrinsics: Float64[Array, "n 10"]) -> Float64[Array, "n 2"]:
    """Project camera-frame points, mm, each by its own intrinsics, to distorted pixels."""
    x, y = points_camera[:, 0] / points_camera[:, 2], points_camera[:, 1] / points_camera[:, 2]
    x_distorted, y_distorted = lens.distorted(x, y, intrinsics.T[4:9])
    return _pixels(x_distorted, y_distorted, intrinsics)


def project_with_derivatives(points_camera: Float64[Array, "n 3"], intrinsics: Float64[Array, "n 10"]) -> Projection:
    """Project as `project` does, with analytic derivatives by the point and by the intrinsics."""
    fx, fy, skew = intrinsics[:, 0], intrinsics[:, 1], intrinsics[:, 9]
    coefficients = intrinsics.T[4:9]
    inverse_z = 1.0 / points_camera[:, 2]
    x, y = points_camera[:, 0] * inverse_z, points_camera[:, 1] * inverse_z
    seen = lens.linearised(x, y, coefficients)

    d_xx, d_xy, d_yy = lens.jacobian(x, y, coefficients)
    by_point = np.empty((len(x), 2, 3))
    by_point[:, 0, 0] = (fx * d_xx + skew * d_xy) * inverse_z
    by_point[:, 0, 1] = (fx * d_xy + skew * d_yy) * inverse_z
    by_point[:, 1, 0] = fy * d_xy * inverse_z
    by_point[:, 1, 1] = fy * d_yy * inverse_z
    by_point[:, :, 2] = -(by_point[:, :, 0] * x[:, None] + by_point[:, :, 1] * y[:, None])

    by_intrinsics = np.zeros((len(x), 2, 10))
    by_intrinsics[:, 0, 0] = seen.x
    by_intrinsics[:, 1, 1] = seen.y
    by_intrinsics[:, 0, 2] = 1.0
    by_intrinsics[:, 1, 3] = 1.0
    by_intrinsics[:, 0, 9] = seen.y
    for column, (d_x, d_y) in enumerate(zip(seen.x_by_coefficient, seen.y_by_coefficient, strict=True), start=4):
        by_intrinsics[:, 0, column] = fx * d_x + skew * d_y
        by_intrinsics[:, 1, column] = fy * d_y

    return Projection(uv=_pixels(seen.x, seen.y, intrinsics), by_point=by_point, by_intrinsics=by_intrinsics)


def _pixels(
    x_distorted: Float64[Array, " n"], y_distorted: Float64[Array, " n"], intrinsics: Float64[Array, "n 10"]
) -> Float64[Array, "n 2"]:
    fx, fy, cx, cy, skew = intrinsics.T[[0, 1, 2, 3, 9]]
    return np.stack([fx * x_distorted + skew * y_distorted + cx, fy * y_distorted + cy], axis=1)


LENS_NAMES = INTRINSIC_NAMES[:9]
"""Parameters that may have a prior."""


@value(eq=False)
class CameraPrior:
    """Earlier calibration of a camera's lens. Each parameter is free, fixed or weighted.

    Only the lens is used. The camera's pose is estimated again, so that a moved camera is noticed.
    """

    camera: Camera
    """Camera with the lens. Its pose is not used."""
    std: Mapping[str, float]
    """Parameter (``fx_px`` … ``k3``) → standard deviation, px or dimensionless. Zero fixes it. Missing ones are
    free."""

    def __post_init__(self) -> None:
        for name, std in self.std.items():
            if name not in LENS_NAMES or not (np.isfinite(std) and std >= 0):
                raise ValueError(f"{self.camera.name}: a prior of {name} cannot have the standard deviation {std}")

    @property
    def intrinsics(self) -> Float64[Array, 10]:
        """The values in the order of `INTRINSIC_NAMES`."""
        return intrinsics_of(self.camera)

    @property
    def intrinsics_std(self) -> Float64[Array, 10]:
        """Standard deviations of the priors. Infinite if the parameter is free or fixed."""
        return np.array([self.std.get(name) or np.inf for name in INTRINSIC_NAMES])

    @property
    def fixed(self) -> frozenset[str]:
        """Names of the fixed parameters."""
        return frozenset(name for name, std in self.std.items() if std == 0)
