"""Residuals of single views, and the target as reconstructed by each pair: an independent check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.calibration.adjust.initialise import LEAST_POINTS, is_flat
from mammometry.calibration.detection.detect import Detection
from mammometry.calibration.judge.expected_error import in_picture, sees
from mammometry.geometry import Array, Camera, Float64, StereoPair


@dataclass(frozen=True, slots=True, kw_only=True)
class PairQuality:
    """Accuracy of a pair's reconstruction of the target, over common poses."""

    pair: str
    poses: int
    points: int
    scale_ppm: float
    """Relative difference between reconstructed and nominal sizes, ppm. NaN without a common pose; so are the next
    two."""
    geometry_mm: float
    """RMS distance of reconstructed from nominal points, aligned rigidly without scaling in each pose."""
    planarity_mm: float | None
    """RMS distance from the best plane in each pose. None if the target is not flat."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MovedPair:
    """Error of a pair that is measured with the old calibration after a camera moved."""

    displacement_mm: float
    """RMS distance of measured from true points: the displacement of this pair's surface relative to the others'."""
    shape_mm: float
    """RMS distance after a rigid alignment: the error of the surface's shape."""
    scale_ppm: float
    """Relative difference of measured from true sizes, ppm. The difference in volume is three times as large."""


def moved_pair(pair: StereoPair, left: Camera, right: Camera, points_world: Float64[Array, "n 3"]) -> MovedPair | None:
    """Error of a pair whose true cameras are `left` and `right`. None if it sees too few points."""
    uv_left, uv_right = left.project(points_world), right.project(points_world)
    seen = in_picture(left, uv_left) & in_picture(right, uv_right)
    if seen.sum() < LEAST_POINTS:
        return None
    true = points_world[seen]
    found = triangulate(pair, uv_left[seen], uv_right[seen])
    scale, shape_mm = _aligned(true, found)
    return MovedPair(
        displacement_mm=float(np.sqrt(np.mean(np.sum((found - true) ** 2, axis=1)))),
        shape_mm=shape_mm,
        scale_ppm=1e6 * (scale - 1),
    )


def triangulate(
    pair: StereoPair, uv_left: Float64[Array, "n 2"], uv_right: Float64[Array, "n 2"]
) -> Float64[Array, "n 3"]:
    """World points, mm, midway between the two rays at their closest approach."""
    left, right = pair.left.rays_world(uv_left), pair.right.rays_world(uv_right)
    baseline = pair.right.centre_world - pair.left.centre_world
    cosine = np.sum(left * right, axis=1)
    along_left, along_right = left @ baseline, right @ baseline
    spread = 1.0 - cosine**2
    range_left = (along_left - cosine * along_right) / spread
    range_right = (cosine * along_left - along_right) / spread
    on_left = pair.left.centre_world + range_left[:, None] * left
    on_right = pair.right.centre_world + range_right[:, None] * right
    return (on_left + on_right) / 2


def reconstruct(calibration: Calibration, pair: StereoPair) -> PairQuality:
    """Triangulate the target from one pair for each pose, and compare with its nominal points."""
    seen = {
        (detection.camera, detection.pose): (detection, np.isfinite(residual_px).all(axis=1))
        for detection, residual_px in zip(calibration.observations.detections, calibration.residuals_px, strict=True)
    }
    target = calibration.target_points
    flat = is_flat(calibration.observations.target.points_target)
    scales, weights, shape_errors, plane_errors = [], [], [], []
    for pose in calibration.observations.poses:
        if (pair.left.name, pose) not in seen or (pair.right.name, pose) not in seen:
            continue
        left, left_good = seen[pair.left.name, pose]
        right, right_good = seen[pair.right.name, pose]
        ids, at_left, at_right = np.intersect1d(left.ids[left_good], right.ids[right_good], return_indices=True)
        if len(ids) < LEAST_POINTS:
            continue
        points = triangulate(pair, left.uv[left_good][at_left], right.uv[right_good][at_right])
        scale, error_mm = _aligned(target[ids], points)
        scales.append(scale)
        weights.append(len(ids))
        shape_errors.append(error_mm)
        plane_errors.append(_plane_rms(points))
    count = int(sum(weights))
    nothing = float("nan")
    return PairQuality(
        pair=pair.name,
        poses=len(weights),
        points=count,
        scale_ppm=1e6 * (float(np.average(scales, weights=weights)) - 1) if count else nothing,
        geometry_mm=_pooled(shape_errors, weights) if count else nothing,
        planarity_mm=(_pooled(plane_errors, weights) if count else nothing) if flat else None,
    )


