"""Compare a measured surface, volume or rig with the true one of a simulated or rendered capture.

Only studies and tests use it: no measuring code may import it. Cameras have no absolute frame, so they are first
aligned rigidly with the true ones over the working volume. The remaining difference is the calibration's error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from mammometry.base.normal import MAD
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Camera, Float64, Int64, Rig, StereoPair, Transform, TriangleMesh
from mammometry.geometry.nearest import closest_on_mesh
from mammometry.study.rays import inside

COMPLETE_MM = 0.5
"""Largest distance from the measured surface at which a true point counts as measured, mm."""
_ALIGN_POINTS = 20_000  # number of vertices used to align two surfaces
_ALIGN_ROUNDS = 4  # most iterations
_ALIGNED_MM = 1e-4  # displacement by the last iteration, at most
_TANGENT_MM = 1.0  # largest distance at which the distance from the nearest face's plane is used


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceAccuracy:
    """Distances of true points from a measured surface, mm, weighted by the points' areas."""

    mean_mm: float
    """Mean unsigned distance of the true points from the measured surface."""
    median_mm: float
    """Median of the same."""
    rms_mm: float
    """Root mean square of the same."""
    p95_mm: float
    """95th percentile of the same."""
    bias_mm: float
    """Mean signed distance, positive if the measured surface is outside the true one."""
    complete_percent: float
    """Share of the true area with measured surface within `COMPLETE_MM`."""
    volume_bias_cc: float
    """Volume between the surfaces: the signed distance integrated over the evaluated area, cc."""
    points: int
    """Number of true points compared."""
    claimed_percent: float = 100.0
    """Share of the true area that the measurement claims as skin. The other figures are for this part."""


