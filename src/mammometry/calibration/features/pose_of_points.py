"""Pose of a camera from points in space, some of which are wrong."""

from __future__ import annotations

import cv2
import numpy as np

from mammometry.geometry import Array, Float64, Transform

_ATTEMPTS, _CONFIDENCE = 1000, 0.999  # most random samples, and probability that one has no outlier


def pose_of(
    points_world: Float64[Array, "n 3"], xy: Float64[Array, "n 2"], tolerance: float, fewest: int
) -> Transform | None:
    """Pose with the most inliers, camera_from_world. None with fewer than `fewest` inliers.

    Args:
        points_world: mm.
        xy: images of the points, normalised coordinates without distortion.
        tolerance: largest distance of an inlier from its projection, in the same units.
        fewest: least number of inliers.
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
