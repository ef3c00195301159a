"""Figures of single views: what is left, what was left out, whether all of it leans to one side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mammometry.calibration.bundle import Calibration
from mammometry.calibration.detect import Detection
from mammometry.geometry.arrays import Array, Float64

_FAR_PX = 1e6  # residual of a point behind its camera


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewQuality:
    """What one camera saw in one pose."""

    camera: str
    pose: str
    points: int
    rejected: int
    """Points left out as outliers, or all of them where the view was set aside."""
    rms_px: float
    """Of the points that took part; NaN where none did."""
    bias: float
    """Length of the median residual in its own standard errors, all points included: 1–5 by chance, more if something
    moved."""


def view_qualities(calibration: Calibration) -> tuple[ViewQuality, ...]:
    """All views in the order of the detections; residuals are formed anew with the finished cameras."""
    pairs = zip(calibration.observations.detections, calibration.residuals_px, strict=True)
    return tuple(_view_quality(calibration, detection, residual_px) for detection, residual_px in pairs)


def pooled_rms(views: Sequence[ViewQuality]) -> float:
    """RMS over all points of the views that took part, px; NaN where none did."""
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
