"""Compiled kernel: points through a camera."""

import numpy as np

from mammometry.base.machine.compiled import kernel
from mammometry.geometry import lens_kernels
from mammometry.geometry.arrays import Array, Float64


@kernel
def project(
    points: Float64[Array, "n 3"],
    pose: Float64[Array, "3 4"],
    intrinsics: Float64[Array, " 4"],
    distortion: Float64[Array, " 5"],
    found: Float64[Array, "n 3"],
) -> None:
    """Fill `found` with column, row and depth of each point.

    `pose`: rotation and translation side by side. `intrinsics`: fx, fy, cx, cy.
    """
    lens = distortion[0], distortion[1], distortion[2], distortion[3], distortion[4]
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        right = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
        down = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
        depth = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        found[i, 2] = depth
        if depth > 0.0:
            at_x, at_y = lens_kernels.distorted(right / depth, down / depth, lens)
            found[i, 0] = at_x * intrinsics[0] + intrinsics[2]
            found[i, 1] = at_y * intrinsics[1] + intrinsics[3]
        else:
            found[i, 0] = found[i, 1] = np.nan
