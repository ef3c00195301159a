"""Pose of a camera from points in space, some of which are wrong."""

from __future__ import annotations

import cv2
import numpy as np

from mammometry.geometry import Array, Float64, Transform

_ATTEMPTS, _CONFIDENCE = 1000, 0.999  # random sets of points that are tried at most, and chance that one was right


def pose_of(
    points_world: Float64[Array, "n 3"], xy: Float64[Array, "n 2"], tolerance: float, fewest: int
) -> Transform | None:
    """The most agreed pose, camera_from_world. None if fewer than `fewest` points agree.

    Args:
        points_world: mm.
        xy: where the camera sees them, normalised coordinates without distortion.
        tolerance: largest distance of a right point from its projection, the same units.
        fewest: least number of points that agree.
    """
    if len(points_world) < fewest:
        return None
    cv2.setRNGSeed(0)
    found, turn, shift, inside = cv2.solvePnPRansac(
        points_world, xy, np.eye(3), np.zeros(5), iterationsCount=_ATTEMPTS, confidence=_CONFIDENCE,
        flags=cv2.SOLVEPNP_EPNP, reprojectionError=tolerance,
    )  # fmt: skip
    if not found or inside is None or len(inside) < fewest:
        return None
    good = inside.ravel()
    turn, shift = cv2.solvePnPRefineLM(points_world[good], xy[good], np.eye(3), np.zeros(5), turn, shift)
    return Transform.from_rotation_vector(np.ravel(turn), np.ravel(shift))
