"""Brown's camera with analytic derivatives, many points and cameras at once.

The same model as `geometry.camera.Camera`, which is its oracle in the tests, and a skew.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mammometry.geometry.arrays import Array, Float64

INTRINSIC_NAMES = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3", "skew_px")
"""Order of a camera's ten intrinsic values everywhere in the adjustment. The skew, u's change with the distorted y, is
zero in every camera that we return: only calibrations published of older cameras have one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Projection:
    """Image points and what they depend on."""

    uv: Float64[Array, "n 2"]
    """Distorted pixels."""
    by_point: Float64[Array, "n 2 3"]
    """Derivative by the point in the camera's frame, px/mm."""
    by_intrinsics: Float64[Array, "n 2 10"]
    """Derivative by the intrinsics in the order of `INTRINSIC_NAMES`."""


def project(points_camera: Float64[Array, "n 3"], intrinsics: Float64[Array, "n 10"]) -> Float64[Array, "n 2"]:
    """Project camera-frame points, mm, each by its own intrinsics, to distorted pixels."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3, skew = intrinsics.T
    x, y = points_camera[:, 0] / points_camera[:, 2], points_camera[:, 1] / points_camera[:, 2]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    x_distorted = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    y_distorted = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([fx * x_distorted + skew * y_distorted + cx, fy * y_distorted + cy], axis=1)


def project_with_derivatives(points_camera: Float64[Array, "n 3"], intrinsics: Float64[Array, "n 10"]) -> Projection:
    """Project as `project` does, with the analytic derivatives by the point and by the intrinsics."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3, skew = intrinsics.T
    inverse_z = 1.0 / points_camera[:, 2]
    x, y = points_camera[:, 0] * inverse_z, points_camera[:, 1] * inverse_z
    xx, yy, xy = x * x, y * y, x * y
    r2 = xx + yy
    r4 = r2 * r2
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2 * k2 + 3 * r2 * k3)  # d radial / d r²
    x_distorted = x * radial + 2 * p1 * xy + p2 * (r2 + 2 * xx)
    y_distorted = y * radial + p1 * (r2 + 2 * yy) + 2 * p2 * xy

    d_xx = radial + 2 * xx * slope + 2 * p1 * y + 6 * p2 * x
    d_yy = radial + 2 * yy * slope + 6 * p1 * y + 2 * p2 * x
    d_xy = 2 * xy * slope + 2 * p1 * x + 2 * p2 * y
    by_point = np.empty((len(x), 2, 3))
    by_point[:, 0, 0] = (fx * d_xx + skew * d_xy) * inverse_z
    by_point[:, 0, 1] = (fx * d_xy + skew * d_yy) * inverse_z
    by_point[:, 1, 0] = fy * d_xy * inverse_z
    by_point[:, 1, 1] = fy * d_yy * inverse_z
    by_point[:, :, 2] = -(by_point[:, :, 0] * x[:, None] + by_point[:, :, 1] * y[:, None])

    by_intrinsics = np.zeros((len(x), 2, 10))
    by_intrinsics[:, 0, 0] = x_distorted
    by_intrinsics[:, 1, 1] = y_distorted
    by_intrinsics[:, 0, 2] = 1.0
    by_intrinsics[:, 1, 3] = 1.0
    by_intrinsics[:, 0, 9] = y_distorted
    for column, d_x, d_y in (
        (4, x * r2, y * r2),
        (5, x * r4, y * r4),
        (6, 2 * xy, r2 + 2 * yy),
        (7, r2 + 2 * xx, 2 * xy),
        (8, x * r4 * r2, y * r4 * r2),
    ):
        by_intrinsics[:, 0, column] = fx * d_x + skew * d_y
        by_intrinsics[:, 1, column] = fy * d_y

    uv = np.stack([fx * x_distorted + skew * y_distorted + cx, fy * y_distorted + cy], axis=1)
    return Projection(uv=uv, by_point=by_point, by_intrinsics=by_intrinsics)
