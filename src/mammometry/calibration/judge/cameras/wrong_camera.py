"""Find the camera and pose of a picture with a wrong name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mammometry.calibration.adjust.bundle import Calibration
from mammometry.calibration.detection.detect import Detection

_LEAST_POINTS = 6
"""Fewest points by which a picture is recognised."""
_FITS_NOISES = 10.0
"""Largest median error of a picture that fits a shot, in RMS residuals."""
_FITS_PX = 0.1
"""Errors below this always fit, px."""


@dataclass(frozen=True, slots=True)
class Shot:
    """Camera and pose of one photograph."""

    camera: str
    pose: str


def true_shot(calibration: Calibration, detection: Detection) -> Shot | None:
    """Find the camera and pose that a misfitting view really shows. None if none is known."""
    least, found = np.inf, None
    for pose, placed in calibration.world_from_target.items():
        points = placed.apply(calibration.target_points[detection.ids])
        for name, camera in calibration.rig.cameras.items():
            if (name, pose) != (detection.camera, detection.pose) and len(points) >= _LEAST_POINTS:
                offset = np.linalg.norm(camera.project(points) - detection.uv, axis=1)
                off_px = float(np.nanmedian(offset)) if np.isfinite(offset).any() else np.inf
                if off_px < least:
                    least, found = off_px, Shot(name, pose)
    return found if least < max(_FITS_NOISES * calibration.rms_px, _FITS_PX) else None
