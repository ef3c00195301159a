"""The lens model and the camera's projection for compiled code.

The arithmetic is that of `lens`. `coefficients` is a tuple or an array of five. Slice an array once per row of pixels:
a slice for every pixel takes longer than the lens model itself.
"""

import numpy as np

from mammometry.base.machine.compiled import kernel, small_kernel
from mammometry.geometry import lens
from mammometry.geometry.arrays import Array, Float64

_TOLERANCE = 1e-7  # Newton's method squares the error: after a step this small, it is below 1e-13

distorted = small_kernel(lens.distorted)
jacobian = small_kernel(lens.jacobian)


@small_kernel
def undistorted(
    xd: float, yd: float, coefficients: Array, x: float, y: float
) -> tuple[float, float, float, float, float]:
    """Ideal point of a distorted one, and the Jacobian xx, xy, yy there.

    The iteration starts at (x, y).
    """
    by_xx, by_xy, by_yy = 1.0, 0.0, 1.0
    for _ in range(lens.NEWTON_STEPS):
        at_x, at_y = distorted(x, y, coefficients)
        error_x, error_y = at_x - xd, at_y - yd
        by_xx, by_xy, by_yy = jacobian(x, y, coefficients)
        determinant = by_xx * by_yy - by_xy * by_xy
        step_x = (by_yy * error_x - by_xy * error_y) / determinant
        step_y = (by_xx * error_y - by_xy * error_x) / determinant
        x -= step_x
        y -= step_y
        if abs(step_x) + abs(step_y) < _TOLERANCE:
            break
    return x, y, by_xx, by_xy, by_yy


@kernel
def project(
    points: Float64[Array, "n 3"],
    pose: Float64[Array, "3 4"],
    intrinsics: Float64[Array, " 4"],
    distortion: Float64[Array, " 5"],
    found: Float64[Array, "n 3"],
) -> None:
    """Write column, row and depth of each point into `found`.

    `pose`: rotation and translation, (3, 4). `intrinsics`: fx, fy, cx, cy.
    """
    lens = distortion[0], distortion[1], distortion[2], distortion[3], distortion[4]
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        right = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
        down = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
        depth = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        found[i, 2] = depth
        if depth > 0.0:
            at_x, at_y = distorted(right / depth, down / depth, lens)
            found[i, 0] = at_x * intrinsics[0] + intrinsics[2]
            found[i, 1] = at_y * intrinsics[1] + intrinsics[3]
        else:
            found[i, 0] = found[i, 1] = np.nan
