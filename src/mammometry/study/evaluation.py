"""Compare all results of a session with the truth, stage by stage."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from mammometry.base.errors import SessionError
from mammometry.base.progress import Progress, no_progress, part
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Float64, Rig, Transform, TriangleMesh
from mammometry.geometry.curves import closed_length_mm, evenly_spaced
from mammometry.matching.dense.match import DisparityMap
from mammometry.matching.foreground.foreground import Foreground
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.study.accuracy import (
    ErrorMap,
    RigAccuracy,
    SurfaceAccuracy,
    VolumeAccuracy,
    align_surfaces,
    compare_rigs,
    compare_surfaces,
    compare_volumes,
    map_errors,
    working_volume,
)
from mammometry.study.accuracy_matching import (
    MatchingAccuracy,
    RangeAccuracy,
    SilhouetteAccuracy,
    judge_disparity,
    judge_range,
    judge_silhouette,
    silhouette_overlap,
    true_disparity,
)
from mammometry.study.rays import RayScene, seen_by_pairs
from mammometry.study.tables import plain
from mammometry.surface.ranges.range_image import RangeImage


@value(eq=False)
class Truth:
    """True values of a capture, mm, rig frame."""

    rig: Rig
    """The cameras that took the photographs, and their pairs."""
    rig_from_target: Mapping[str, Transform]
    """Pose → placement of the calibration target. Empty if unknown."""
    mesh: TriangleMesh
    """Surface of the subject, in its pose."""
    volumes_cc: Mapping[str, float]
    """``model``, or the patient's ``left`` and ``right`` → true volume, cc. May be empty."""
    boundaries: Mapping[str, Float64[Array, "n 3"]]
    """The same names → true closed boundary. May be empty."""


_STEP_MM = 0.1  # spacing of points on a compared curve: far below its errors


@dataclass(frozen=True, slots=True, kw_only=True)
class BoundaryAccuracy:
    """Distances between two closed curves, mm."""

    mean_mm: float
    """Mean distance of the measured curve from the true one."""
    p95_mm: float
    """95th percentile of the same."""
    worst_mm: float
    """Hausdorff distance of the curves."""
    height_bias_mm: float
    """Mean height of the measured curve above the true one, along the normal of the true curve's best plane, mm. For a
    cast, 0.1 mm is about 1 cc."""


def compare_boundaries(
    measured: Float64[Array, "n 3"], truth: Float64[Array, "m 3"], towards_front: Float64[Array, 3]
) -> BoundaryAccuracy:
    """Distances between two closed curves in one frame, mm.

    Args:
        measured: the curve under test. Its first point is not repeated.
        truth: the true curve.
        towards_front: approximate direction of the subject's front, which determines the sign of the height.
    """
    dense, true_dense = resampled(measured), resampled(truth)
    distance, back = curve_distances(dense, true_dense)
    nearest = cKDTree(true_dense).query(dense)[1]
    normal = np.linalg.svd(true_dense - true_dense.mean(axis=0), full_matrices=False)[2][2]
    normal *= 1.0 if normal @ towards_front >= 0 else -1.0
    return BoundaryAccuracy(
        mean_mm=float(distance.mean()),
        p95_mm=float(np.percentile(distance, 95)),
        worst_mm=float(max(distance.max(), back.max())),
        height_bias_mm=float(((dense - true_dense[nearest]) @ normal).mean()),
    )


def curve_distances(
    first: Float64[Array, "n 3"], second: Float64[Array, "m 3"]
) -> tuple[Float64[Array, " n"], Float64[Array, " m"]]:
    """Distance of each point of two dense curves from the other curve, mm."""
    return np.asarray(cKDTree(second).query(first)[0]), np.asarray(cKDTree(first).query(second)[0])


def resampled(curve: Float64[Array, "n 3"], step_mm: float = _STEP_MM) -> Float64[Array, "k 3"]:
    """Resample a closed curve at `step_mm` or slightly less."""
    return evenly_spaced(curve, max(3, int(np.ceil(closed_length_mm(curve) / step_mm))))


