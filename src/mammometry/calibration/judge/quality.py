"""Assess whether a calibration is good enough, for each camera, pose and pair, in millimetres.

It is independent of the adjustment: residuals are computed again with the final cameras and include excluded points;
the target is reconstructed from each pair, as skin will be; and each view is tested for motion of its camera.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from mammometry.base.notices import Notice
from mammometry.base.value import value
from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.calibration.judge.expected_error import expected_error
from mammometry.calibration.judge.findings import (
    CalibrationFinding,
    Verdict,
    about_bias,
    about_cameras,
    about_expected,
    about_fit,
    about_inverse,
    about_left_out,
    about_missed,
    about_movements,
    about_names,
    about_pairs,
    about_pixels,
    about_residuals,
    about_scale,
    about_target,
)
from mammometry.calibration.judge.pose_motion import MovedCameras, movements
from mammometry.calibration.judge.reconstruction import (
    PairQuality,
    ViewQuality,
    pooled_rms,
    reconstruct,
    view_qualities,
)
from mammometry.calibration.judge.sighting import sightings
from mammometry.calibration.settings import QualitySettings

_MOVED_SIGMA = 8.0
"""Length of a movement between poses, in standard errors, above which it is reported. Clean rigs reach 5."""

__all__ = ["CalibrationQuality", "Verdict", "ViewQuality", "assess"]

_GRID_WH = (8, 6)
"""Cells of a photograph in which coverage is counted, across and down. They define the reported coverage."""
_GRAVITY: Mapping[Verdict, int] = {"refuse": 0, "warn": 1, "pass": 2}


@value(eq=False)
class CalibrationQuality:
    """The findings with their verdicts, and the figures behind them."""

    findings: tuple[CalibrationFinding, ...]
    """Worst first. Good ones are included."""
    rms_px: float
    rms_px_per_camera: Mapping[str, float]
    rms_px_per_pose: Mapping[str, float]
    rms_mm: float
    """RMS residual at the target's distance, mm, perpendicular to the line of sight."""
    coverage: Mapping[str, float]
    """Camera → share of an 8 × 6 grid on its photograph with target points."""
    volume_coverage: float
    """Share of the working volume within an eighth of its width from a target position. NaN if the volume is empty."""
    expected_mm: Mapping[str, float]
    """Pair → standard deviation of its reconstructed points due to the cameras' uncertainty, over the part of the
    working volume in which the target was shown. NaN if that is empty."""
    focal_std: Mapping[str, float]
    """Camera → relative standard deviation of its focal length."""
    views: tuple[ViewQuality, ...]
    """In the order of the detections."""
    pairs: tuple[PairQuality, ...]
    movements: tuple[MovedCameras, ...]
    """Cameras that moved while the rig was calibrated, the most certain first."""

    @property
    def verdict(self) -> Verdict:
        """Verdict of the worst finding."""
        return self.findings[0].verdict

    @property
    def notices(self) -> tuple[Notice, ...]:
        """Notices of all findings, worst first."""
        return tuple(finding.notice for finding in self.findings)

    @property
    def refusals(self) -> tuple[Notice, ...]:
        """Notices of the findings for which the calibration is refused."""
        return tuple(finding.notice for finding in self.findings if finding.verdict == "refuse")

    @property
    def doubts(self) -> tuple[Notice, ...]:
        """Notices of the findings to be checked."""
        return tuple(finding.notice for finding in self.findings if finding.verdict == "warn")


def assess(calibration: Calibration, settings: QualitySettings = QualitySettings()) -> CalibrationQuality:
    """Assess a calibration by its residuals, standard deviations and reconstructed target.

    The target is reconstructed from each pair. ``pass``: no problem. ``warn``: usable, but something should be checked.
    ``refuse``: measurements would have wrong volumes without any other sign. The last result is cached, because several
    products and pages need it.
    """
    return _assessed(calibration, settings)


@lru_cache(maxsize=1)
def _assessed(calibration: Calibration, settings: QualitySettings) -> CalibrationQuality:
    views = view_qualities(calibration)
    pairs = tuple(reconstruct(calibration, pair) for pair in calibration.rig.pairs)
    moved = movements(calibration, sightings(calibration), _MOVED_SIGMA)
    coverage = {name: _coverage(calibration, name) for name in calibration.rig.cameras}
    expected = expected_error(calibration)
    focal_std = {
        name: calibration.independent_std[name]["fx_px"] / float(camera.matrix[0, 0])
        for name, camera in calibration.rig.cameras.items()
    }
    rms_mm = _rms_mm(calibration)
    findings = [
        *about_names(calibration),
        *about_missed(calibration),
        *about_target(calibration),
        *about_inverse(calibration),
        *about_movements(moved),
        *(() if moved else about_bias(calibration, views)),
        *about_fit(calibration, views),
        *about_cameras(calibration, focal_std, coverage, expected.volume.coverage, settings),
        *about_pixels(calibration),
        *about_pairs(pairs),
        *about_expected(expected.rms_mm),
        about_residuals(calibration.rms_px, rms_mm),
        *about_left_out(calibration),
        *about_scale(calibration),
    ]
    findings.sort(key=lambda finding: _GRAVITY[finding.verdict])
    return CalibrationQuality(
        findings=tuple(findings),
        rms_px=calibration.rms_px,
        rms_px_per_camera={name: pooled_rms([v for v in views if v.camera == name]) for name in coverage},
        rms_px_per_pose={
            pose: pooled_rms([v for v in views if v.pose == pose]) for pose in calibration.observations.poses
        },
        rms_mm=rms_mm,
        coverage=coverage,
        volume_coverage=expected.volume.coverage,
        expected_mm=expected.rms_mm,
        focal_std=focal_std,
        views=views,
        pairs=pairs,
        movements=moved,
    )


def _rms_mm(calibration: Calibration) -> float:
    """RMS residual times the pixel size at each point's depth, mm."""
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
    """Share of grid cells in which the camera saw an active point. Its separate photographs are included."""
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
