"""Cameras and pictures as table rows for the first surface's kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mammometry.base.compiled import kernel
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.camera import Camera

COLUMNS = 24
"""Of a row: the fields of `View`, one after another."""


class View(NamedTuple):
    """A camera, and where its pixels begin in the flat picture array."""

    rotation: tuple[float, float, float, float, float, float, float, float, float]
    """Camera from world, row by row."""
    translation: tuple[float, float, float]
    """Of the same, mm."""
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
    """Pack a camera, its picture's size, and its first pixel's place.

    Size is height and width.
    """
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
def view_of(row: Float64[Array, " 24"]) -> View:
    """Unpack what `view_row` packed."""
    return View(
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
