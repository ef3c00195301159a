"""Find the measured part of one or two balls in a mesh."""

from __future__ import annotations

from functools import cache
from itertools import combinations
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from mammometry.base.normal import MAD
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.directions import even_directions
from mammometry.geometry.mesh import TriangleMesh
from mammometry.study.acceptance.fits import SphereFit, fit_sphere, within_rule
from mammometry.study.acceptance.patches import LEAST_POINTS, MOSTLY, REFITS, PatchError, SpherePatch, numbered
from mammometry.study.accuracy import vertex_areas_mm2

_VOTES = 15_000  # most vertices that vote for a centre
_BIN = 0.1  # side of a bin for votes, relative to the radius
_CANDIDATES = 6  # peaks that are examined
_NEAR = 0.05  # half the thickness of the shell that counts as the sphere's surface, relative to the radius
_AROUND = 0.2  # half the thickness of the shell whose points are the ball's neighbourhood, relative to the radius
_CELLS = 3000  # number of directions over a whole sphere: cells of 4°
_BLUR_RAD = np.radians(8.0)  # radius around a cell over which the share of its surface is averaged
_LARGEST_AREA = 2.0  # largest area of a point in the search, relative to the median: faces at outliers are large
_OUTWARDS = 0.5  # smallest cosine between normal and radius of a ball: rods and tables have less
_EDGE_RAD = np.radians(14.0)  # width excluded next to other objects: with the blur, 6° at the ball's rim
_LEAST_SHARE = 0.08  # smallest visible share of a sphere
_ROBUST_POINTS = 10_000  # most points of a ball in the robust fit
_TUKEY = 4.685  # robust standard deviations beyond which a point has no weight
_PARTS = (150, 75, 40, 20, 14)
"""Numbers of cells on a whole sphere, used for the uncertainty; half as many on a patch. The largest are 28 mm wide on
a ball of 60 mm. With only the first three sizes, errors common to points within 8 mm made the uncertainty a fifth too
small."""


def find_sphere(mesh: TriangleMesh, diameter_mm: float) -> SpherePatch:
    """Find a ball in a mesh that may contain its stand and a table, too.

    Args:
        mesh: mm.
        diameter_mm: diameter of the ball, to within 10 %.

    Raises:
        PatchError: there is no such ball, or too little of it is visible.
    """
    found = _candidates(mesh, diameter_mm)
    if not found:
        raise PatchError(f"no ball of {diameter_mm:g} mm")
    return max(found, key=lambda patch: float(patch.weights.sum()))


def find_two_spheres(mesh: TriangleMesh, diameter_mm: float, distance_mm: float) -> tuple[SpherePatch, SpherePatch]:
    """Find two equal balls whose distance is closest to the given one.

    Args:
        mesh: mm.
        diameter_mm: diameter of both balls, to within 10 %.
        distance_mm: distance between their centres, to within 10 %.

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
    for sign in (-1.0, 1.0):  # 1: the mesh is inside out
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
    """Points with most votes, in decreasing order, at least a diameter apart."""
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
    if len(points) < LEAST_POINTS:
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
    good = close @ own > MOSTLY * (close @ area)
    bad = np.flatnonzero(~good)
    if len(bad):
        apart, _ = cKDTree(directions[bad]).query(directions)
        good &= apart > 2 * np.sin(_EDGE_RAD / 2)
    share = float(good.mean())
    chosen = good[cell] & beside
    inside = good[cell] & (deviations > -0.5 * radius)
    if share < _LEAST_SHARE or np.count_nonzero(chosen) < LEAST_POINTS:
        raise PatchError(f"{100 * share:.0f} % of a ball")
    points, weights = points[chosen], weights[chosen]
    kept = within_rule(fit.deviations(points))
    last = fit_sphere(points[kept], weights[kept], fit)
    kept = within_rule(last.deviations(points))
    unit = (points - last.centre) / last.radius_mm
    return SpherePatch(
        points=points,
        weights=weights,
        cells=tuple(numbered(cKDTree(even_directions(count)).query(unit)[1]) for count in _PARTS),
        share_seen=share,
        share_left_out=float(np.mean(~beside[inside])),
        fit=fit_sphere(points[kept], weights[kept], last),
    )


@cache
def _sphere_cells() -> tuple[Float64[Array, "k 3"], Any]:
    """Directions of the cells, and which cells are near each other, as a sparse matrix."""
    directions = even_directions(_CELLS)
    pairs = cKDTree(directions).query_pairs(2 * np.sin(_BLUR_RAD / 2), output_type="ndarray")
    rows, columns = np.concatenate([pairs, pairs[:, ::-1], np.arange(_CELLS)[:, None].repeat(2, axis=1)]).T
    return directions, csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(_CELLS, _CELLS))


def _robust(start: SphereFit, points: Float64[Array, "n 3"], weights: Float64[Array, " n"]) -> SphereFit:
    """Sphere that fits most of the points near the start, with Tukey's weights."""
    fit, gate = start, _AROUND * start.radius_mm
    for _ in range(REFITS):
        deviations = fit.deviations(points)
        near = np.abs(deviations) < gate
        if np.count_nonzero(near) < LEAST_POINTS:
            raise PatchError("too few points")
        spread = max(MAD * float(np.median(np.abs(deviations[near]))), 1e-6)
        gate = min(gate, max(_TUKEY * spread, _NEAR * start.radius_mm))
        part = deviations[near] / gate
        fit = fit_sphere(points[near], weights[near] * (1 - part**2).clip(0) ** 2, fit)
    return fit
