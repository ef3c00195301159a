"""Compiled kernel: intersection of matched pixels' rays. Plain NumPy version: tests/unit/surface/."""

import numpy as np

from mammometry.base.machine.compiled import kernel, small_kernel
from mammometry.geometry.arrays import Array, Float64, Int64

_SLOPE_STEP_PX = 0.05  # step of the disparity for the central difference of the distance: any small one


@kernel
def meetings(
    rows: Int64[Array, " n"],
    columns: Int64[Array, " n"],
    d_h_px: Float64[Array, " n"],
    d_v_px: Float64[Array, " n"],
    left: Float64[Array, " 4"],
    right: Float64[Array, " 4"],
    left_from_right: Float64[Array, "3 3"],
    baseline: Float64[Array, " 3"],
) -> tuple[Float64[Array, " n"], Float64[Array, " n"], Float64[Array, " n"]]:
    """Distances along both rays to their closest points, mm, and the left one's slope, mm/px.

    The slope is the derivative by d_H. The rays are those of (column, row) in the left and (column − d_H, row − d_V) in
    the right camera, both undistorted.

    Args:
        rows: rows of the left pixels.
        columns: their columns.
        d_h_px: their horizontal disparities.
        d_v_px: their vertical disparities.
        left: fx, fy, cx, cy of the left camera.
        right: fx, fy, cx, cy of the right camera.
        left_from_right: rotation between the camera frames.
        baseline: right perspective centre in the left camera's frame, mm.
    """
    count = len(rows)
    along_left, along_right, slope = np.empty(count), np.empty(count), np.empty(count)
    for i in range(count):
        x, y = (columns[i] - left[2]) / left[0], (rows[i] - left[3]) / left[1]
        u, v = columns[i] - d_h_px[i], rows[i] - d_v_px[i]
        along_left[i], along_right[i] = _meeting(x, y, u, v, right, left_from_right, baseline)
        further = _meeting(x, y, u - _SLOPE_STEP_PX, v, right, left_from_right, baseline)[0]
        nearer = _meeting(x, y, u + _SLOPE_STEP_PX, v, right, left_from_right, baseline)[0]
        slope[i] = abs(further - nearer) / (2.0 * _SLOPE_STEP_PX)
    return along_left, along_right, slope


@small_kernel
def _meeting(x, y, u, v, right, left_from_right, baseline):  # type: ignore[no-untyped-def]
    a, b = (u - right[2]) / right[0], (v - right[3]) / right[1]
    p = left_from_right[0, 0] * a + left_from_right[0, 1] * b + left_from_right[0, 2]
    q = left_from_right[1, 0] * a + left_from_right[1, 1] * b + left_from_right[1, 2]
    r = left_from_right[2, 0] * a + left_from_right[2, 1] * b + left_from_right[2, 2]
    left_length, right_length = np.sqrt(x * x + y * y + 1.0), np.sqrt(p * p + q * q + r * r)
    cosine = (x * p + y * q + r) / (left_length * right_length)
    to_left = (x * baseline[0] + y * baseline[1] + baseline[2]) / left_length
    to_right = (p * baseline[0] + q * baseline[1] + r * baseline[2]) / right_length
    denominator = 1.0 - cosine * cosine
    return (to_left - cosine * to_right) / denominator, (cosine * to_left - to_right) / denominator