_POINTS = 60_000  # number of true points at which a surface is evaluated
_OTHER_RIG_SHARE = 0.02  # RMS projection error, relative to the image width, above which the rig is a different one
_OTHER_SUBJECT_OVERLAP = 0.95  # overlap (intersection over union) of silhouettes below which the subject may differ
_OTHER_SUBJECT_MM = 3.0  # median distance of the surface from which the subject may differ
_REMEDY = "Name the truth of this session with --truth, or measure the session again"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SessionResults:
    """Existing results of a session, mm, world frame. Large values are loaded on call."""

    rig: Rig
    """The calibrated cameras."""
    world_from_target: Mapping[str, Transform]
    """Pose → placement of the calibration target. Empty for imported cameras."""
    foregrounds: Mapping[str, Callable[[], Foreground]]
    """Camera → its silhouette."""
    disparities: Mapping[str, Callable[[], DisparityMap]]
    """Pair → its disparities."""
    ranges: Mapping[str, Callable[[], RangeImage]]
    """Pair → its range image."""
    surfaces: Mapping[str, TriangleMesh]
    """``first`` and ``repaired``, in this order."""
    claimed: Bool[Array, " n"] | None
    """Vertices that the repaired surface claims as skin. None without a repaired surface."""
    boundaries: Sequence[Boundary]
    measurements: Sequence[VolumeMeasurement]
    absent: Sequence[str] = ()
    """Sides on which the measurement found no breast."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceJudgement:
    """Errors of one surface, as measured and after alignment with the truth."""

    unaligned: SurfaceAccuracy
    claimed: SurfaceAccuracy | None
    """Errors as measured, only where the surface claims skin. None for the first surface."""
    aligned: SurfaceAccuracy
    """Errors after ICP alignment: shape alone."""
    aligned_by_mm: float
    """Shift of the subject's centre by the alignment, mm."""
    aligned_by_deg: float
    """Rotation by the alignment, degrees."""
    stray_percent: float
    """Share of the vertices on skin seen by a pair that are more than 0.5 mm from the true surface."""


@value(eq=False)
class Evaluation:
    """Errors of the instrument by stage. Empty for stages without current results."""

    frame: str
    """How the truth was transformed to the world frame."""
    cameras: RigAccuracy
    silhouettes: Mapping[str, SilhouetteAccuracy | None]
    """Camera → error of its silhouette. None without a contour."""
    matching: Mapping[str, MatchingAccuracy | None]
    """Pair → error of its disparities. None if no evaluated pixel was matched."""
    ranges: Mapping[str, RangeAccuracy | None]
    surfaces: Mapping[str, SurfaceJudgement]
    boundaries: Mapping[str, BoundaryAccuracy]
    volumes: Mapping[str, VolumeAccuracy]
    intervals_cc: Mapping[str, tuple[float, float] | None]
    """Breast → 95 % interval of the result."""
    absent_cc: Mapping[str, float]
    """Side on which no breast was found → its true volume, cc. 0 if there is indeed none."""
    error_map: ErrorMap | None
    """Errors at each vertex of the latest surface."""

    def as_table(self) -> dict[str, Any]:
        """All figures as data for JSON, with null for unknown ones."""
        pair, worst_mm = self.cameras.worst_pair
        table: dict[str, Any] = plain(
            {
                "frame": self.frame,
                "calibration": {
                    "projection_rms_px": self.cameras.projection_rms_px,
                    "centre_rms_mm": self.cameras.centre_rms_mm,
                    "focal_worst_percent": self.cameras.focal_worst_percent,
                    "worst_pair": pair,
                    "worst_pair_triangulation_mm": worst_mm,
                    "triangulation_rms_mm": dict(self.cameras.triangulation_rms_mm),
                    "cameras": {name: asdict(camera) for name, camera in self.cameras.cameras.items()},
                },
                "silhouettes": _tables(self.silhouettes),
                "matching": _tables(self.matching),
                "ranges": _tables(self.ranges),
                "surfaces": _tables(self.surfaces),
                "boundaries": _tables(self.boundaries),
                "volumes": {
                    name: {
                        **asdict(volume),
                        "error_cc": volume.error_cc,
                        "error_percent": volume.error_percent,
                        "interval_cc": self.intervals_cc[name],
                    }
                    for name, volume in self.volumes.items()
                },
                "no_breast": {name: {"true_cc": true_cc} for name, true_cc in self.absent_cc.items()},
            }
        )
        return table


