"""Brown's camera with analytic derivatives, many points and cameras at once.

The same model as `geometry.camera.Camera`, which is its oracle in the tests.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mammometry.geometry.arrays import Array, Float64

INTRINSIC_NAMES = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3")
"""Order of a camera's nine intrinsic values everywhere in the adjustment."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Projection:
    """Image points and what they depend on."""

    uv: Float64[Array, "n 2"]
    """Distorted pixels."""
    by_point: Float64[Array, "n 2 3"]
    """Derivative by the point in the camera's frame, px/mm."""
    by_intrinsics: Float64[Array, "n 2 9"]
    """Derivative by the intrinsics in the order of `INTRINSIC_NAMES`."""


def project(points_camera: Float64[Array, "n 3"], intrinsics: Float64[Array, "n 9"]) -> Float64[Array, "n 2"]:
    """Project camera-frame points, mm, each by its own intrinsics, to distorted pixels."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = intrinsics.T
    x, y = points_camera[:, 0] / points_camera[:, 2], points_camera[:, 1] / points_camera[:, 2]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    x_distorted = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    y_distorted = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([fx * x_distorted + cx, fy * y_distorted + cy], axis=1)


def project_with_derivatives(points_camera: Float64[Array, "n 3"], intrinsics: Float64[Array, "n 9"]) -> Projection:
    """Project as `project` does, with the analytic derivatives by the point and by the intrinsics."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = intrinsics.T
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
    by_point[:, 0, 0] = fx * d_xx * inverse_z
    by_point[:, 0, 1] = fx * d_xy * inverse_z
    by_point[:, 0, 2] = -fx * (d_xx * x + d_xy * y) * inverse_z
    by_point[:, 1, 0] = fy * d_xy * inverse_z
    by_point[:, 1, 1] = fy * d_yy * inverse_z
    by_point[:, 1, 2] = -fy * (d_xy * x + d_yy * y) * inverse_z

    by_intrinsics = np.zeros((len(x), 2, 9))
    by_intrinsics[:, 0, 0] = x_distorted
    by_intrinsics[:, 1, 1] = y_distorted
    by_intrinsics[:, 0, 2] = 1.0
    by_intrinsics[:, 1, 3] = 1.0
    for row, focal, ideal in ((0, fx, x), (1, fy, y)):
        by_intrinsics[:, row, 4] = focal * ideal * r2
        by_intrinsics[:, row, 5] = focal * ideal * r4
        by_intrinsics[:, row, 8] = focal * ideal * r4 * r2
    by_intrinsics[:, 0, 6] = 2 * fx * xy
    by_intrinsics[:, 1, 6] = fy * (r2 + 2 * yy)
    by_intrinsics[:, 0, 7] = fx * (r2 + 2 * xx)
    by_intrinsics[:, 1, 7] = 2 * fy * xy

    uv = np.stack([fx * x_distorted + cx, fy * y_distorted + cy], axis=1)
    return Projection(uv=uv, by_point=by_point, by_intrinsics=by_intrinsics)