@value(eq=False)
class ErrorMap:
    """Distance of a measured surface from the truth at each vertex."""

    signed_mm: Float64[Array, " n"]
    """Distance of each measured vertex from the true surface, mm, positive outside; NaN if not evaluated."""
    judged: Bool[Array, " n"]
    """Vertices that are evaluated, because their closest true vertex should have been measured."""
    stray_percent: float
    """Share of the evaluated vertices farther than `COMPLETE_MM` from the truth."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VolumeAccuracy:
    """A measured volume compared with the true one."""

    measured_cc: float
    true_cc: float
    covered: bool | None
    """Whether the 95 % interval contains the true volume. None without an interval."""

    @property
    def error_cc(self) -> float:
        """Measured minus true, cc."""
        return self.measured_cc - self.true_cc

    @property
    def error_percent(self) -> float:
        """The error in per cent of the true volume."""
        return 100 * self.error_cc / self.true_cc


def vertex_areas_mm2(mesh: TriangleMesh) -> Float64[Array, " n"]:
    """Area of each vertex, a third of each of its faces, mm²."""
    areas = np.linalg.norm(mesh.face_vectors(), axis=1)
    shares: Float64[Array, " n"] = np.bincount(mesh.faces.ravel(), np.repeat(areas / 3, 3), len(mesh.vertices))
    return shares


def compare_surfaces(
    measured: TriangleMesh,
    truth: TriangleMesh,
    *,
    at: Int64[Array, " k"] | None = None,
    truth_from_measured: Transform | None = None,
    claimed: Bool[Array, " n"] | None = None,
) -> SurfaceAccuracy:
    """Distances of points of the true surface from a measured one.

    Args:
        measured: the surface under test, mm.
        truth: the true surface, its faces counter-clockwise seen from outside.
        at: vertices of `truth` that should be measured, for example those that two cameras see; None: all.
        truth_from_measured: pose of the measured surface; None if both are in the same frame.
        claimed: vertices of the measured surface that count as skin. True points nearest to others are excluded.

    Raises:
        ValueError: there is nothing to compare.
    """
    chosen = np.arange(len(truth.vertices)) if at is None else at
    if not len(chosen) or not len(measured.faces):
        raise ValueError(f"nothing to compare: {len(chosen)} true points, {len(measured.faces)} measured triangles")
    points, normals = truth.vertices[chosen], truth.vertex_normals()[chosen]
    if truth_from_measured is not None:
        back = truth_from_measured.inverse()
        points, normals = back.apply(points), back.rotate(normals)
    area = vertex_areas_mm2(truth)
    found = closest_on_mesh(points, measured)
    kept = np.ones(len(points), bool) if claimed is None else claimed[measured.faces[found.faces]].sum(axis=1) >= 2
    if not kept.any():
        raise ValueError("nothing to compare: the measured surface claims no skin there")
    weight = area[chosen][kept] / area[chosen][kept].sum()
    outwards = np.einsum("ij,ij->i", found.points - points, normals)[kept]
    distance = found.distances_mm[kept]
    bias_mm = float(weight @ np.where(outwards > 0, distance, -distance))
    order = np.argsort(distance)
    cumulated = np.cumsum(weight[order])
    median, p95 = (float(distance[order][min(int(np.searchsorted(cumulated, q)), len(order) - 1)]) for q in (0.5, 0.95))
    return SurfaceAccuracy(
        mean_mm=float(weight @ distance),
        median_mm=median,
        rms_mm=float(np.sqrt(weight @ distance**2)),
        p95_mm=p95,
        bias_mm=bias_mm,
        complete_percent=float(100 * weight @ (distance <= COMPLETE_MM)),
        volume_bias_cc=bias_mm * float(area[chosen][kept].sum()) / 1000,
        points=len(distance),
        claimed_percent=float(100 * area[chosen][kept].sum() / area[chosen].sum()),
    )


def align_surfaces(measured: TriangleMesh, truth: TriangleMesh, at: Int64[Array, " k"]) -> Transform:
    """Rigid motion of a measured surface onto the true one, by point-to-plane ICP with Huber's weights.

    Args:
        measured: the surface under test, mm, a few mm from its place at most.
        truth: the true surface.
        at: vertices of `truth` that should be measured.
    """
    chosen = at[:: max(1, len(at) // _ALIGN_POINTS)]
    points, normals = truth.vertices[chosen], truth.vertex_normals()[chosen]
    middle = points.mean(axis=0)
    measured_from_truth = Transform.identity()
    for _ in range(_ALIGN_ROUNDS):
        here, facing = measured_from_truth.apply(points), measured_from_truth.rotate(normals)
        gap = np.einsum("ij,ij->i", closest_on_mesh(here, measured).points - here, facing)
        scale = max(MAD * float(np.median(np.abs(gap))), 1e-6)
        weight = np.minimum(1.0, 2.0 * scale / np.maximum(np.abs(gap), 1e-12))
        origin = measured_from_truth.apply(middle)
        design = np.concatenate([np.cross(here - origin, facing), facing], axis=1)
        # The pseudo-inverse keeps undetermined motions at zero, such as rotations of a sphere and translations of a
        # plane.
        step = np.linalg.pinv(design.T @ (weight[:, None] * design), rcond=1e-9) @ (design.T @ (weight * gap))
        turn = Transform.from_rotation_vector(step[:3], np.zeros(3))
        about = Transform(rotation=turn.rotation.copy(), translation_mm=origin - turn.rotate(origin) + step[3:])
        measured_from_truth = about @ measured_from_truth
        if np.linalg.norm(step[3:]) < _ALIGNED_MM:
            break
    return measured_from_truth.inverse()


def map_errors(
    measured: TriangleMesh, truth: TriangleMesh, seen: Bool[Array, " m"], *, truth_from_measured: Transform
) -> ErrorMap:
    """Signed distance of each measured vertex from the true surface, to about 0.01 mm, for figures.

    Near the true surface, this is the distance from the tangent plane at the closest true vertex. Farther away, it is
    the distance from that vertex.

    Args:
        measured: the surface under test.
        truth: the true surface, with vertices about every half millimetre.
        seen: its vertices that should have been measured.
        truth_from_measured: motion of the measured surface onto the true one.
    """
    points = truth_from_measured.apply(measured.vertices)
    distance, nearest = (np.asarray(found) for found in cKDTree(truth.vertices).query(points))
    height = np.einsum("ij,ij->i", points - truth.vertices[nearest], truth.vertex_normals()[nearest])
    judged = seen[nearest]
    signed_mm = np.where(distance <= _TANGENT_MM, height, np.copysign(distance, height))
    stray = float(100 * np.mean(np.abs(signed_mm[judged]) > COMPLETE_MM)) if judged.any() else float("nan")
    return ErrorMap(signed_mm=np.where(judged, signed_mm, np.nan), judged=judged, stray_percent=stray)


def compare_volumes(
    measured_cc: float, true_cc: float, interval_cc: tuple[float, float] | None = None
) -> VolumeAccuracy:
    """Compare a measured volume, and its 95 % interval if there is one, with the true volume. All in cc."""
    covered = None if interval_cc is None else bool(interval_cc[0] <= true_cc <= interval_cc[1])
    return VolumeAccuracy(measured_cc=measured_cc, true_cc=true_cc, covered=covered)


_GRID = 7  # points along each side of the working volume
_MARGIN = 1.2  # size of the working volume, relative to the subject's bounding box
_TRIANGULATION_STEPS = 6  # Gauss–Newton iterations


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraAccuracy:
    """Error of one camera after the rig's rigid alignment."""

    projection_rms_px: float
    """RMS distance between calibrated and true projections over the working volume, px."""
    centre_mm: float
    """Distance between calibrated and true perspective centre, mm."""
    focal_percent: float
    """Error of the focal length (mean of fx and fy), %."""