def evaluate(results: SessionResults, truth: Truth, *, progress: Progress = no_progress) -> Evaluation:
    """Compute the errors of all results of a session.

    Args:
        results: those that exist.
        truth: truth of the same capture.
        progress: called with the fraction done.

    Raises:
        SessionError: the results are of another rig or another subject.
    """
    cameras = _compare_cameras(results.rig, truth)
    scene = RayScene(truth.mesh)
    foregrounds = {name: load() for name, load in results.foregrounds.items()}
    silhouettes = {name: judge_silhouette(scene, truth.rig.cameras[name], found) for name, found in foregrounds.items()}
    progress(0.15)
    matching, ranges = _compare_pairs(results, truth, scene, part(progress, 0.15, 0.5))
    world_from_rig, frame = _truths_place(results, truth, cameras)
    rig_from_world = world_from_rig.inverse()

    by_pair = seen_by_pairs(scene, truth.rig)[1]
    seen = np.any(list(by_pair.values()), axis=0)
    surfaces: dict[str, SurfaceJudgement] = {}
    error_map = None
    for number, (name, mesh) in enumerate(results.surfaces.items()):
        begun, size = 0.55 + 0.4 * number / len(results.surfaces), 0.4 / len(results.surfaces)
        error_map = map_errors(mesh, truth.mesh, seen, truth_from_measured=rig_from_world)
        progress(begun + 0.3 * size)
        claimed = results.claimed if name == "repaired" else None
        surfaces[name] = _judge_surface(mesh, truth.mesh, seen, rig_from_world, error_map, claimed)
        progress(begun + size)
    _require_same_subject(results, truth, scene, foregrounds, surfaces)

    front = -np.mean([camera.axis_world for camera in results.rig.cameras.values()], axis=0)
    boundaries: dict[str, BoundaryAccuracy] = {
        found.name: compare_boundaries(found.points_world, world_from_rig.apply(truth.boundaries[found.name]), front)
        for found in results.boundaries
        if found.name in truth.boundaries
    }
    volumes: dict[str, VolumeAccuracy] = {
        found.name: compare_volumes(found.volume_cc, truth.volumes_cc[found.name], found.interval_cc)
        for found in results.measurements
    }
    progress(1.0)
    return Evaluation(
        frame=frame,
        cameras=cameras,
        silhouettes=silhouettes,
        matching=matching,
        ranges=ranges,
        surfaces=surfaces,
        boundaries=boundaries,
        volumes=volumes,
        intervals_cc={found.name: found.interval_cc for found in results.measurements},
        absent_cc={name: truth.volumes_cc[name] for name in results.absent if name in truth.volumes_cc},
        error_map=error_map,
    )


def _compare_cameras(rig: Rig, truth: Truth) -> RigAccuracy:
    for name, camera in rig.cameras.items():
        true = truth.rig.cameras.get(name)
        if true is None or true.size_wh != camera.size_wh:
            found = "no such camera" if true is None else f"pictures of {true.size_wh[0]} × {true.size_wh[1]} pixels"
            raise SessionError(
                f"truth of camera {name}",
                found=found,
                expected=f"pictures of {camera.size_wh[0]} × {camera.size_wh[1]} pixels, as in the session",
                remedy=_REMEDY,
            )
    try:
        compared = compare_rigs(rig, truth.rig, working_volume(truth.mesh))
    except ValueError as error:
        raise _another("rig", str(error)) from None
    if not compared.projection_rms_px < _OTHER_RIG_SHARE * max(camera.size_wh[0] for camera in rig.cameras.values()):
        raise _another("rig", f"cameras that see its subject {compared.projection_rms_px:.0f} px from where it was")
    return compared


