"""The lens model for compiled code, one point at a time.

The arithmetic is that of `lens`. `coefficients` is a tuple or an array of five. Take the slice once a row of pixels:
taken for every pixel, it costs more than the lens.
"""

from mammometry.base.machine.compiled import small_kernel
from mammometry.geometry import lens
from mammometry.geometry.arrays import Array

_TOLERANCE = 1e-7  # Newton's method doubles the digits: after a step this small the error is below 1e-13

distorted = small_kernel(lens.distorted)
jacobian = small_kernel(lens.jacobian)


@small_kernel
def undistorted(
    xd: float, yd: float, coefficients: Array, x: float, y: float
) -> tuple[float, float, float, float, float]:
    """Ideal point of a distorted one, and the Jacobian there.

    Starts from the guess (x, y). Returns xx, xy, yy of the Jacobian.
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
