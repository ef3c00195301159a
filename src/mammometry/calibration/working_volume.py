"""Where the rig measures: the points near the meeting of its axes that some pair sees with both cameras."""

from __future__ import annotations

import numpy as np

from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.geometry.camera import Camera, Rig

_PARALLEL_COSINE = float(np.cos(np.radians(5.0)))


def meeting_point(rig: Rig) -> Float64[Array, 3]:
    """The point nearest to all optical axes, world, mm; for parallel ones near the cameras' mean."""
    centres = np.stack([camera.centre_world for camera in rig.cameras.values()])
    across = np.stack([np.eye(3) - np.outer(c.axis_world, c.axis_world) for c in rig.cameras.values()])
    weak = 1e-6 * np.eye(3)
    right = np.einsum("nij,nj->i", across, centres) + weak @ centres.mean(axis=0)
    return np.linalg.solve(across.sum(axis=0) + weak, right)


def working_volume(rig: Rig, *, steps: int = 9) -> tuple[Float64[Array, "n 3"], float]:
    """Grid points of the working volume, and their spacing; world, mm.

    A cube about the meeting point, as wide as the cameras' pictures are high there; of it what both cameras of at least
    one pair see. Empty for a rig without pairs, whose pairs look past each other, or whose axes are parallel to
    within 5° and so meet nowhere.
    """
    axes = np.stack([camera.axis_world for camera in rig.cameras.values()])
    if (axes @ axes.T).min() > _PARALLEL_COSINE:
        return np.empty((0, 3)), 0.0
    centre = meeting_point(rig)
    reach = float(np.median([_half_height_mm(camera, centre) for camera in rig.cameras.values()]))
    ticks = np.linspace(-reach, reach, steps)
    grid = centre + np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    seen = np.zeros(len(grid), bool)
    for pair in rig.pairs:
        seen |= _sees(pair.left, grid) & _sees(pair.right, grid)
    return grid[seen], 2 * reach / (steps - 1)


def _half_height_mm(camera: Camera, point_world: Float64[Array, 3]) -> float:
    distance_mm = float(np.linalg.norm(point_world - camera.centre_world))
    return distance_mm * min(camera.size_wh) / (2 * float(camera.matrix[0, 0]))


def _sees(camera: Camera, points_world: Float64[Array, "n 3"]) -> Bool[Array, " n"]:
    uv = camera.project(points_world)
    return np.all((uv > -0.5) & (uv < np.array(camera.size_wh) - 0.5), axis=1)