def _compare_pairs(
    results: SessionResults, truth: Truth, scene: RayScene, progress: Progress
) -> tuple[dict[str, MatchingAccuracy | None], dict[str, RangeAccuracy | None]]:
    matching: dict[str, MatchingAccuracy | None] = {}
    ranges: dict[str, RangeAccuracy | None] = {}
    for number, (pair, load) in enumerate(results.disparities.items()):
        found = load()
        true = true_disparity(
            scene, truth.rig.pair(pair), results.rig.pair(pair), found.left, found.right, pair_px=found.pair_px
        )
        matching[pair] = judge_disparity(true, found)
        if pair in results.ranges:
            ranges[pair] = judge_range(true, results.ranges[pair]())
        progress((number + 1) / len(results.disparities))
    return matching, ranges


def _truths_place(results: SessionResults, truth: Truth, cameras: RigAccuracy) -> tuple[Transform, str]:
    """world_from_rig, and its origin in words: the target that defines the world, or else the cameras."""
    for pose, world_from_target in results.world_from_target.items():
        if pose in truth.rig_from_target and np.allclose(world_from_target.matrix, np.eye(4), atol=1e-9):
            return truth.rig_from_target[pose].inverse(), f"the true place of the target in pose {pose}"
    return cameras.rig_from_world.inverse(), "the rigid alignment of the cameras over the working volume"


def _judge_surface(
    mesh: TriangleMesh,
    truth: TriangleMesh,
    seen: Bool[Array, " n"],
    rig_from_world: Transform,
    errors: ErrorMap,
    claimed: Bool[Array, " m"] | None,
) -> SurfaceJudgement:
    at = np.flatnonzero(seen)
    at = at[:: max(1, len(at) // _POINTS)]
    unaligned = compare_surfaces(mesh, truth, at=at, truth_from_measured=rig_from_world)
    placed = mesh.transformed(rig_from_world)
    truth_from_placed = align_surfaces(placed, truth, at)
    middle = truth.vertices[at].mean(axis=0)
    return SurfaceJudgement(
        unaligned=unaligned,
        claimed=None
        if claimed is None
        else compare_surfaces(mesh, truth, at=at, truth_from_measured=rig_from_world, claimed=claimed),
        aligned=compare_surfaces(placed, truth, at=at, truth_from_measured=truth_from_placed),
        aligned_by_mm=float(np.linalg.norm(truth_from_placed.apply(middle) - middle)),
        aligned_by_deg=float(np.degrees(np.linalg.norm(truth_from_placed.rotation_vector_rad))),
        stray_percent=errors.stray_percent,
    )


def _require_same_subject(
    results: SessionResults,
    truth: Truth,
    scene: RayScene,
    foregrounds: Mapping[str, Foreground],
    surfaces: Mapping[str, SurfaceJudgement],
) -> None:
    """Raise an error if the truth is of another subject, so that both surface and silhouettes differ.

    A bad measurement of the right subject is accepted, because its silhouettes agree with the truth.
    """
    names = [found.name for found in results.measurements]
    if any(name not in truth.volumes_cc for name in names):
        known = ", ".join(truth.volumes_cc) or "nothing"
        raise _another("subject", f"{', '.join(names)} among the results, where it knows {known}")
    known_outlines = [found for found in foregrounds.values() if not found.everything]
    if not (surfaces and known_outlines):
        return
    areas = [silhouette_overlap(scene, truth.rig.cameras[found.camera], found) for found in known_outlines]
    common, either = np.sum(areas, axis=0)
    off_mm = min(surface.unaligned.median_mm for surface in surfaces.values())
    if common < _OTHER_SUBJECT_OVERLAP * either and off_mm > _OTHER_SUBJECT_MM:
        share = 100 * common / max(either, 1.0)
        raise _another(
            "subject", f"a surface {off_mm:.0f} mm away (median) and silhouettes of which {share:.0f} % are in common"
        )


def _another(what: str, found: str) -> SessionError:
    return SessionError(
        f"truth of this {what}",
        found=f"{found}: results of another {what}",
        expected="the truth of the capture that was measured",
        remedy=_REMEDY,
    )


def _tables(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: None if value is None else asdict(value) for name, value in values.items()}