@value(eq=False)
class RigAccuracy:
    """Error of the whole rig after rigid alignment."""

    cameras: Mapping[str, CameraAccuracy]
    """Camera → error. Read-only."""
    triangulation_rms_mm: Mapping[str, float]
    """Pair → RMS distance between true points and those triangulated from their true projections, mm."""
    projection_rms_px: float
    """RMS over all cameras, px."""
    rig_from_world: Transform
    """The alignment."""

    @property
    def centre_rms_mm(self) -> float:
        """RMS error of the perspective centres, mm."""
        return float(np.sqrt(np.mean([camera.centre_mm**2 for camera in self.cameras.values()])))

    @property
    def focal_worst_percent(self) -> float:
        """Largest error of a focal length, with its sign, %."""
        return max((camera.focal_percent for camera in self.cameras.values()), key=abs)

    @property
    def worst_pair(self) -> tuple[str, float]:
        """Pair with the largest triangulation error, and that error, mm."""
        return max(self.triangulation_rms_mm.items(), key=lambda pair: pair[1])


def working_volume(mesh: TriangleMesh) -> Float64[Array, "n 3"]:
    """Grid of 7³ points over the subject's bounding box, enlarged by a fifth, mesh frame, mm."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    middle, half = (low + high) / 2, _MARGIN * (high - low) / 2
    axes = [np.linspace(centre - reach, centre + reach, _GRID) for centre, reach in zip(middle, half, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def compare_rigs(calibrated: Rig, true: Rig, points_rig: Float64[Array, "n 3"]) -> RigAccuracy:
    """Errors of calibrated cameras over the working volume.

    Args:
        calibrated: in any frame, mm.
        true: the true cameras with the same names, rig frame, mm.
        points_rig: the working volume; each camera is evaluated at the points in its true image.

    Raises:
        ValueError: a camera has no point in its image, or a pair has none in common.
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
        found = nearest_points(pair, pixels[left][both], pixels[right][both])
        gaps = np.linalg.norm(found - points_world[both], axis=1)
        triangulation[pair.name] = float(np.sqrt(np.mean(gaps**2)))
    return RigAccuracy(
        cameras=cameras,
        triangulation_rms_mm=triangulation,
        projection_rms_px=float(np.sqrt(np.mean(np.concatenate(squares)))),
        rig_from_world=rig_from_world,
    )


def nearest_points(
    pair: StereoPair, left_uv: Float64[Array, "n 2"], right_uv: Float64[Array, "n 2"]
) -> Float64[Array, "n 3"]:
    """Points whose projections are closest to given pixels in both images, world frame, mm (Gauss–Newton)."""
    origins = np.stack([pair.left.centre_world, pair.right.centre_world])
    rays = np.stack([pair.left.rays_world(left_uv), pair.right.rays_world(right_uv)], axis=1)
    across = np.eye(3) - rays[..., :, None] * rays[..., None, :]  # start at the midpoint of both rays
    points = np.linalg.solve(across.sum(axis=1), np.einsum("nkij,kj->ni", across, origins)[..., None])[..., 0]
    for _ in range(_TRIANGULATION_STEPS):
        gaps = np.concatenate([pair.left.project(points) - left_uv, pair.right.project(points) - right_uv], axis=1)
        slopes = np.concatenate([_slopes(pair.left, points), _slopes(pair.right, points)], axis=1)
        normal = np.einsum("nki,nkj->nij", slopes, slopes)
        points = points - np.linalg.solve(normal, np.einsum("nki,nk->ni", slopes, gaps)[..., None])[..., 0]
    return points


def _slopes(camera: Camera, points: Float64[Array, "n 3"], step_mm: float = 1e-3) -> Float64[Array, "n 2 3"]:
    """Derivatives of the projection with respect to the point, px/mm, by central differences."""
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
    """rig_from_world that aligns the projections: first from centres and axes, then by least squares."""
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
    """b_from_a: least-squares rigid motion of points a onto points b (Kabsch 1976)."""
    mean_a, mean_b = a.mean(axis=0), b.mean(axis=0)
    u, _, vt = np.linalg.svd((b - mean_b).T @ (a - mean_a))
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return Transform(rotation=rotation, translation_mm=mean_b - rotation @ mean_a)
