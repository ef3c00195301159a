"""Working volume: points seen by both cameras of some pair. They are where the target was held."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from mammometry.base.value import value
from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.geometry.camera import Camera, Rig


@value(eq=False)
class WorkingVolume:
    """Cube in which skin is expected, as a grid along world axes."""

    grid_world: Float64[Array, "n n n 3"]
    """Grid points, world frame, mm. Indices along x, y and z."""
    seen: Bool[Array, "n n n"]
    """Points that both cameras of a pair see: the working volume."""
    shown: Bool[Array, "n n n"]
    """Points nearer to a target point than to their neighbours: calibrated, and not only extrapolated."""

    @property
    def spacing_mm(self) -> float:
        """Distance of neighbouring grid points."""
        return float(self.grid_world[1, 0, 0, 0] - self.grid_world[0, 0, 0, 0])

    @property
    def middle_world(self) -> Float64[Array, 3]:
        """Middle of the places where the target was held, world, mm."""
        middle: Float64[Array, 3] = self.grid_world.mean(axis=(0, 1, 2))
        return middle

    @property
    def coverage(self) -> float:
        """Share of what is seen that was shown. NaN where no pair sees anything."""
        return float(self.shown[self.seen].mean()) if self.seen.any() else float("nan")


def working_volume(calibration: Calibration, *, steps: int = 9) -> WorkingVolume:
    """Compute the volume in which a calibrated rig measures.

    A cube about the middle of the places where the target was held, as wide as the cameras' pictures are high there.
    """
    rig = calibration.rig
    placed = [placed.apply(calibration.target_points) for placed in calibration.world_from_target.values()]
    places = np.concatenate(placed)
    centre = np.median([of_pose.mean(axis=0) for of_pose in placed], axis=0)
    reach = float(np.median([_half_height_mm(camera, centre) for camera in rig.cameras.values()]))
    ticks = np.linspace(-reach, reach, steps)
    grid = centre + np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1)
    seen = np.zeros(grid.shape[:3], bool)
    for pair in rig.pairs:
        seen |= sees(pair.left, grid) & sees(pair.right, grid)
    shown = np.asarray(cKDTree(places).query(grid)[0] <= 2 * reach / (steps - 1))
    return WorkingVolume(grid_world=grid, seen=seen, shown=shown)


def middle_world(rig: Rig) -> Float64[Array, 3]:
    """Middle of the target's places, world, mm. Of imported cameras: where their axes meet."""
    return meeting_point(rig) if rig.target_middle_world is None else rig.target_middle_world


def meeting_point(rig: Rig) -> Float64[Array, 3]:
    """Find the point nearest to all optical axes, world, mm. For parallel ones near the cameras' mean."""
    centres = np.stack([camera.centre_world for camera in rig.cameras.values()])
    across = np.stack([np.eye(3) - np.outer(c.axis_world, c.axis_world) for c in rig.cameras.values()])
    weak = 1e-6 * np.eye(3)
    right = np.einsum("nij,nj->i", across, centres) + weak @ centres.mean(axis=0)
    return np.linalg.solve(across.sum(axis=0) + weak, right)


def sees(camera: Camera, points_world: Float64[Array, "*n 3"]) -> Bool[Array, "*n"]:
    """Tell which points, mm, fall into the camera's picture."""
    uv = camera.project(points_world)
    return np.all((uv > -0.5) & (uv < np.array(camera.size_wh) - 0.5), axis=-1)  # NaN, behind it: false


def _half_height_mm(camera: Camera, point_world: Float64[Array, 3]) -> float:
    distance_mm = float(np.linalg.norm(point_world - camera.centre_world))
    return distance_mm * min(camera.size_wh) / (2 * float(camera.matrix[0, 0]))
