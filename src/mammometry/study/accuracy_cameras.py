"""Calibrated cameras against the true ones.

Cameras know no absolute frame, so they are first moved rigidly onto the true ones, such that they see the working
volume as nearly alike as they can; what is left is the calibration's error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from mammometry.base.value import value
from mammometry.geometry import Array, Camera, Float64, Rig, StereoPair, Transform, TriangleMesh
from mammometry.study.rays import inside

_GRID = 7  # points along each side of the working volume
_MARGIN = 1.2  # of the working volume around the subject's bounding box
_TRIANGULATION_STEPS = 6  # of Gauss and Newton's method


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraAccuracy:
    """One camera's error after the rig's rigid alignment."""

    projection_rms_px: float
    """Root mean square distance between calibrated and true projections over the working volume, px."""
    centre_mm: float
    """Distance between calibrated and true perspective centre, mm."""
    focal_percent: float
    """Error of the focal length (mean of fx and fy), %."""


@value(eq=False)
class RigAccuracy:
    """The whole rig's error after rigid alignment."""

    cameras: Mapping[str, CameraAccuracy]
    """By name. Read-only."""
    triangulation_rms_mm: Mapping[str, float]
    """Pair → root mean square distance between true points and those triangulated from their true projections, mm."""
    projection_rms_px: float
    """Root mean square over all cameras."""
    rig_from_world: Transform
    """The alignment."""

    @property
    def centre_rms_mm(self) -> float:
        """Root mean square error of the perspective centres, mm."""
        return float(np.sqrt(np.mean([camera.centre_mm**2 for camera in self.cameras.values()])))

    @property
    def focal_worst_percent(self) -> float:
        """The largest error of a focal length, with its sign, %."""
        return max((camera.focal_percent for camera in self.cameras.values()), key=abs)

    @property
    def worst_pair(self) -> tuple[str, float]:
        """The pair that triangulates worst, and its error, mm."""
        return max(self.triangulation_rms_mm.items(), key=lambda pair: pair[1])


