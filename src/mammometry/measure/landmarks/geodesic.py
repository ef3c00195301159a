"""Shortest paths over a triangulated surface, like a tape measure.

Points are placed on the edges (Lanthier, Maheshwari and Sack 1997), and Dijkstra's algorithm finds the shortest path
from point to point. This is repeated with more points in a narrower belt that still contains the shortest path. The
length is never below the true one, and up to 0.4 % above it.
"""

from __future__ import annotations

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Bool, Float64, Int64
from mammometry.geometry.mesh import TriangleMesh, edge_table
from mammometry.geometry.nearest import closest_on_mesh
from mammometry.measure.landmarks.geodesic_kernels import shortest

_ROUNDS = ((0, 1.16), (1, 1.04), (4, 1.006), (12, 1.0))
"""For each round: points per edge, and length relative to the shortest up to which paths stay in the next round's belt
(1: last round). Along edges alone a path is up to 2/√3 = 1.155 times too long."""
_BELT = 0.4  # width added to the belt, in edge lengths: on a coarse mesh more than one row of faces; not critical
_PAIRS = 2_000_000  # most pairs of points in one face, all faces together; a fine mesh gets fewer points per edge
_SEARCHES = ((1.12, 10.0), (1.6, 40.0), (np.inf, 0.0))
"""Longest paths that are searched, one after the other: factor of the straight distance, plus mm. For speed only."""


@value(eq=False)
class SurfacePath:
    """A shortest path over a mesh."""

    points_world: Float64[Array, "k 3"]
    """From start to stop, each two neighbours in one triangle, mm, world frame."""
    length_mm: float


def geodesic(mesh: TriangleMesh, start_world: Float64[Array, 3], stop_world: Float64[Array, 3]) -> SurfacePath:
    """Shortest path over the surface between two points. Each is first projected onto the mesh.

    Args:
        mesh: the surface, mm, world frame; open or closed.
        start_world: near the surface, mm.
        stop_world: near the surface, mm.

    Raises:
        MeasureError: the surface does not connect the points.
    """
    ends = np.stack([start_world, stop_world])
    straight_mm = float(np.linalg.norm(start_world - stop_world))
    for factor, more_mm in _SEARCHES:
        most_mm = factor * straight_mm + more_mm if np.isfinite(factor) else np.inf
        ellipsoid = _in_ellipsoid(mesh, ends, most_mm)
        path = _path(mesh.submesh(ellipsoid), ends) if ellipsoid.any() else None
        # A path that leaves the ellipsoid is longer: a path's length bounds the sum of distances from its ends.
        if path is not None and path.length_mm + _moved_mm(path, ends) <= most_mm:
            return path
    raise MeasureError(
        "surface",
        found="two points on parts of it that are not connected",
        expected="one connected surface between them",
        remedy="Look for gaps in the surface, or pick the landmarks again",
    )


def _in_ellipsoid(mesh: TriangleMesh, ends: Float64[Array, "2 3"], most_mm: float) -> Bool[Array, " m"]:
    """Faces in the ellipsoid that contains all paths up to a length."""
    if not np.isfinite(most_mm):
        return np.ones(len(mesh.faces), dtype=bool)
    middle = ends.mean(axis=0)
    near = mesh.vertices_between(middle - most_mm / 2, middle + most_mm / 2)
    away = [np.linalg.norm(mesh.vertices[near] - end, axis=1) for end in ends]
    within = np.zeros(len(mesh.vertices), dtype=bool)
    within[near[away[0] + away[1] <= most_mm]] = True
    return mesh.faces_within(within)


def _moved_mm(path: SurfacePath, ends: Float64[Array, "2 3"]) -> float:
    return float(np.linalg.norm(path.points_world[[0, -1]] - ends, axis=1).sum())


def _path(local: TriangleMesh, ends: Float64[Array, "2 3"]) -> SurfacePath | None:
    nearest = closest_on_mesh(ends, local)
    if nearest.faces[0] == nearest.faces[1]:
        return SurfacePath(
            points_world=nearest.points, length_mm=float(np.linalg.norm(np.diff(nearest.points, axis=0)))
        )
    corners, last = local.faces.astype(np.int64), np.asarray(nearest.faces)
    size = local.vertices[local.faces[:, 1]] - local.vertices[local.faces[:, 0]]
    belt_mm = _BELT * float(np.median(np.linalg.norm(size, axis=1)))
    points = np.empty((0, 3))
    for wanted, slack in _ROUNDS:
        fitting = int(np.sqrt(_PAIRS / (3 * len(corners)) + 0.25) - 0.5)  # 3 k (k + 1) pairs a face
        places, of_face = _spread(local.vertices, corners, min(wanted, max(fitting, 1)))
        start, stop = len(places), len(places) + 1
        places = np.concatenate([places, nearest.points])
        own = np.full((len(corners), 1), -1)  # start and stop, each in its face
        own[last, 0] = start, stop
        of_face = np.concatenate([of_face, own], axis=1)
        distance, before = shortest(places, of_face, start, stop, slack, belt_mm)
        if not np.isfinite(distance[stop]):
            return None
        trail = [stop]
        while trail[-1] != start:
            trail.append(int(before[trail[-1]]))
        points = places[trail[::-1]]
        if slack == 1:
            break
        both = distance + shortest(places, of_face, stop, start, slack, belt_mm)[0]
        keep = both[of_face[:, :-1]].min(axis=1) <= distance[stop] * slack + belt_mm
        keep[last] = True
        corners, last = corners[keep], (np.cumsum(keep) - 1)[last]
    return SurfacePath(points_world=points, length_mm=float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum()))


def _spread(
    vertices: Float64[Array, "n 3"], faces: Int64[Array, "m 3"], per_edge: int
) -> tuple[Float64[Array, "k 3"], Int64[Array, "m c"]]:
    """Corners and evenly spaced points on the edges, and their indices for each face."""
    edges, of_face = edge_table(faces.astype(np.int32))
    share = ((np.arange(per_edge) + 1) / (per_edge + 1))[None, :, None]
    a, b = vertices[edges[:, 0], None], vertices[edges[:, 1], None]
    places = np.concatenate([vertices, (a + (b - a) * share).reshape(-1, 3)])
    on_edge = len(vertices) + np.arange(len(edges) * per_edge).reshape(len(edges), per_edge)
    return places, np.concatenate([faces, on_edge[of_face].reshape(len(faces), -1)], axis=1)
