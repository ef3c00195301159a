"""Exact closest points on a triangle mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from mammometry.geometry.arrays import Array, Bool, Float64, Int64, read_only
from mammometry.geometry.mesh import TriangleMesh

_FIRST_CANDIDATES = 6
_SIZE_RATIO = 4.0
_AT_ONCE = 200_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClosestPoints:
    """For each query point the nearest point of the surface."""

    points: Float64[Array, "n 3"]
    """On the mesh, in its frame, mm."""
    faces: Int64[Array, " n"]
    """The face that holds it."""
    distances_mm: Float64[Array, " n"]
    """Unsigned distance to it, mm."""

    def __post_init__(self) -> None:
        for field in ("points", "faces", "distances_mm"):
            object.__setattr__(self, field, read_only(getattr(self, field)))


def closest_on_mesh(points: Float64[Array, "n 3"], mesh: TriangleMesh, *, workers: int = 2) -> ClosestPoints:
    """Find the closest point of the mesh to each query point; exact, in the mesh's frame, mm.

    Faces are sorted into classes of similar size. In each class the faces with the nearest centres are tried, more
    and more of them until no untried face of the class can be nearer: its centre is farther away than the best
    distance plus the class's largest radius.

    Raises:
        ValueError: the mesh has no faces.
    """
    if len(mesh.faces) == 0:
        raise ValueError("closest point of a mesh without faces")
    corners = mesh.corners()
    centres = corners.mean(axis=1)
    radii = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)
    sizes = np.floor(np.log(np.maximum(radii, 1e-9)) / np.log(_SIZE_RATIO)).astype(int)
    best = np.full(len(points), np.inf)
    nearest = np.zeros((len(points), 3))
    face = np.zeros(len(points), dtype=np.int64)
    for size in np.unique(sizes):
        members = np.flatnonzero(sizes == size)
        tree = cKDTree(centres[members])
        reach = float(radii[members].max())
        for start in range(0, len(points), _AT_ONCE):
            chosen = slice(start, start + _AT_ONCE)
            _search_class(points, chosen, tree, members, corners, reach, best, nearest, face, workers)
    return ClosestPoints(points=nearest, faces=face, distances_mm=best)


def _search_class(
    points: Float64[Array, "n 3"],
    chosen: slice,
    tree: cKDTree,
    members: Int64[Array, " k"],
    corners: Float64[Array, "m 3 3"],
    reach: float,
    best: Float64[Array, " n"],
    nearest: Float64[Array, "n 3"],
    face: Int64[Array, " n"],
    workers: int,
) -> None:
    """Improve `best`, `nearest` and `face` for the chosen points by the faces of one class, in place."""
    open_points = np.arange(len(points))[chosen]
    tried, candidates = 0, min(_FIRST_CANDIDATES, len(members))
    while len(open_points):
        found_by_tree = tree.query(points[open_points], k=np.arange(tried + 1, candidates + 1), workers=workers)
        distance, number = np.asarray(found_by_tree[0]), np.asarray(found_by_tree[1])
        for column in range(candidates - tried):
            # A face whose centre lies farther than the best plus the radius cannot be nearer.
            useful = distance[:, column] - reach < best[open_points]
            index = open_points[useful]
            ids = members[number[useful, column]]
            on_face = closest_on_triangles(points[index], corners[ids])
            found = np.linalg.norm(points[index] - on_face, axis=1)
            better: Bool[Array, " k"] = found < best[index]
            best[index[better]] = found[better]
            nearest[index[better]] = on_face[better]
            face[index[better]] = ids[better]
        if candidates == len(members):
            return
        open_points = open_points[distance[:, -1] - reach < best[open_points]]
        tried, candidates = candidates, min(3 * candidates, len(members))


def closest_on_triangles(points: Float64[Array, "n 3"], triangles: Float64[Array, "n 3 3"]) -> Float64[Array, "n 3"]:
    """Closest point of each triangle to its own query point (Ericson, Real-Time Collision Detection, 5.1.5)."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    ab, ac, ap, bp, cp = b - a, c - a, points - a, points - b, points - c
    d1, d2 = _dot(ab, ap), _dot(ac, ap)
    d3, d4 = _dot(ab, bp), _dot(ac, bp)
    d5, d6 = _dot(ab, cp), _dot(ac, cp)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    with np.errstate(divide="ignore", invalid="ignore"):
        on_ab = a + (d1 / (d1 - d3))[:, None] * ab
        on_ac = a + (d2 / (d2 - d6))[:, None] * ac
        on_bc = b + ((d4 - d3) / ((d4 - d3) + (d5 - d6)))[:, None] * (c - b)
        total = va + vb + vc
        inner = a + (vb / total)[:, None] * ab + (vc / total)[:, None] * ac
    inner = np.where(np.isfinite(inner), inner, a)  # a triangle without area: one of its edges is nearest
    conditions = [
        (d1 <= 0) & (d2 <= 0),
        (d3 >= 0) & (d4 <= d3),
        (d6 >= 0) & (d5 <= d6),
        (vc <= 0) & (d1 >= 0) & (d3 <= 0),
        (vb <= 0) & (d2 >= 0) & (d6 <= 0),
        (va <= 0) & (d4 - d3 >= 0) & (d5 - d6 >= 0),
    ]
    result = inner
    for condition, choice in reversed(list(zip(conditions, (a, b, c, on_ab, on_ac, on_bc), strict=True))):
        result = np.where(condition[:, None], choice, result)
    return result


def _dot(a: Float64[Array, "n 3"], b: Float64[Array, "n 3"]) -> Float64[Array, " n"]:
    return np.einsum("ij,ij->i", a, b)
