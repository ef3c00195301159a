"""Detection of an object on a breast (a hand, an arm or a strap) by its grooves.

A scan merges the object and the breast into one surface, with a sharp groove between them. A bare breast is convex
inside its border (docs/decisions/0048).
"""

from __future__ import annotations

import numpy as np

from mammometry.geometry import Array, Bool, Float64, Int64
from mammometry.geometry.nearest import point_tree
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.boundary.breasts import within_outline
from mammometry.measure.boundary.overlap import Overlap
from mammometry.surface.repair.repair import Provenance, RepairedSurface

_SAMPLE_MM = 3.0  # one vertex per cube of this side: finer than the groove beside a finger, 10 mm
_DISC_MM, _RING_MM = 5.0, (10.0, 16.0)  # radius of the disc, and radii of the ring around it: half to one finger
_GROOVE_MM = 1.5
"""Least depth of the disc's mean below the ring's, mm. Noise of a telephone's scans reaches 0.5; a hand 25 mm thick has
3 to 8."""
_INSIDE_MM = 20.0  # least distance from the border: its uncertainty, 7 mm, and the ring's radius; the fold is a groove
_FEWEST_PAIRS = 4  # fewest samples of a ring


def find_overlap(boundary: Boundary, surface: RepairedSurface) -> Overlap:
    """Area of grooves inside a breast's border, on measured skin.

    Args:
        boundary: closed curve around the breast, mm, world frame.
        surface: the repaired mesh, mm, world frame.
    """
    curve = boundary.points_world
    middle = curve.mean(axis=0)
    across = np.linalg.svd(curve - middle, full_matrices=False)[2][:2].T
    reach_mm = float(np.linalg.norm(curve - middle, axis=1).max())
    chosen = _samples(surface, middle, 2 * reach_mm)
    points, normals = surface.mesh.vertices[chosen], surface.mesh.vertex_normals()[chosen]
    if not len(points):
        return Overlap(name=boundary.name, groove_cm2=0.0)
    inside = within_outline((points - middle) @ across, (curve - middle) @ across)
    between = np.concatenate([curve, (curve + np.roll(curve, -1, axis=0)) / 2])
    inside &= np.asarray(point_tree(between).query(points)[0]) > _INSIDE_MM
    depth_mm, area_mm2 = _grooves(points, normals)
    return Overlap(name=boundary.name, groove_cm2=float(area_mm2[inside & (depth_mm > _GROOVE_MM)].sum()) / 100)


def _samples(surface: RepairedSurface, middle: Float64[Array, 3], reach_mm: float) -> Int64[Array, " n"]:
    """One measured vertex per cube around a breast."""
    vertices = surface.mesh.vertices
    measured: Bool[Array, " n"] = surface.provenance == Provenance.MEASURED
    near = np.flatnonzero(measured & (np.linalg.norm(vertices - middle, axis=1) < reach_mm))
    cells = np.floor(vertices[near] / _SAMPLE_MM).astype(np.int64)
    return near[np.unique(cells, axis=0, return_index=True)[1]]


def _grooves(
    points: Float64[Array, "n 3"], normals: Float64[Array, "n 3"]
) -> tuple[Float64[Array, " n"], Float64[Array, " n"]]:
    """Depth of each sample's disc below the ring around it, mm, and the area of skin per sample, mm²."""
    tree = point_tree(points)
    pairs = tree.sparse_distance_matrix(tree, _RING_MM[1], output_type="ndarray")
    row, column, away = pairs["i"], pairs["j"], pairs["v"]
    count = len(points)

    def mean(
        kept: Bool[Array, " p"], values: Float64[Array, "n 3"]
    ) -> tuple[Float64[Array, "n 3"], Int64[Array, " n"]]:
        number = np.bincount(row[kept], minlength=count)
        sums = [np.bincount(row[kept], axis[column[kept]], minlength=count) for axis in values.T]
        return np.stack(sums, axis=1) / np.maximum(number, 1)[:, None], number

    disc, within = mean(away < _DISC_MM, points)
    ring, around = mean(away >= _RING_MM[0], points)
    normal, _ = mean(away >= 0, normals)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    depth_mm = np.where(around >= _FEWEST_PAIRS, ((ring - disc) * normal).sum(axis=1), -np.inf)
    return depth_mm, np.pi * _DISC_MM**2 / np.maximum(within, 1)
