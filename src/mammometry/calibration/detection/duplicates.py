"""Find duplicate photographs. Two exposures never agree to hundredths of a pixel everywhere."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from itertools import combinations

import numpy as np

from mammometry.calibration.detection.detect import Detection, MissedView, Observations

_SAME_PX = 0.1
"""Median distance of the same points, px. Different cameras are never so near. One camera that stands still is, but
then all cameras of the pose are.
"""
_COPIED_PX = 1e-3
"""Noise alone moves corners by more than this between exposures, px."""
_COMMON = 0.9
"""Least share of points that two copies of a picture have in common."""


def set_duplicates_aside(observations: Observations) -> Observations:
    """Leave out photographs that are there more than once, and say so.

    A picture may stand under two cameras' names, or in two poses of one camera while the others saw the target move.
    Neither of the two can be trusted. A whole pose that was copied counts once.
    """
    twins: dict[tuple[str, str], list[Detection]] = defaultdict(list)
    for a, b in combinations(observations.detections, 2):
        distance_px = _distance_px(a, b)
        if a.camera != b.camera and distance_px < _SAME_PX:
            twins[a.pose, a.camera].append(b)
            twins[b.pose, b.camera].append(a)
        elif a.camera == b.camera and a.pose != b.pose and distance_px < _SAME_PX:
            stood_still = _stood_still(observations, a, b)
            if not stood_still:
                twins[a.pose, a.camera].append(b)
            if not stood_still or distance_px < _COPIED_PX:
                twins[b.pose, b.camera].append(a)
    if not twins:
        return observations
    missed = [
        MissedView(
            camera=camera,
            pose=pose,
            found=f"the same picture as {', '.join(f'{other.pose}/{other.camera}' for other in others)}",
            remedy="Copy the right photograph there again, or remove the pose",
        )
        for (pose, camera), others in twins.items()
    ]
    kept = tuple(seen for seen in observations.detections if (seen.pose, seen.camera) not in twins)
    return replace(observations, detections=kept, missed=(*observations.missed, *missed))


def _stood_still(observations: Observations, a: Detection, b: Detection) -> bool:
    """Whether every other camera saw the same in both poses."""
    others = {seen.camera: seen for seen in observations.detections if seen.pose == a.pose and seen.camera != a.camera}
    pairs = [
        (others[seen.camera], seen) for seen in observations.detections if seen.pose == b.pose and seen.camera in others
    ]
    return all(_distance_px(first, second) < _SAME_PX for first, second in pairs)


def _distance_px(a: Detection, b: Detection) -> float:
    """Median distance of the points that both have. Infinite where they are hardly the same points."""
    _, i, j = np.intersect1d(a.ids, b.ids, assume_unique=True, return_indices=True)
    if len(i) < _COMMON * max(len(a.ids), len(b.ids)) or not len(i):
        return float("inf")
    return float(np.median(np.linalg.norm(a.uv[i] - b.uv[j], axis=1)))
