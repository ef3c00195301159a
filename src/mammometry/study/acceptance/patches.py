"""Find the measured part of a sphere or a plane in a mesh.

Stands, tables and edges are left out by place alone, never by the deviation of a point.
"""

from __future__ import annotations

from functools import cache
from itertools import combinations
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from mammometry.base.normal import MAD
from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Bool, Float64, Int64
from mammometry.geometry.directions import even_directions
from mammometry.geometry.mesh import TriangleMesh
from mammometry.study.acceptance.fits import (
    PlaneFit,
    SphereFit,
    fit_plane,
    fit_sphere,
    within_rule,
)
from mammometry.study.accuracy import vertex_areas_mm2

_VOTES = 15_000  # vertices that vote for a centre at most
_BIN = 0.1  # side of a bin for votes, relative to the radius
_CANDIDATES = 6  # peaks that are looked at
_NEAR = 0.05  # half the shell around a sphere that counts as its surface, relative to the radius
_AROUND = 0.2  # half the shell whose points are the ball's neighbourhood, relative to the radius
_CELLS = 3000  # directions over a whole sphere: cells of 4°
_BLUR_RAD = np.radians(8.0)  # around a cell, over which the share of its surface is taken
_MOSTLY = 0.6  # share of a cell's area that must lie on the surface; more is another object beside it
_LARGEST_AREA = 2.0  # of a point in the search, of their median: faces at outliers are large
_OUTWARDS = 0.5  # cosine between a ball's normal and its radius at least: rods and tables have less
_EDGE_RAD = np.radians(14.0)  # around what is not the ball: with the blur, 6° at its rim are left out
_LEAST_SHARE = 0.08  # of a sphere that must be seen
_LEAST_POINTS = 300  # of a patch
_ROBUST_POINTS = 10_000  # of a ball in the robust fit at most
_REFITS = 12  # of the robust fit that finds a patch
_TUKEY = 4.685  # robust standard deviations, beyond which a point has no weight
_PLANE_NEAR_MM = 5.0  # half the slab around a plane that counts as its surface
_PLANE_AROUND_MM = 15.0  # half the slab whose points are the plane's neighbourhood
_PLANE_CELLS = 48  # along the longer side of a plane
_PLANE_EDGE = 2  # cells at the edge of a plane that are left out
_PLANE_DIRECTIONS = 1500  # of normals that are compared: cells of 6°
_LEAST_PLANE = 0.2  # share of the mesh's area that the plane must have
_PARTS = (150, 75, 40, 20, 14)
"""Cells of a whole sphere, for the uncertainty: half as many on a patch. The largest are 28 mm wide on a ball of 60 mm:
with the usual three sizes alone, errors that points share over 8 mm made the uncertainty a fifth too small."""
_PLANE_PARTS = (64, 32, 16)  # of a plane, for the uncertainty, about


class PatchError(ValueError):
    """The artefact is not in the mesh, as one phrase."""


@value(eq=False)
class ArtefactPatch:
    """Measured points of one artefact's surface."""

    points: Float64[Array, "n 3"]
    """Positions, mm, mesh's frame."""
    weights: Float64[Array, " n"]
    """Area of the surface that belongs to each point, mm²."""
    cells: tuple[Int64[Array, " n"], ...]
    """Number of the part of the surface that contains each point, for several sizes of parts."""
    share_seen: float
    """Share of a sphere's surface that was evaluated. 1 for a plane."""
    share_left_out: float
    """Share of the points in front of or behind this part of the surface that are too far away to belong to it."""
    fit: SphereFit | PlaneFit
    """Fit to the points without the 0.3 % with the largest deviations."""

    @property
    def deviations_mm(self) -> Float64[Array, " n"]:
        """Distances of all points from the fit, mm. Positive outside a sphere, and in front of a plane."""
        return self.fit.deviations(self.points)


@value(eq=False)
class SpherePatch(ArtefactPatch):
    """Points of a sphere."""

    fit: SphereFit


@value(eq=False)
class PlanePatch(ArtefactPatch):
    """Points of a plane."""

    fit: PlaneFit


# --- spheres ---


