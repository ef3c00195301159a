"""Compiled sum of depth pictures' signed distances on a grid of cubes."""

import numpy as np

from mammometry.base.machine.compiled import kernel
from mammometry.geometry.arrays import Array, Float32, Float64


@kernel
def add_picture(
    total: Float32[Array, "x y z"],
    weight: Float32[Array, "x y z"],
    depth: Float32[Array, "h w"],
    trust: Float32[Array, "h w"],
    camera_from_grid: Float64[Array, "3 4"],
    focal_px: float,
    truncation_mm: float,
) -> None:
    """Add one picture's truncated signed distances, weighted by its trust in each pixel.

    A corner takes the nearest pixel's depth minus its own, at most `truncation_mm`. One that lies further behind the
    skin is not seen and takes nothing.

    Args:
        total: sum of weighted distances, mm. Changed.
        weight: sum of weights. Changed.
        depth: along the camera's axis, mm. NaN where nothing is seen.
        trust: weight of each pixel.
        camera_from_grid: camera's frame, mm, from a corner's index.
        focal_px: of a camera without distortion, whose axis meets the picture's middle.
        truncation_mm: largest distance, mm.
    """
    height, width = depth.shape
    nx, ny, nz = total.shape
    middle_u, middle_v = (width - 1) / 2, (height - 1) / 2
    m = camera_from_grid
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                z = m[2, 0] * i + m[2, 1] * j + m[2, 2] * k + m[2, 3]
                if z <= 0.0:
                    continue
                x = m[0, 0] * i + m[0, 1] * j + m[0, 2] * k + m[0, 3]
                y = m[1, 0] * i + m[1, 1] * j + m[1, 2] * k + m[1, 3]
                column = int(np.floor(focal_px * x / z + middle_u + 0.5))
                row = int(np.floor(focal_px * y / z + middle_v + 0.5))
                if row < 0 or column < 0 or row >= height or column >= width:
                    continue
                distance = depth[row, column] - z
                if not distance > -truncation_mm:  # also where nothing is seen
                    continue
                share = trust[row, column]
                total[i, j, k] += share * min(distance, truncation_mm)
                weight[i, j, k] += share
