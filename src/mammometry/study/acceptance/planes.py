"""Find the measured part of the largest plane in a mesh."""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from mammometry.geometry.arrays import Array, Bool, Float64, Int64
from mammometry.geometry.directions import even_directions
from mammometry.geometry.mesh import TriangleMesh
from mammometry.study.acceptance.fits import PlaneFit, fit_plane, within_rule
from mammometry.study.acceptance.patches import LEAST_POINTS, MOSTLY, REFITS, PatchError, PlanePatch, numbered
from mammometry.study.accuracy import vertex_areas_mm2

_NEAR_MM = 5.0  # half the thickness of the slab that counts as the plane's surface
_AROUND_MM = 15.0  # half the thickness of the slab whose points are the plane's neighbourhood
_CELLS = 48  # cells along the longer side of a plane
_EDGE = 2  # cells that are excluded at the edge of a plane
_DIRECTIONS = 1500  # number of normals that are compared: 6° apart
_LEAST_SHARE = 0.2  # smallest share of the mesh's area
_PARTS = (64, 32, 16)  # approximate numbers of parts of a plane, used for the uncertainty


def find_plane(mesh: TriangleMesh) -> PlanePatch:
    """Find the largest plane in a mesh.

    Raises:
        PatchError: no plane has a fifth of the mesh's area.
    """
    vectors = mesh.face_vectors()
    face_areas = np.linalg.norm(vectors, axis=1)
    directions = even_directions(_DIRECTIONS)
    tree = cKDTree(directions)
    real = face_areas > 0
    _, facing = tree.query(vectors[real] / face_areas[real, None])
    mass = np.bincount(facing, face_areas[real], minlength=len(directions))
    blurred = np.array([mass[tree.query_ball_point(direction, 0.25)].sum() for direction in directions])
    normal = vectors[vectors @ directions[np.argmax(blurred)] > np.cos(np.radians(15.0)) * face_areas].sum(axis=0)
    normal /= np.linalg.norm(normal)
    areas = vertex_areas_mm2(mesh)
    alike = mesh.vertex_normals() @ normal > np.cos(np.radians(30.0))
    fit = _robust_plane(mesh.vertices[alike], areas[alike], normal)
    deviations = fit.deviations(mesh.vertices)
    around = np.abs(deviations) < 2 * _AROUND_MM
    points, weights, deviations = mesh.vertices[around], areas[around], deviations[around]
    on, beside = np.abs(deviations) < _NEAR_MM, np.abs(deviations) < _AROUND_MM
    along = _in_plane(points, fit)
    low, span = along[on].min(axis=0), float(np.ptp(along[on], axis=0).max())
    index = np.floor((along - low) / (span / _CELLS)).astype(np.int64).clip(0, _CELLS - 1)
    cell = index[:, 0] * _CELLS + index[:, 1]
    good = _mostly(cell, weights, on, _CELLS**2).reshape(_CELLS, _CELLS)
    labels, count = ndimage.label(good)
    if count:
        largest = np.argmax(np.bincount(labels.ravel())[1:]) + 1
        good = ndimage.binary_erosion(np.pad(labels == largest, 1), iterations=_EDGE)[1:-1, 1:-1]
    inside = good.ravel()[cell]
    chosen = inside & beside
    share_left_out = float(np.mean(~beside[inside])) if inside.any() else 0.0
    points, weights = points[chosen], weights[chosen]
    if np.count_nonzero(chosen) < LEAST_POINTS or weights.sum() < _LEAST_SHARE * areas.sum() / 2:
        raise PatchError("no plane")
    fit = fit_plane(points, weights, normal)
    kept = within_rule(fit.deviations(points))
    fit = fit_plane(points[kept], weights[kept], normal)
    along = _in_plane(points, fit)
    along -= along.min(axis=0)
    rows = [np.floor(along / np.sqrt(weights.sum() / count)).astype(np.int64) for count in _PARTS]
    return PlanePatch(
        points=points,
        weights=weights,
        cells=tuple(numbered(row[:, 0] * 1000 + row[:, 1]) for row in rows),
        share_seen=1.0,
        share_left_out=share_left_out,
        fit=fit,
    )


def _robust_plane(points: Float64[Array, "n 3"], weights: Float64[Array, " n"], normal: Float64[Array, 3]) -> PlaneFit:
    if len(points) < LEAST_POINTS:
        raise PatchError("no plane")
    heights = points @ normal
    bins = np.floor((heights - heights.min()) / _NEAR_MM).astype(np.int64)
    mass = np.bincount(bins, weights)
    at = heights.min() + (np.argmax(mass) + 0.5) * _NEAR_MM
    fit, gate = PlaneFit(point=at * normal, normal=normal), 4 * _NEAR_MM
    for _ in range(REFITS):
        near = np.abs(fit.deviations(points)) < gate
        if np.count_nonzero(near) < LEAST_POINTS:
            raise PatchError("no plane")
        fit = fit_plane(points[near], weights[near], normal)
        gate = max(gate / 1.5, _NEAR_MM)
    return fit


def _in_plane(points: Float64[Array, "n 3"], fit: PlaneFit) -> Float64[Array, "n 2"]:
    """Coordinates of points along a plane, mm."""
    first = np.eye(3)[np.argmin(np.abs(fit.normal))]
    right = np.cross(first, fit.normal)
    right /= np.linalg.norm(right)
    return np.asarray((points - fit.point) @ np.stack([right, np.cross(fit.normal, right)]).T)


def _mostly(
    cell: Int64[Array, " n"], weights: Float64[Array, " n"], on: Bool[Array, " n"], count: int
) -> Bool[Array, " k"]:
    """Cells with points of which most of the area is on the surface."""
    total = np.bincount(cell, weights, minlength=count)
    return np.asarray((total > 0) & (np.bincount(cell, weights * on, minlength=count) > MOSTLY * total))