def find_sphere(mesh: TriangleMesh, diameter_mm: float) -> SpherePatch:
    """Find a ball in a mesh that may hold its stand and a table too.

    Args:
        mesh: mm.
        diameter_mm: of the ball, within 10 %.

    Raises:
        PatchError: there is no such ball, or too little of it.
    """
    found = _candidates(mesh, diameter_mm)
    if not found:
        raise PatchError(f"no ball of {diameter_mm:g} mm")
    return max(found, key=lambda patch: float(patch.weights.sum()))


def find_two_spheres(mesh: TriangleMesh, diameter_mm: float, distance_mm: float) -> tuple[SpherePatch, SpherePatch]:
    """Find two equal balls whose distance is nearest to the given one.

    Args:
        mesh: mm.
        diameter_mm: of both balls, within 10 %.
        distance_mm: of their centres, within 10 %.

    Raises:
        PatchError: there are no such balls.
    """
    found = _candidates(mesh, diameter_mm)
    if len(found) < 2:
        raise PatchError(f"{'one ball' if found else 'no ball'} of {diameter_mm:g} mm, not two")

    def distance(pair: tuple[SpherePatch, SpherePatch]) -> float:
        return float(np.linalg.norm(pair[0].fit.centre - pair[1].fit.centre))

    pair = min(combinations(found, 2), key=lambda pair: abs(distance(pair) - distance_mm))
    if abs(distance(pair) / distance_mm - 1) > 0.1:
        raise PatchError(f"two balls {distance(pair):.1f} mm apart, not {distance_mm:g} mm")
    return pair


