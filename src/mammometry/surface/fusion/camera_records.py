"""Cameras and images as table rows, for compiled code."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mammometry.base.machine.compiled import kernel
from mammometry.geometry import Array, Camera, Float64, lens_kernels

COLUMNS = 24
"""Columns of a row: the fields of `CameraRecord`."""
LEAST_DEPTH_MM = 1.0
"""Least depth of a point in front of the camera."""
_WIDEST_R2 = 4.0  # squared tangent of 63° off the axis: lens models are not valid that far outside the image


class CameraRecord(NamedTuple):
    """A camera, and the index of its first pixel in the flat image array."""

    rotation: tuple[float, float, float, float, float, float, float, float, float]
    """Camera from world, row by row."""
    translation: tuple[float, float, float]
    """Camera from world, mm."""
    fx: float
    fy: float
    cx: float
    cy: float
    lens: tuple[float, float, float, float, float]
    """`geometry.lens.COEFFICIENTS`."""
    width: int
    height: int
    start: int


def view_row(camera: Camera, shape_hw: tuple[int, ...], start: int) -> Float64[Array, 24]:
    """A camera, its image's size (height, width) and first pixel's index, as a row."""
    pose = camera.camera_from_world
    return np.concatenate(
        [
            pose.rotation.ravel(),
            pose.translation_mm,
            camera.intrinsics,
            camera.distortion,
            [shape_hw[1], shape_hw[0], start],
        ]
    )


@kernel
def view_of(row: Float64[Array, " 24"]) -> CameraRecord:
    """The `CameraRecord` of a row from `view_row`."""
    return CameraRecord(
        (row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8]),
        (row[9], row[10], row[11]),
        row[12],
        row[13],
        row[14],
        row[15],
        (row[16], row[17], row[18], row[19], row[20]),
        int(row[21]),
        int(row[22]),
        int(row[23]),
    )


@kernel
def in_camera(view, x, y, z):  # type: ignore[no-untyped-def]
    """A world point in the view's camera frame, mm."""
    r, t = view.rotation, view.translation
    return (
        r[0] * x + r[1] * y + r[2] * z + t[0],
        r[3] * x + r[4] * y + r[5] * z + t[1],
        r[6] * x + r[7] * y + r[8] * z + t[2],
    )


@kernel
def pixel(view, xc, yc, zc):  # type: ignore[no-untyped-def]
    """Column and row of a point in the camera's frame. Column −1 if it is outside the image."""
    inverse = 1.0 / max(zc, LEAST_DEPTH_MM)
    xn, yn = xc * inverse, yc * inverse
    xd, yd = lens_kernels.distorted(xn, yn, view.lens)
    u, v = view.fx * xd + view.cx, view.fy * yd + view.cy
    inside = (zc > LEAST_DEPTH_MM) & (xn * xn + yn * yn <= _WIDEST_R2)
    inside = inside & (u >= 0.0) & (v >= 0.0) & (u < view.width - 1.0) & (v < view.height - 1.0)
    return (u if inside else -1.0), v