def _pooled(rms: list[float], weights: list[int]) -> float:
    return float(np.sqrt(np.average(np.square(rms), weights=weights)))


def _aligned(nominal: Float64[Array, "n 3"], points: Float64[Array, "n 3"]) -> tuple[float, float]:
    """Scale of `points` over `nominal`, and aligned RMS distance, mm. Rigid alignment (Kabsch, Umeyama)."""
    a, b = nominal - nominal.mean(axis=0), points - points.mean(axis=0)
    u, values, vt = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotated = a @ ((u * sign) @ vt).T
    return float((values * sign).sum() / np.sum(a * a)), float(np.sqrt(np.mean(np.sum((b - rotated) ** 2, axis=1))))


def _plane_rms(points: Float64[Array, "n 3"]) -> float:
    return float(np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[-1] / np.sqrt(len(points)))


_FAR_PX = 1e6  # residual of a point behind its camera
_GRAZING_COSINE = float(np.cos(np.radians(75.0)))  # at larger angles a board is dark and its markers too narrow


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewQuality:
    """Figures of one camera's view of one pose."""

    camera: str
    pose: str
    points: int
    rejected: int
    """Points excluded as outliers, or all of them if the view was excluded."""
    rms_px: float
    """RMS of the points that were used. NaN if none were."""
    bias: float
    """Length of the median residual in its own standard errors, over all points: 1–5 by chance, more if something
    moved.
    """


def view_qualities(calibration: Calibration) -> tuple[ViewQuality, ...]:
    """All views in the order of the detections, with residuals computed again from the final cameras."""
    pairs = zip(calibration.observations.detections, calibration.residuals_px, strict=True)
    return tuple(_view_quality(calibration, detection, residual_px) for detection, residual_px in pairs)


def sees_badly(calibration: Calibration, camera: str, pose: str) -> bool:
    """Whether a camera saw the target from behind, at a grazing angle, or hardly at all.

    By the final calibration. Flat targets are seen from their negative z. For others only the field of view is tested.
    """
    placed, seer = calibration.world_from_target.get(pose), calibration.rig.cameras.get(camera)
    if placed is None or seer is None:
        return False
    points = placed.apply(calibration.target_points)
    towards = seer.centre_world - points.mean(axis=0)
    cosine = float(-placed.rotation[:, 2] @ towards / np.linalg.norm(towards))
    aslant = is_flat(calibration.observations.target.points_target) and cosine < _GRAZING_COSINE
    return bool(aslant or sees(seer, points).mean() < 0.5)


def pooled_rms(views: Sequence[ViewQuality]) -> float:
    """RMS over all points of the used views, px. NaN if none were used."""
    used = np.array([view.points - view.rejected for view in views], float)
    squares = np.nan_to_num([view.rms_px for view in views]) ** 2
    return float(np.sqrt(used @ squares / used.sum())) if used.sum() else float("nan")


def _view_quality(calibration: Calibration, detection: Detection, residual_px: Float64[Array, "n 2"]) -> ViewQuality:
    good = np.isfinite(residual_px).all(axis=1)
    rms_px = float(np.sqrt(np.mean(np.sum(residual_px[good] ** 2, axis=1)))) if good.any() else float("nan")
    bias = float("nan")
    placement = calibration.world_from_target.get(detection.pose)
    if placement is not None and len(detection.ids):
        camera = calibration.rig.cameras[detection.camera]
        afresh = camera.project(placement.apply(calibration.target_points[detection.ids])) - detection.uv
        whitener = np.linalg.inv(np.linalg.cholesky(detection.covariance_px2))
        whitened = np.einsum("nij,nj->ni", whitener, np.nan_to_num(afresh, nan=_FAR_PX))
        shift = float(np.linalg.norm(np.median(whitened, axis=0)))
        bias = shift * float(np.sqrt(len(afresh))) / calibration.noise_factor
    return ViewQuality(
        camera=detection.camera,
        pose=detection.pose,
        points=len(good),
        rejected=int((~good).sum()),
        rms_px=rms_px,
        bias=bias,
    )