def _candidates(mesh: TriangleMesh, diameter_mm: float) -> list[SpherePatch]:
    areas = vertex_areas_mm2(mesh)
    normals = mesh.vertex_normals()
    step = max(1, len(areas) // _VOTES)
    radius = diameter_mm / 2
    found: list[SpherePatch] = []
    for sign in (-1.0, 1.0):  # of a mesh that is inside out
        votes = (mesh.vertices + sign * radius * normals)[::step]
        for centre in _peaks(votes, areas[::step], radius):
            try:
                patch = _sphere_patch(mesh, areas, -sign * normals, SphereFit(centre=centre, radius_mm=radius))
            except (PatchError, np.linalg.LinAlgError):
                continue
            if all(np.linalg.norm(patch.fit.centre - other.fit.centre) > radius for other in found):
                found.append(patch)
        if found:
            break
    return found


def _peaks(votes: Float64[Array, "n 3"], weights: Float64[Array, " n"], radius: float) -> list[Float64[Array, 3]]:
    """Places where most votes meet, the most first, at least a diameter apart."""
    keys, place = np.unique(np.floor(votes / (_BIN * radius)).astype(np.int64), axis=0, return_inverse=True)
    mass = np.bincount(place.ravel(), weights, minlength=len(keys))
    tree = cKDTree(keys.astype(np.float64))
    best = np.argsort(mass)[::-1][: 20 * _CANDIDATES]
    around = np.array([mass[tree.query_ball_point(keys[index], 1.8)].sum() for index in best])
    peaks: list[Float64[Array, 3]] = []
    for index in best[np.argsort(around)[::-1]]:
        centre = (keys[index] + 0.5) * _BIN * radius
        for _ in range(10):  # mean shift
            near = ((votes - centre) ** 2).sum(axis=1) < (2 * _BIN * radius) ** 2
            if not near.any():
                break
            centre = np.average(votes[near], axis=0, weights=weights[near])
        if all(np.linalg.norm(centre - other) > 1.5 * radius for other in peaks):
            peaks.append(centre)
        if len(peaks) == _CANDIDATES:
            break
    return peaks


def _sphere_patch(
    mesh: TriangleMesh, areas: Float64[Array, " n"], normals: Float64[Array, "n 3"], start: SphereFit
) -> SpherePatch:
    near_mm, radius = mesh.vertices - start.centre, start.radius_mm
    around = np.flatnonzero((near_mm**2).sum(axis=1) < (1.5 * radius) ** 2)
    points, weights = mesh.vertices[around], areas[around]
    if len(points) < _LEAST_POINTS:
        raise PatchError("too few points")
    shell = np.abs(start.deviations(points)) < _BIN * radius
    if weights[shell].sum() < _LEAST_SHARE / 2 * 4 * np.pi * radius**2:
        raise PatchError("too little of a ball")
    thin = slice(None, None, max(1, len(points) // _ROBUST_POINTS))
    fit = _robust(start, points[thin], weights[thin])
    if abs(fit.radius_mm / radius - 1) > 0.1:
        raise PatchError(f"a ball of {2 * fit.radius_mm:.1f} mm")
    deviations = fit.deviations(points)
    on = np.abs(deviations) < _NEAR * radius
    beside = np.abs(deviations) < _AROUND * radius
    directions, close = _sphere_cells()
    away = points - fit.centre
    unit = away / np.maximum(np.linalg.norm(away, axis=1), 1e-9)[:, None]
    cell = np.asarray(cKDTree(directions).query(unit)[1], dtype=np.int64)
    faces_out = (unit * normals[around]).sum(axis=1) > _OUTWARDS
    usual = np.minimum(weights, _LARGEST_AREA * np.median(weights[on]))
    area, own = (np.bincount(cell, usual * part, minlength=_CELLS) for part in (beside, on & faces_out))
    good = close @ own > _MOSTLY * (close @ area)
    bad = np.flatnonzero(~good)
    if len(bad):
        apart, _ = cKDTree(directions[bad]).query(directions)
        good &= apart > 2 * np.sin(_EDGE_RAD / 2)
    share = float(good.mean())
    chosen = good[cell] & beside
    inside = good[cell] & (deviations > -0.5 * radius)
    if share < _LEAST_SHARE or np.count_nonzero(chosen) < _LEAST_POINTS:
        raise PatchError(f"{100 * share:.0f} % of a ball")
    points, weights = points[chosen], weights[chosen]
    kept = within_rule(fit.deviations(points))
    last = fit_sphere(points[kept], weights[kept], fit)
    kept = within_rule(last.deviations(points))
    unit = (points - last.centre) / last.radius_mm
    return SpherePatch(
        points=points,
        weights=weights,
        cells=tuple(_numbered(cKDTree(even_directions(count)).query(unit)[1]) for count in _PARTS),
        share_seen=share,
        share_left_out=float(np.mean(~beside[inside])),
        fit=fit_sphere(points[kept], weights[kept], last),
    )


@cache
def _sphere_cells() -> tuple[Float64[Array, "k 3"], Any]:
    """Directions of cells, and which cells are close to one another, as a sparse matrix."""
    directions = even_directions(_CELLS)
    pairs = cKDTree(directions).query_pairs(2 * np.sin(_BLUR_RAD / 2), output_type="ndarray")
    rows, columns = np.concatenate([pairs, pairs[:, ::-1], np.arange(_CELLS)[:, None].repeat(2, axis=1)]).T
    return directions, csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(_CELLS, _CELLS))


def _robust(start: SphereFit, points: Float64[Array, "n 3"], weights: Float64[Array, " n"]) -> SphereFit:
    """Sphere of most of the points near the start, with Tukey's weights."""
    fit, gate = start, _AROUND * start.radius_mm
    for _ in range(_REFITS):
        deviations = fit.deviations(points)
        near = np.abs(deviations) < gate
        if np.count_nonzero(near) < _LEAST_POINTS:
            raise PatchError("too few points")
        spread = max(MAD * float(np.median(np.abs(deviations[near]))), 1e-6)
        gate = min(gate, max(_TUKEY * spread, _NEAR * start.radius_mm))
        part = deviations[near] / gate
        fit = fit_sphere(points[near], weights[near] * (1 - part**2).clip(0) ** 2, fit)
    return fit


def _numbered(cells: Any) -> Int64[Array, " n"]:
    """Cells numbered from 0 without gaps."""
    return np.unique(cells, return_inverse=True)[1].ravel().astype(np.int64)


def _mostly(
    cell: Int64[Array, " n"], weights: Float64[Array, " n"], on: Bool[Array, " n"], count: int
) -> Bool[Array, " k"]:
    """Cells with points, most of whose area lies on the surface."""
    total = np.bincount(cell, weights, minlength=count)
    return np.asarray((total > 0) & (np.bincount(cell, weights * on, minlength=count) > _MOSTLY * total))


# --- planes ---


def find_plane(mesh: TriangleMesh) -> PlanePatch:
    """Find the largest plane in a mesh.

    Raises:
        PatchError: no plane has a fifth of the mesh's area.
    """
    vectors = mesh.face_vectors()
    face_areas = np.linalg.norm(vectors, axis=1)
    directions = even_directions(_PLANE_DIRECTIONS)
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
    around = np.abs(deviations) < 2 * _PLANE_AROUND_MM
    points, weights, deviations = mesh.vertices[around], areas[around], deviations[around]
    on, beside = np.abs(deviations) < _PLANE_NEAR_MM, np.abs(deviations) < _PLANE_AROUND_MM
    along = _in_plane(points, fit)
    low, span = along[on].min(axis=0), float(np.ptp(along[on], axis=0).max())
    index = np.floor((along - low) / (span / _PLANE_CELLS)).astype(np.int64).clip(0, _PLANE_CELLS - 1)
    cell = index[:, 0] * _PLANE_CELLS + index[:, 1]
    good = _mostly(cell, weights, on, _PLANE_CELLS**2).reshape(_PLANE_CELLS, _PLANE_CELLS)
    labels, count = ndimage.label(good)
    if count:
        largest = np.argmax(np.bincount(labels.ravel())[1:]) + 1
        good = ndimage.binary_erosion(np.pad(labels == largest, 1), iterations=_PLANE_EDGE)[1:-1, 1:-1]
    inside = good.ravel()[cell]
    chosen = inside & beside
    share_left_out = float(np.mean(~beside[inside])) if inside.any() else 0.0
    points, weights = points[chosen], weights[chosen]
    if np.count_nonzero(chosen) < _LEAST_POINTS or weights.sum() < _LEAST_PLANE * areas.sum() / 2:
        raise PatchError("no plane")
    fit = fit_plane(points, weights, normal)
    kept = within_rule(fit.deviations(points))
    fit = fit_plane(points[kept], weights[kept], normal)
    along = _in_plane(points, fit)
    along -= along.min(axis=0)
    rows = [np.floor(along / np.sqrt(weights.sum() / count)).astype(np.int64) for count in _PLANE_PARTS]
    return PlanePatch(
        points=points,
        weights=weights,
        cells=tuple(_numbered(row[:, 0] * 1000 + row[:, 1]) for row in rows),
        share_seen=1.0,
        share_left_out=share_left_out,
        fit=fit,
    )


def _robust_plane(points: Float64[Array, "n 3"], weights: Float64[Array, " n"], normal: Float64[Array, 3]) -> PlaneFit:
    if len(points) < _LEAST_POINTS:
        raise PatchError("no plane")
    heights = points @ normal
    bins = np.floor((heights - heights.min()) / _PLANE_NEAR_MM).astype(np.int64)
    mass = np.bincount(bins, weights)
    at = heights.min() + (np.argmax(mass) + 0.5) * _PLANE_NEAR_MM
    fit, gate = PlaneFit(point=at * normal, normal=normal), 4 * _PLANE_NEAR_MM
    for _ in range(_REFITS):
        near = np.abs(fit.deviations(points)) < gate
        if np.count_nonzero(near) < _LEAST_POINTS:
            raise PatchError("no plane")
        fit = fit_plane(points[near], weights[near], normal)
        gate = max(gate / 1.5, _PLANE_NEAR_MM)
    return fit


def _in_plane(points: Float64[Array, "n 3"], fit: PlaneFit) -> Float64[Array, "n 2"]:
    """Coordinates of points along a plane, mm."""
    first = np.eye(3)[np.argmin(np.abs(fit.normal))]
    right = np.cross(first, fit.normal)
    right /= np.linalg.norm(right)
    return np.asarray((points - fit.point) @ np.stack([right, np.cross(fit.normal, right)]).T)
