"""Projection of many points by compiled code in threads. `Camera.project` does the same in NumPy."""

from __future__ import annotations

import numpy as np

from mammometry.base.machine.cores import in_bands
from mammometry.geometry import lens_kernels
from mammometry.geometry.arrays import Array, Float64, read_only
from mammometry.geometry.camera import Camera


def projected(camera: Camera, points_world: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
    """Column and row, distorted pixels, and depth, mm, of world points (n, 3).

    Pixels of points that are not in front of the camera are NaN.
    """
    found = np.empty((len(points_world), 3))
    pose = np.column_stack([camera.camera_from_world.rotation, camera.camera_from_world.translation_mm])

    def project(some: slice) -> None:
        part = read_only(np.ascontiguousarray(points_world[some], dtype=np.float64))  # compiled for this type only
        lens_kernels.project(part, pose, camera.intrinsics, np.array(camera.distortion), found[some])

    in_bands(project, len(points_world))
    return found
