"""The front of a scanned body's trunk, so that nothing hangs on how much else was scanned.

The back, legs and head tell nothing of a breast. They are cut off before the trunk's axis is looked for.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.geometry import Array, Bool, Float64, TriangleMesh
from mammometry.geometry.nearest import point_tree
from mammometry.measure.scan_repair import RepairedScan
from mammometry.measure.solid.cut import above
from mammometry.measure.trunk.thorax import Skin, find_trunk

WHOLE_BODY_MM = 1200.0
"""A body taller than this has legs and a head, or legs alone; a torso is shorter. Chosen by eye."""
_TRUNK = (0.56, 0.87)
"""Share of the height of a standing body between which its trunk's upper part lies, navel to chin: adults' crotch is at
.47, the nipples at .70 to .74."""
_BEHIND_MM = 25.0  # behind the middle between front and back at which the front ends: the trunk's sides are before it
_FACING_BACK = -0.3  # cosine from straight ahead of the normals of skin that is a back's
_SAID = 0.1  # share of the area that is worth a note
_WORTH_MM = 5.0  # a back less deep is not cut off
_MIDLINE_MM = 150.0  # skin this near to the middle shows how tall a body is: raised hands do not; chosen by eye
_FEET, _ANKLES = 0.03, (0.05, 0.09)  # share of the height of feet, and of ankles
_TOES_MM = 20.0  # by which feet stand out before the ankles at least; adults' have 50 to 90


def front_of_body(scan: RepairedScan, frame: Float64[Array, "3 3"]) -> RepairedScan:
    """Cut off the back, and of a whole body all but the upper trunk.

    Args:
        scan: a torso or a whole body, mm.
        frame: patient's left, head, straight ahead (rows).

    Returns:
        The same scan where there is nothing to cut off.
    """
    cut = scan
    if np.ptp(scan.mesh.vertices @ frame[1]) > WHOLE_BODY_MM:
        low, high = _trunk_heights(scan.mesh, frame[1])
        cut = _above(cut, frame[1], low)
        cut = _above(cut, -frame[1], -high)
    depth = _front_depth(cut.mesh, frame)
    if depth is not None and depth - float((cut.mesh.vertices @ frame[2]).min()) > _WORTH_MM:
        cut = _above(cut, frame[2], depth)
    if cut.mesh.area_mm2() > (1 - _SAID) * scan.mesh.area_mm2():
        return cut
    return replace(cut, notes=(*scan.notes, "Of the body, the front of the trunk alone is measured and shown."))


def ahead_by_feet(mesh: TriangleMesh, up: Float64[Array, 3]) -> Float64[Array, 3] | None:
    """Straight ahead of a whole body, as its feet point. None where there are none.

    Args:
        mesh: of a standing body, mm.
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
    """Middle of the box around some vertices."""
    points = mesh.vertices[chosen]
    return np.asarray((points.min(axis=0) + points.max(axis=0)) / 2)


def _trunk_heights(mesh: TriangleMesh, up: Float64[Array, 3]) -> tuple[float, float]:
    """Heights between which a standing body's upper trunk lies."""
    heights = mesh.vertices @ up
    beside = mesh.vertices - np.median(mesh.vertices, axis=0)
    beside -= np.outer(beside @ up, up)
    near = np.linalg.norm(beside, axis=1) < _MIDLINE_MM
    low, high = float(heights.min()), float(heights[near].max() if near.any() else heights.max())
    return low + _TRUNK[0] * (high - low), low + _TRUNK[1] * (high - low)


def _front_depth(mesh: TriangleMesh, frame: Float64[Array, "3 3"]) -> float | None:
    """Depth along straight ahead at which the front ends. None where the trunk's sides are not seen."""
    vectors = mesh.face_vectors()
    area = np.maximum(np.linalg.norm(vectors, axis=1), 1e-12)
    normals = vectors / area[:, None]
    ahead = normals @ frame[2] > _FACING_BACK
    skin = Skin(points_world=mesh.vertices[mesh.faces[ahead]].mean(axis=1), normals_world=normals[ahead])
    try:
        trunk = find_trunk(skin, frame)
    except MeasureError:
        return None
    return float(trunk.origin @ frame[2]) - _BEHIND_MM


def _above(scan: RepairedScan, direction: Float64[Array, 3], height: float) -> RepairedScan:
    """The largest part of a scan beyond a plane."""
    part = above(scan.mesh, lambda points: points @ direction - height).mesh
    if not len(part.faces):
        return scan
    away, nearest = point_tree(scan.mesh.vertices).query(part.vertices)
    kept = np.asarray(away) == 0
    return replace(scan, mesh=part, invented=kept & scan.invented[np.asarray(nearest)])
