"""The front of a scanned body's trunk, without back, legs and head."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.base.notices import Notice
from mammometry.geometry import Array, Bool, Float64, TriangleMesh
from mammometry.geometry.nearest import point_tree
from mammometry.measure.scan_repair import RepairedScan
from mammometry.measure.solid.cut import above
from mammometry.measure.trunk.thorax import SkinSamples, find_trunk

WHOLE_BODY_MM = 1200.0
"""Height above which a body is whole (with legs), instead of a torso, mm. Not critical."""
_TRUNK = (0.56, 0.87)
"""Lower and upper end of the upper trunk (navel and chin), relative to the height of a standing body. Adults' crotch is
at 0.47, the nipples at 0.70 to 0.74."""
_BEHIND_MM = 25.0  # the front ends this far behind the middle between front and back, so that it includes the sides
_FACING_BACK = -0.3  # largest cosine between straight ahead and the normals of a back
_NOTED = 0.1  # least removed share of the area that is reported
_WORTH_MM = 5.0  # a back of less depth is not cut off
_MIDLINE_MM = 150.0  # half width of the strip that shows the body's height, without raised hands; not critical
_FEET, _ANKLES = 0.03, (0.05, 0.09)  # height of the feet, and heights of the ankles, relative to the body
_TOES_MM = 20.0  # least distance of the feet in front of the ankles; adults have 50 to 90


def front_of_body(scan: RepairedScan, frame: Float64[Array, "3 3"]) -> RepairedScan:
    """A scan without its back, and of a whole body only the upper trunk.

    Args:
        scan: a torso or a whole body, mm.
        frame: patient's left, head, straight ahead (rows).
    """
    return with_notice(without_back(upper_trunk(scan, frame[1]), frame), scan)


def upper_trunk(scan: RepairedScan, up: Float64[Array, 3]) -> RepairedScan:
    """Cut the upper trunk out of a whole body.

    Any other scan is returned unchanged.

    Args:
        scan: a torso or a whole body, mm.
        up: towards the head.
    """
    if np.ptp(scan.mesh.vertices @ up) <= WHOLE_BODY_MM:
        return scan
    low, high = _trunk_heights(scan.mesh, up)
    return _above(_above(scan, up, low), -up, -high)


def without_back(scan: RepairedScan, frame: Float64[Array, "3 3"]) -> RepairedScan:
    """Cut the back off a trunk whose sides are visible."""
    depth = _front_depth(scan.mesh, frame)
    if depth is None or depth - float((scan.mesh.vertices @ frame[2]).min()) <= _WORTH_MM:
        return scan
    return _above(scan, frame[2], depth)


def with_notice(front: RepairedScan, scan: RepairedScan) -> RepairedScan:
    """The front of a scan, with a notice if it is much less than the scan."""
    if front.mesh.area_mm2() > (1 - _NOTED) * scan.mesh.area_mm2():
        return front
    return replace(front, notices=(*scan.notices, Notice(code="front-of-trunk", level="note")))


def ahead_by_feet(mesh: TriangleMesh, up: Float64[Array, 3]) -> Float64[Array, 3] | None:
    """Straight ahead of a whole body, from the direction of its feet. None without feet.

    Args:
        mesh: a standing body, mm.
        up: towards the head.
    """
    heights = mesh.vertices @ up
    tall = float(np.ptp(heights))
    if tall <= WHOLE_BODY_MM:
        return None
    share = (heights - heights.min()) / tall
    feet, ankles = share < _FEET, (share > _ANKLES[0]) & (share < _ANKLES[1])
    if not (feet.any() and ankles.any()):
        return None
    forward = _middle(mesh, feet) - _middle(mesh, ankles)
    forward -= up * (forward @ up)
    length = float(np.linalg.norm(forward))
    return forward / length if length > _TOES_MM else None


def _middle(mesh: TriangleMesh, chosen: Bool[Array, " n"]) -> Float64[Array, 3]:
    """Centre of the bounding box of the chosen vertices."""
    points = mesh.vertices[chosen]
    return np.asarray((points.min(axis=0) + points.max(axis=0)) / 2)


def _trunk_heights(mesh: TriangleMesh, up: Float64[Array, 3]) -> tuple[float, float]:
    """Heights of the lower and upper end of a standing body's upper trunk, mm."""
    heights = mesh.vertices @ up
    beside = mesh.vertices - np.median(mesh.vertices, axis=0)
    beside -= np.outer(beside @ up, up)
    near = np.linalg.norm(beside, axis=1) < _MIDLINE_MM
    low, high = float(heights.min()), float(heights[near].max() if near.any() else heights.max())
    return low + _TRUNK[0] * (high - low), low + _TRUNK[1] * (high - low)


def _front_depth(mesh: TriangleMesh, frame: Float64[Array, "3 3"]) -> float | None:
    """Depth along straight ahead at which the front ends, mm. None if the trunk's sides are not visible."""
    vectors = mesh.face_vectors()
    area = np.maximum(np.linalg.norm(vectors, axis=1), 1e-12)
    normals = vectors / area[:, None]
    ahead = normals @ frame[2] > _FACING_BACK
    skin = SkinSamples(points_world=mesh.vertices[mesh.faces[ahead]].mean(axis=1), normals_world=normals[ahead])
    try:
        trunk = find_trunk(skin, frame)
    except MeasureError:
        return None
    return float(trunk.origin @ frame[2]) - _BEHIND_MM


def _above(scan: RepairedScan, direction: Float64[Array, 3], height: float) -> RepairedScan:
    """Largest part of a scan on the positive side of a plane."""
    part = above(scan.mesh, lambda points: points @ direction - height).mesh
    if not len(part.faces):
        return scan
    away, nearest = point_tree(scan.mesh.vertices).query(part.vertices)
    kept = np.asarray(away) == 0
    nearest = np.asarray(nearest)
    return replace(scan, mesh=part, invented=kept & scan.invented[nearest], at_fold=kept & scan.at_fold[nearest])
