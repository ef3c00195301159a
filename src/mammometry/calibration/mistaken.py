"""Pictures under the wrong name: whose picture a view really is, and which photographs are there twice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mammometry.calibration.bundle import Calibration
from mammometry.calibration.detect import Detection
from mammometry.geometry.arrays import Array, Float64

_LEAST_POINTS = 6
_ALIKE_PX = 0.02
_ALIKE_NOISES = 2.0
_FITS_NOISES = 10.0


@dataclass(frozen=True, slots=True)
class Shot:
    """One photograph: what it is called, or ought to be."""

    camera: str
    pose: str


def true_shot(calibration: Calibration, detection: Detection) -> Shot | None:
    """Of which camera, in which pose, a view that fits nowhere is in truth the picture; None if of none known."""
    least, found = np.inf, None
    for pose, placed in calibration.world_from_target.items():
        points = placed.apply(calibration.target_points[detection.ids])
        for name, camera in calibration.rig.cameras.items():
            if (name, pose) != (detection.camera, detection.pose) and len(points) >= _LEAST_POINTS:
                offset = np.linalg.norm(camera.project(points) - detection.uv, axis=1)
                off_px = float(np.nanmedian(offset)) if np.isfinite(offset).any() else np.inf
                if off_px < least:
                    least, found = off_px, Shot(name, pose)
    return found if least < max(_FITS_NOISES * calibration.rms_px, 0.1) else None


def twins(detections: Sequence[Detection], noise_px: float) -> list[tuple[Shot, Shot]]:
    """Photographs that show the target in one place, to within their noise: copies, or a target that stood still."""
    limit_px = max(_ALIKE_PX, _ALIKE_NOISES * noise_px)
    found = []
    for i, one in enumerate(detections):
        for other in detections[i + 1 :]:
            if (one.camera == other.camera or one.pose == other.pose) and _apart_px(one, other) < limit_px:
                found.append((Shot(one.camera, one.pose), Shot(other.camera, other.pose)))
    return found


def _apart_px(one: Detection, other: Detection) -> float:
    """Median distance of the same points in both pictures, px; infinite if they do not show the same points."""
    shared, at_one, at_other = np.intersect1d(one.ids, other.ids, assume_unique=True, return_indices=True)
    if len(shared) < max(_LEAST_POINTS, 0.8 * max(len(one.ids), len(other.ids))):
        return float("inf")
    offset: Float64[Array, "n 2"] = one.uv[at_one] - other.uv[at_other]
    return float(np.median(np.linalg.norm(offset, axis=1)))
