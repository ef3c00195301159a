"""Is this calibration good enough? Said in words and millimetres, for each camera, pose and pair.

Nothing of the adjustment is taken on trust: residuals are formed anew with the finished cameras, points that were left
out included, and the target is reconstructed from each pair as the skin will be.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np

from mammometry.calibration.bundle import Calibration
from mammometry.calibration.detect import Detection
from mammometry.calibration.reconstruction import PairQuality, reconstruct
from mammometry.calibration.settings import QualitySettings
from mammometry.geometry.arrays import Array, Float64

Verdict = Literal["pass", "warn", "refuse"]
_GRID_WH = (8, 6)
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CalibrationQuality:
    """The verdict, its reasons, and the figures behind them."""

    verdict: Verdict
    reasons: tuple[str, ...]
    """One sentence each, the gravest first; what is in order says so too."""
    rms_px: float
    rms_px_per_camera: Mapping[str, float]
    rms_px_per_pose: Mapping[str, float]
    rms_mm: float
    """The residuals at the target's distance: each in millimetres of the plane across its line of sight."""
    coverage: Mapping[str, float]
    """Camera → share of an 8 × 6 grid over its photograph in which target points were seen."""
    focal_std: Mapping[str, float]
    """Camera → relative standard deviation of its focal length."""
    views: tuple[ViewQuality, ...]
    """In the order of the detections."""
    pairs: tuple[PairQuality, ...]

    def __post_init__(self) -> None:
        for name in ("rms_px_per_camera", "rms_px_per_pose", "coverage", "focal_std"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))


def assess(calibration: Calibration, settings: QualitySettings = QualitySettings()) -> CalibrationQuality:
    """Judge a calibration by its residuals, its standard deviations and the target reconstructed from each pair.

    ``pass``: nothing stands out. ``warn``: usable, but something deserves a look. ``refuse``: measuring with it would
    give wrong volumes without any other sign.
    """
    detections = calibration.observations.detections
    views = tuple(
        _view_quality(calibration, detection, residual_px)
        for detection, residual_px in zip(detections, calibration.residuals_px, strict=True)
    )
    pairs = tuple(reconstruct(calibration, pair) for pair in calibration.rig.pairs)
    cameras, poses = tuple(calibration.rig.cameras), calibration.observations.poses
    rms_per_camera = {name: _pooled([view for view in views if view.camera == name]) for name in cameras}
    rms_per_pose = {name: _pooled([view for view in views if view.pose == name]) for name in poses}
    coverage = {name: _coverage(calibration, name) for name in cameras}
    focal_std = {
        name: calibration.parameter_std[name]["fx_px"] / float(camera.matrix[0, 0])
        for name, camera in calibration.rig.cameras.items()
    }
    findings = [
        *_about_fit(calibration, views, settings),
        *_about_cameras(calibration, focal_std, coverage, settings),
        *_about_pairs(pairs, settings),
    ]
    verdict: Verdict = "pass"
    for level in ("warn", "refuse"):
        if any(found == level for found, _ in findings):
            verdict = level
    rms_mm = _rms_mm(calibration)
    summary = f"residuals are {calibration.rms_px:.3f} px RMS, {rms_mm:.3f} mm at the target's distance"
    ordered = sorted(findings, key=lambda finding: finding[0] != "refuse")
    return CalibrationQuality(
        verdict=verdict,
        reasons=(*(reason for _, reason in ordered), summary),
        rms_px=calibration.rms_px,
        rms_px_per_camera=rms_per_camera,
        rms_px_per_pose=rms_per_pose,
        rms_mm=rms_mm,
        coverage=coverage,
        focal_std=focal_std,
        views=views,
        pairs=pairs,
    )


Finding = tuple[Verdict, str]


def _about_fit(calibration: Calibration, views: tuple[ViewQuality, ...], settings: QualitySettings) -> list[Finding]:
    findings: list[Finding] = []
    if not calibration.converged:
        findings.append(("warn", f"the adjustment had not settled after {calibration.iterations} steps"))
    aside = {(view.camera, view.pose) for view in calibration.set_aside}
    for view in calibration.set_aside:
        findings.append(
            (
                "warn",
                f"pose {view.pose}: the picture of {view.camera} does not fit the others (off by {view.residual_px:.0f}"
                " px) and was set aside; was it exposed together with them, and is it the right file?",
            )
        )
    for quality in sorted(views, key=lambda quality: -quality.bias):
        if (quality.camera, quality.pose) in aside:
            continue
        if quality.bias > settings.bias_warn:
            level: Verdict = "refuse" if quality.bias > settings.bias_refuse else "warn"
            findings.append(
                (
                    level,
                    f"pose {quality.pose}: what {quality.camera} saw is shifted as a whole by {quality.bias:.0f}"
                    f" standard errors (limit {settings.bias_refuse:.0f}): a camera or the target moved",
                )
            )
        if quality.rejected > settings.rejected_warn * quality.points and quality.rejected > 1:
            findings.append(
                (
                    "warn",
                    f"pose {quality.pose}: {quality.rejected} of {quality.points} points of {quality.camera} were left"
                    " out as outliers",
                )
            )
    return findings


