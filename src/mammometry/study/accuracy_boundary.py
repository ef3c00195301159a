"""A measured boundary curve against the true one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from mammometry.geometry.arrays import Array, Float64

_STEP_MM = 0.1  # between points of a curve that is compared: far below any error of it


@dataclass(frozen=True, slots=True, kw_only=True)
class BoundaryAccuracy:
    """Distances between two closed curves, along the curves, mm."""

    mean_mm: float
    """Mean distance of the measured curve from the true one."""
    p95_mm: float
    """95th percentile of the same."""
    worst_mm: float
    """Largest distance of either curve from the other (Hausdorff's)."""
    height_bias_mm: float
    """How far the measured curve lies in front of the true one, along the normal of the true curve's best plane towards
    the subject's front, mean, mm: for a cast a cc or so a tenth of a millimetre."""


def compare_boundaries(
    measured: Float64[Array, "n 3"], truth: Float64[Array, "m 3"], towards_front: Float64[Array, 3]
) -> BoundaryAccuracy:
    """Compare two closed curves in one frame, mm. The last point of each joins the first.

    Args:
        measured: the curve under test.
        truth: the true curve.
        towards_front: roughly where the subject's front is: decides the sign of the height.
    """
    dense, true_dense = resampled(measured), resampled(truth)
    distance, nearest = (np.asarray(found) for found in cKDTree(true_dense).query(dense))
    back = np.asarray(cKDTree(dense).query(true_dense)[0])
    normal = np.linalg.svd(true_dense - true_dense.mean(axis=0), full_matrices=False)[2][2]
    normal *= 1.0 if normal @ towards_front >= 0 else -1.0
    return BoundaryAccuracy(
        mean_mm=float(distance.mean()),
        p95_mm=float(np.percentile(distance, 95)),
        worst_mm=float(max(distance.max(), back.max())),
        height_bias_mm=float(((dense - true_dense[nearest]) @ normal).mean()),
    )


def resampled(curve: Float64[Array, "n 3"], step_mm: float = _STEP_MM) -> Float64[Array, "k 3"]:
    """Points every `step_mm` or a little less along a closed curve."""
    corners = np.concatenate([curve, curve[:1]])
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.linspace(0.0, lengths[-1], max(3, int(np.ceil(lengths[-1] / step_mm))), endpoint=False)
    return np.stack([np.interp(at, lengths, corners[:, axis]) for axis in range(3)], axis=1)
