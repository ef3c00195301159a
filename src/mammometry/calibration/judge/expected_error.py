"""Working volume of the rig, and expected error, mm, of the points that its pairs reconstruct there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from mammometry.base.value import value
from mammometry.calibration.adjust.calibrated import Calibration, ParameterCovariance
from mammometry.calibration.adjust.network import POSE_NAMES_CAMERA, tie_of
from mammometry.calibration.adjust.projection import intrinsics_of, project_with_derivatives
from mammometry.geometry import Array, Bool, Camera, Float64, Int64, Rig
from mammometry.geometry.twist import rigid_motions, without

_STEPS = 9  # points along each side of the working volume


@value(eq=False)
class WorkingVolume:
    """Cube in which skin is expected, as a grid along the world axes."""

    grid_world: Float64[Array, "n n n 3"]
    """Grid points, world frame, mm. Indices along x, y and z."""
    seen: Bool[Array, "n n n"]
    """Points that both cameras of a pair see: the working volume."""
    shown: Bool[Array, "n n n"]
    """Points closer to a target point than to their neighbours: calibrated, not extrapolated."""

    @property
    def spacing_mm(self) -> float:
        """Distance of neighbouring grid points."""
        return float(self.grid_world[1, 0, 0, 0] - self.grid_world[0, 0, 0, 0])

    @property
    def middle_world(self) -> Float64[Array, 3]:
        """Mean position of the target, world, mm."""
        middle: Float64[Array, 3] = self.grid_world.mean(axis=(0, 1, 2))
        return middle

    @property
    def coverage(self) -> float:
        """Share of the seen part that was covered by the target. NaN if no pair sees anything."""
        return float(self.shown[self.seen].mean()) if self.seen.any() else float("nan")


def working_volume(calibration: Calibration) -> WorkingVolume:
    """Compute the volume in which a calibrated rig measures.

    A cube about the mean position of the target, as wide as the images are high there.
    """
    rig = calibration.rig
    placed = [placed.apply(calibration.target_points) for placed in calibration.world_from_target.values()]
    places = np.concatenate(placed)
    centre = np.median([of_pose.mean(axis=0) for of_pose in placed], axis=0)
    reach = float(np.median([_half_height_mm(camera, centre) for camera in rig.cameras.values()]))
    ticks = np.linspace(-reach, reach, _STEPS)
    grid = centre + np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1)
    seen = np.zeros(grid.shape[:3], bool)
    for pair in rig.pairs:
        seen |= sees(pair.left, grid) & sees(pair.right, grid)
    shown = np.asarray(cKDTree(places).query(grid)[0] <= 2 * reach / (_STEPS - 1))
    return WorkingVolume(grid_world=grid, seen=seen, shown=shown)


def middle_world(rig: Rig) -> Float64[Array, 3]:
    """Mean position of the target, world, mm. For imported cameras: where their axes meet."""
    return meeting_point(rig) if rig.target_middle_world is None else rig.target_middle_world


def meeting_point(rig: Rig) -> Float64[Array, 3]:
    """Find the point closest to all optical axes, world, mm. For parallel axes: near the cameras' mean."""
    centres = np.stack([camera.centre_world for camera in rig.cameras.values()])
    across = np.stack([np.eye(3) - np.outer(c.axis_world, c.axis_world) for c in rig.cameras.values()])
    weak = 1e-6 * np.eye(3)
    right = np.einsum("nij,nj->i", across, centres) + weak @ centres.mean(axis=0)
    return np.linalg.solve(across.sum(axis=0) + weak, right)


def sees(camera: Camera, points_world: Float64[Array, "*n 3"]) -> Bool[Array, "*n"]:
    """Mask of the points, mm, inside the camera's image."""
    return in_picture(camera, camera.project(points_world))


def in_picture(camera: Camera, uv: Float64[Array, "*n 2"]) -> Bool[Array, "*n"]:
    """Mask of the pixels inside the camera's image. NaN (points behind the camera) is outside."""
    return np.all((uv > -0.5) & (uv < np.array(camera.size_wh) - 0.5), axis=-1)


def _half_height_mm(camera: Camera, point_world: Float64[Array, 3]) -> float:
    distance_mm = float(np.linalg.norm(point_world - camera.centre_world))
    return distance_mm * min(camera.size_wh) / (2 * float(camera.matrix[0, 0]))


@value(eq=False)
class ExpectedError:
    """Standard deviations of reconstructed points in the working volume, from the calibration alone.

    Rigid motions of all points do not change a shape and are not included. Neither is the overall scale: it depends
    only on the size of the target (``Calibration.scale_std``), and no residual shows it.
    """

    volume: WorkingVolume
    std_mm: Mapping[str, Float64[Array, "n n n"]]
    """Pair → standard deviation of a reconstructed point's distance from the true one (root of the covariance's trace)
    on the volume's grid. NaN if a camera of the pair does not see the point."""

    @property
    def rms_mm(self) -> Mapping[str, float]:
        """Pair → root mean square over the seen part near the target. NaN if there is none.

        Farther away, the cameras are extrapolated, and errors grow without a meaningful bound.
        """
        found = {}
        for pair, std in self.std_mm.items():
            known = std[np.isfinite(std) & self.volume.shown]
            found[pair] = float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")
        return found


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ShapeShifts:
    """Derivatives of reconstructed points by the cameras' parameters, without common motion and scale."""

    volume: WorkingVolume
    names: tuple[str, ...]
    """Names of the cameras' adjusted parameters."""
    columns: tuple[int, ...]
    """Their indices in the calibration's covariance."""
    inside: Mapping[str, Int64[Array, " n"]]
    """Pair → indices of the grid's points that both cameras see."""
    by_parameter: Mapping[str, Float64[Array, "n 3 p"]]
    """Pair → shift of those points, mm, by each parameter."""