def _about_cameras(
    calibration: Calibration, focal_std: Mapping[str, float], coverage: Mapping[str, float], settings: QualitySettings
) -> list[Finding]:
    findings: list[Finding] = []
    for name, std in focal_std.items():
        if std > settings.focal_std_warn:
            camera = calibration.rig.cameras[name]
            distance_mm = np.median([t.translation_mm for t in calibration.world_from_target.values()], axis=0)
            depth_mm = float(np.linalg.norm(distance_mm - camera.centre_world)) * std
            level: Verdict = "refuse" if std > settings.focal_std_refuse else "warn"
            findings.append(
                (
                    level,
                    f"the focal length of {name} is known to {100 * std:.3f} % only (limit "
                    f"{100 * settings.focal_std_refuse:.2f} %), {depth_mm:.2f} mm in depth: add poses, tilted more",
                )
            )
    for name, share in coverage.items():
        if share < settings.coverage_warn:
            findings.append(
                ("warn", f"the target covered only {100 * share:.0f} % of the photographs of {name}: add poses there")
            )
    return findings


def _about_pairs(pairs: tuple[PairQuality, ...], settings: QualitySettings) -> list[Finding]:
    findings: list[Finding] = []
    for pair in pairs:
        if not pair.poses:
            findings.append(("warn", f"pair {pair.pair}: both cameras never saw the target in the same pose"))
            continue
        if pair.geometry_mm > settings.geometry_warn_mm:
            level: Verdict = "refuse" if pair.geometry_mm > settings.geometry_refuse_mm else "warn"
            findings.append(
                (
                    level,
                    f"pair {pair.pair} reconstructs the target to {pair.geometry_mm:.2f} mm RMS (limit "
                    f"{settings.geometry_refuse_mm} mm)",
                )
            )
        if abs(pair.scale_ppm) > settings.scale_warn_ppm:
            level = "refuse" if abs(pair.scale_ppm) > settings.scale_refuse_ppm else "warn"
            findings.append(
                (
                    level,
                    f"pair {pair.pair} reconstructs the target {pair.scale_ppm / 1e4:+.3f} % too large, "
                    f"{3 * pair.scale_ppm / 1e4:+.2f} % in volume",
                )
            )
    return findings


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


def _pooled(views: Sequence[ViewQuality]) -> float:
    """RMS over all points of the views that took part, px; NaN where none did."""
    used = np.array([view.points - view.rejected for view in views], float)
    squares = np.nan_to_num([view.rms_px for view in views]) ** 2
    return float(np.sqrt(used @ squares / used.sum())) if used.sum() else float("nan")


def _rms_mm(calibration: Calibration) -> float:
    """RMS residual times the size of a pixel at each point's depth, mm."""
    squares = []
    for detection, residual_px in zip(calibration.observations.detections, calibration.residuals_px, strict=True):
        if detection.pose in calibration.world_from_target:
            camera = calibration.rig.cameras[detection.camera]
            camera_from_target = camera.camera_from_world @ calibration.world_from_target[detection.pose]
            depth_mm = camera_from_target.apply(calibration.target_points[detection.ids])[:, 2]
            focal_px = np.diag(camera.matrix)[:2]
            squares.append(np.sum((residual_px / focal_px * depth_mm[:, None]) ** 2, axis=1))
    return float(np.sqrt(np.nanmean(np.concatenate(squares))))


def _coverage(calibration: Calibration, name: str) -> float:
    """Share of the grid's cells in which the camera saw a point that took part, its separate photographs included."""
    seen = list(zip(calibration.observations.detections, calibration.residuals_px, strict=True))
    if name in calibration.intrinsics_observations:
        separate = calibration.intrinsics_observations[name].detections
        seen += zip(separate, calibration.intrinsics_residuals_px[name], strict=True)
    width, height = calibration.rig.cameras[name].size_wh
    cells = set()
    for detection, residual_px in seen:
        if detection.camera == name:
            uv = detection.uv[np.isfinite(residual_px).all(axis=1)]
            columns, rows = ((uv + 0.5) / (width, height) * _GRID_WH).astype(int).T
            cells |= set(zip(columns.tolist(), rows.tolist(), strict=True))
    return len(cells) / (_GRID_WH[0] * _GRID_WH[1])
