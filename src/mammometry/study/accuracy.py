"""A measured surface or volume against a capture's truth.

The capture is simulated or rendered. For studies and tests only: nothing that measures may import it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Float64, Int64, Transform, TriangleMesh
from mammometry.geometry.nearest import closest_on_mesh

COMPLETE_MM = 0.5
"""A true point with measured surface nearer than this counts as measured."""
_ALIGN_POINTS = 20_000  # vertices by which two surfaces are aligned
_ALIGN_ROUNDS = 4  # at most, and no more once a step is shorter than the next
_ALIGNED_MM = 1e-4  # a shorter step ends the alignment
_TANGENT_MM = 1.0  # farther away, the height over the nearest face is no distance


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceAccuracy:
    """Distances of true points from a measured surface, mm. Weighted by the true points' area."""

    mean_mm: float
    """Mean unsigned distance of the true points from the measured surface."""
    median_mm: float
    """Median of the same."""
    rms_mm: float
    """Root mean square of the same."""
    p95_mm: float
    """95th percentile of the same."""
    bias_mm: float
    """Mean signed distance: positive where the measured surface lies outside the true one."""
    complete_percent: float
    """Share of the true area with measured surface within `COMPLETE_MM`."""
    volume_bias_cc: float
    """Volume between the two surfaces, the signed distance integrated over the judged area, cc."""
    points: int
    """Number of true points compared."""
    claimed_percent: float = 100.0
    """Share of the true area that the measurement claims to know. The other figures are of this part."""


@value(eq=False)
class ErrorMap:
    """A measured surface's own distance from the truth, vertex by vertex."""

    signed_mm: Float64[Array, " n"]
    """Distance of each measured vertex from the true surface, mm. Positive outside, NaN where not judged."""
    judged: Bool[Array, " n"]
    """Vertices whose closest true vertex ought to have been measured."""
    stray_percent: float
    """Share of the judged vertices that lie farther than `COMPLETE_MM` from the truth."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VolumeAccuracy:
    """A measured volume beside the true one."""

    measured_cc: float
    true_cc: float
    covered: bool | None
    """Whether the 95 % interval holds the truth. None without an interval."""

    @property
    def error_cc(self) -> float:
        """Measured less true, cc."""
        return self.measured_cc - self.true_cc

    @property
    def error_percent(self) -> float:
        """The error in per cent of the truth."""
        return 100 * self.error_cc / self.true_cc


def vertex_areas_mm2(mesh: TriangleMesh) -> Float64[Array, " n"]:
    """Area of each vertex: a third of each of its faces, mm²."""
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
    """Judge a measured surface at points of the true one.

    Args:
        measured: the surface under test, mm.
        truth: the true surface, its faces counter-clockwise seen from outside.
        at: vertices of `truth` that ought to be there (for example those that two cameras see); None for all.
        truth_from_measured: where the measured surface belongs; None if both are in one frame.
        claimed: vertices of the measured surface that are said to be skin. True points nearest to others are left out.

    Raises:
        ValueError: nothing is left to compare.
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
    """Move a measured surface rigidly onto the truth: closest points, point to plane, Huber's weights.

    Args:
        measured: the surface under test, mm, within a few mm of its place.
        truth: the true surface.
        at: vertices of `truth` that ought to be there.

    Returns:
        truth_from_measured.
    """
    chosen = at[:: max(1, len(at) // _ALIGN_POINTS)]
    points, normals = truth.vertices[chosen], truth.vertex_normals()[chosen]
    middle = points.mean(axis=0)
    measured_from_truth = Transform.identity()
    for _ in range(_ALIGN_ROUNDS):
        here, facing = measured_from_truth.apply(points), measured_from_truth.rotate(normals)
        gap = np.einsum("ij,ij->i", closest_on_mesh(here, measured).points - here, facing)
        scale = max(1.4826 * float(np.median(np.abs(gap))), 1e-6)
        weight = np.minimum(1.0, 2.0 * scale / np.maximum(np.abs(gap), 1e-12))
        origin = measured_from_truth.apply(middle)
        design = np.concatenate([np.cross(here - origin, facing), facing], axis=1)
        # The pseudo-inverse leaves alone what nothing determines: a sphere's rotation, a plane's drift.
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
    """Signed distance of each measured vertex from the true surface, mm.

    For a picture: good to some hundredths of a mm. Near the truth it is the distance from the tangent plane at the
    closest true vertex, farther away the distance from that vertex itself.

    Args:
        measured: the surface under test.
        truth: the true surface, with vertices every half millimetre or so.
        seen: its vertices that ought to have been measured.
        truth_from_measured: where the measured surface belongs.
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
    """Compare a measured volume and its 95 % interval, if any, with the true one, all in cc."""
    covered = None if interval_cc is None else bool(interval_cc[0] <= true_cc <= interval_cc[1])
    return VolumeAccuracy(measured_cc=measured_cc, true_cc=true_cc, covered=covered)