def working_volume(mesh: TriangleMesh) -> Float64[Array, "n 3"]:
    """A grid of 7³ points over the subject's bounding box grown by a fifth, mesh frame, mm."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    middle, half = (low + high) / 2, _MARGIN * (high - low) / 2
    axes = [np.linspace(centre - reach, centre + reach, _GRID) for centre, reach in zip(middle, half, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def compare_rigs(calibrated: Rig, true: Rig, points_rig: Float64[Array, "n 3"]) -> RigAccuracy:
    """Compare calibrated cameras with the true ones over the working volume.

    Args:
        calibrated: in any frame, mm.
        true: the true cameras of the same names, rig frame, mm.
        points_rig: the working volume; each camera is judged at those of them in its true frame.

    Raises:
        ValueError: a camera has no point in its frame, or a pair has none in common.
    """
    names = [name for name in calibrated.cameras if name in true.cameras]
    pixels = {name: true.cameras[name].project(points_rig) for name in names}
    seen = {name: inside(true.cameras[name], pixels[name]) for name in names}
    for name in names:
        if not seen[name].any():
            raise ValueError(f"camera {name} sees nothing of the working volume")
    rig_from_world = _aligned(calibrated, true, names, points_rig, pixels, seen)
    points_world = rig_from_world.inverse().apply(points_rig)

    cameras, squares = {}, []
    for name in names:
        camera, truth = calibrated.cameras[name], true.cameras[name]
        gaps = np.linalg.norm(camera.project(points_world[seen[name]]) - pixels[name][seen[name]], axis=1)
        squares.append(gaps**2)
        focal, true_focal = (float(np.diag(camera_model.matrix)[:2].mean()) for camera_model in (camera, truth))
        cameras[name] = CameraAccuracy(
            projection_rms_px=float(np.sqrt(np.mean(gaps**2))),
            centre_mm=float(np.linalg.norm(rig_from_world.apply(camera.centre_world) - truth.centre_world)),
            focal_percent=100 * (focal / true_focal - 1),
        )
    triangulation = {}
    for pair in calibrated.pairs:
        left, right = pair.left.name, pair.right.name
        both = seen[left] & seen[right]
        if not both.any():
            raise ValueError(f"pair {pair.name} sees nothing of the working volume with both cameras")
        found = triangulate(pair, pixels[left][both], pixels[right][both])
        gaps = np.linalg.norm(found - points_world[both], axis=1)
        triangulation[pair.name] = float(np.sqrt(np.mean(gaps**2)))
    return RigAccuracy(
        cameras=cameras,
        triangulation_rms_mm=triangulation,
        projection_rms_px=float(np.sqrt(np.mean(np.concatenate(squares)))),
        rig_from_world=rig_from_world,
    )


def triangulate(
    pair: StereoPair, left_uv: Float64[Array, "n 2"], right_uv: Float64[Array, "n 2"]
) -> Float64[Array, "n 3"]:
    """Points with projections nearest to given pixels of both pictures. World frame, mm (Gauss–Newton)."""
    origins = np.stack([pair.left.centre_world, pair.right.centre_world])
    rays = np.stack([pair.left.rays_world(left_uv), pair.right.rays_world(right_uv)], axis=1)
    across = np.eye(3) - rays[..., :, None] * rays[..., None, :]  # the midpoint of both rays is the start
    points = np.linalg.solve(across.sum(axis=1), np.einsum("nkij,kj->ni", across, origins)[..., None])[..., 0]
    for _ in range(_TRIANGULATION_STEPS):
        gaps = np.concatenate([pair.left.project(points) - left_uv, pair.right.project(points) - right_uv], axis=1)
        slopes = np.concatenate([_slopes(pair.left, points), _slopes(pair.right, points)], axis=1)
        normal = np.einsum("nki,nkj->nij", slopes, slopes)
        points = points - np.linalg.solve(normal, np.einsum("nki,nk->ni", slopes, gaps)[..., None])[..., 0]
    return points


def _slopes(camera: Camera, points: Float64[Array, "n 3"], step_mm: float = 1e-3) -> Float64[Array, "n 2 3"]:
    """Derivatives of the projection by the point, px/mm, by central differences."""
    offsets = step_mm * np.eye(3)
    return np.stack(
        [(camera.project(points + offset) - camera.project(points - offset)) / (2 * step_mm) for offset in offsets],
        axis=-1,
    )


def _aligned(
    calibrated: Rig,
    true: Rig,
    names: list[str],
    points_rig: Float64[Array, "n 3"],
    pixels: Mapping[str, Array],
    seen: Mapping[str, Array],
) -> Transform:
    """rig_from_world that brings the projections together. From centres and axes, then least squares."""
    reach = float(np.linalg.norm(np.ptp(points_rig, axis=0)))
    here, there = (
        np.concatenate(
            [
                [rig.cameras[name].centre_world + (axis * reach) * rig.cameras[name].camera_from_world.rotation[row]]
                for name in names
                for axis, row in ((0, 2), (1, 0), (1, 1), (1, 2))
            ]
        )
        for rig in (calibrated, true)
    )
    start = rigid(here, there)
    middle = points_rig.mean(axis=0)

    def placed(small: Float64[Array, 6]) -> Transform:
        turn = Transform.from_rotation_vector(small[:3] / reach, np.zeros(3))
        about = Transform(rotation=turn.rotation.copy(), translation_mm=middle - turn.rotate(middle) + small[3:])
        return about @ start

    def gaps(small: Float64[Array, 6]) -> Float64[Array, " k"]:
        points_world = placed(small).inverse().apply(points_rig)
        return np.concatenate(
            [(calibrated.cameras[name].project(points_world) - pixels[name])[seen[name]].ravel() for name in names]
        )

    return placed(least_squares(gaps, np.zeros(6), x_scale="jac").x)


def rigid(a: Float64[Array, "n 3"], b: Float64[Array, "n 3"]) -> Transform:
    """b_from_a: rigid motion of points a onto points b (Kabsch 1976)."""
    mean_a, mean_b = a.mean(axis=0), b.mean(axis=0)
    u, _, vt = np.linalg.svd((b - mean_b).T @ (a - mean_a))
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return Transform(rotation=rotation, translation_mm=mean_b - rotation @ mean_a)