def expected_error(calibration: Calibration) -> ExpectedError:
    """Propagate the covariance of the cameras through the pairs' triangulation, by `shape_shifts`."""
    volume = working_volume(calibration)
    std_mm = expected_std_mm(calibration.rig, calibration.covariance, volume.grid_world.reshape(-1, 3))
    shape = volume.seen.shape
    return ExpectedError(volume=volume, std_mm={pair: std.reshape(shape) for pair, std in std_mm.items()})


def shape_shifts(calibration: Calibration) -> ShapeShifts:
    """Derivatives of the pairs' triangulation by the cameras' parameters.

    With parameters θ + dθ, the image points of X give X + dX, where P dX + Q dθ = 0 to first order in least squares,
    and P and Q are the derivatives of both projections: dX = −(PᵀP)⁻¹PᵀQ dθ. The best common motion, rotation and scale
    of all dX are subtracted.
    """
    volume = working_volume(calibration)
    columns, names = _of_cameras(calibration.rig, calibration.covariance)
    inside, by_parameter = _shifts(calibration.rig, names, volume.grid_world.reshape(-1, 3))
    return ShapeShifts(volume=volume, names=names, columns=columns, inside=inside, by_parameter=by_parameter)


def expected_std_mm(
    rig: Rig, covariance: ParameterCovariance, points: Float64[Array, "n 3"]
) -> Mapping[str, Float64[Array, " n"]]:
    """Pair → standard deviation of each point, mm, as in `ExpectedError`. NaN if it is not seen.

    Args:
        rig: cameras and pairs.
        covariance: of the cameras, by their names.
        points: world frame, mm.
    """
    columns, names = _of_cameras(rig, covariance)
    matrix = covariance.matrix[np.ix_(columns, columns)]
    inside, by_parameter = _shifts(rig, names, points)
    std_mm = {}
    for pair, free in by_parameter.items():
        std_mm[pair] = np.full(len(points), np.nan)
        flat = free.reshape(-1, len(columns))  # one matrix product instead of one per point
        std_mm[pair][inside[pair]] = np.sqrt(
            np.sum(((flat @ matrix) * flat).reshape(len(free), 3 * len(columns)), axis=1)
        )
    return std_mm


def _of_cameras(rig: Rig, covariance: ParameterCovariance) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """Columns and names of the cameras' parameters."""
    columns = tuple(i for i, name in enumerate(covariance.names) if name.rpartition(".")[0] in rig.cameras)
    return columns, tuple(covariance.names[i] for i in columns)


def _shifts(
    rig: Rig, names: tuple[str, ...], points: Float64[Array, "n 3"]
) -> tuple[Mapping[str, Int64[Array, " _"]], Mapping[str, Float64[Array, "_ 3 p"]]]:
    """Pair → points that both cameras see, and their shifts by each parameter without the common similarity."""
    parts, seen = [], {}
    for pair in rig.pairs:
        inside = np.flatnonzero(sees(pair.left, points) & sees(pair.right, points))
        by_point, by_parameter = zip(
            *(derivatives(camera, points[inside], names) for camera in (pair.left, pair.right)), strict=True
        )
        p, q = np.concatenate(by_point, axis=1), np.concatenate(by_parameter, axis=1)
        transposed = p.transpose(0, 2, 1)
        parts.append(-np.linalg.solve(transposed @ p, transposed @ q))
        seen[pair.name] = inside
    free = parts
    where = np.concatenate([points[inside] for inside in seen.values()]) if seen else points[:0]
    if len(where):
        ends = np.cumsum([len(inside) for inside in seen.values()])
        free = np.split(_without_similarity(where, np.concatenate(parts)), ends[:-1])
    return seen, dict(zip(seen, free, strict=True))


def derivatives(
    camera: Camera, points: Float64[Array, "n 3"], names: tuple[str, ...]
) -> tuple[Float64[Array, "n 2 3"], Float64[Array, "n 2 p"]]:
    """Derivatives of a camera's projection by points in the world frame and by named parameters."""
    rotation = camera.camera_from_world.rotation
    points_camera = camera.camera_from_world.apply(points)
    projection = project_with_derivatives(points_camera, np.tile(intrinsics_of(camera), (len(points), 1)))
    by_world = projection.by_point @ rotation
    by_rotation = np.cross(points_camera[:, None, :], projection.by_point)
    of_pose = dict(
        zip(POSE_NAMES_CAMERA, np.moveaxis(np.concatenate([by_rotation, -by_world], axis=2), 2, 0), strict=True)
    )
    result = np.zeros((len(points), 2, len(names)))
    for column, name in enumerate(names):
        owner, _, what = name.rpartition(".")
        if owner == camera.name:
            result[:, :, column] = (
                of_pose[what] if what in of_pose else (projection.by_intrinsics @ tie_of([what]))[:, :, 0]
            )
    return by_world, result


def _without_similarity(points: Float64[Array, "n 3"], moved: Float64[Array, "n 3 p"]) -> Float64[Array, "n 3 p"]:
    """Remove the best common motion, rotation and scale from the points' shifts, for each parameter."""
    centred = points - points.mean(axis=0)
    return without(np.concatenate([rigid_motions(centred), centred[:, :, None]], axis=2), moved)
