"""Figures of single views: residuals, rejected points, one-sidedness."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mammometry.calibration.adjust.bundle import Calibration
from mammometry.calibration.detection.detect import Detection
from mammometry.geometry.arrays import Array, Float64

_FAR_PX = 1e6  # residual of a point behind its camera
_FLAT = 1e-6
"""Points thinner than this share of their extent are flat: rounding only."""
_GRAZING_COSINE = float(np.cos(np.radians(75.0)))  # beyond, a board stays dark and its markers are too narrow


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewQuality:
    """Figures of one camera's view of one pose."""

    camera: str
    pose: str
    points: int
    rejected: int
    """Points left out as outliers, or all of them if the view was set aside."""
    rms_px: float
    """Of the points that took part. NaN where none did."""
    bias: float
    """Length of the median residual in its own standard errors, all points included: 1–5 by chance, more if something
    moved.
    """


def view_qualities(calibration: Calibration) -> tuple[ViewQuality, ...]:
    """All views in the order of the detections. Residuals are formed again with the finished cameras."""
    pairs = zip(calibration.observations.detections, calibration.residuals_px, strict=True)
    return tuple(_view_quality(calibration, detection, residual_px) for detection, residual_px in pairs)


def sees_badly(calibration: Calibration, camera: str, pose: str) -> bool:
    """Whether a camera saw the target from behind, aslant, or hardly.

    By the finished calibration. Flat targets are viewed from their negative z. For others only the frame is checked.
    """
    placed, seer = calibration.world_from_target.get(pose), calibration.rig.cameras.get(camera)
    if placed is None or seer is None:
        return False
    points = placed.apply(calibration.target_points)
    uv = seer.project(points)
    inside = np.all((uv > -0.5) & (uv < np.array(seer.size_wh) - 0.5), axis=1)
    nominal = calibration.observations.target.points_target
    spread = np.linalg.svd(nominal - nominal.mean(axis=0), compute_uv=False)
    towards = seer.centre_world - points.mean(axis=0)
    cosine = float(-placed.rotation[:, 2] @ towards / np.linalg.norm(towards))
    aslant = spread[2] < _FLAT * spread[0] and cosine < _GRAZING_COSINE
    return bool(aslant or inside.mean() < 0.5)


def pooled_rms(views: Sequence[ViewQuality]) -> float:
    """RMS over all points of the views that took part, px. NaN where none did."""
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
