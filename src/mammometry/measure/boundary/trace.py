"""Projection of a curve onto a mesh: a closed path of edges, along which the mesh can be cut."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from mammometry.base.errors import CrossingError, MeasureError
from mammometry.geometry import Array, Float64, Int64, mesh_kernels
from mammometry.geometry.curves import closed_length_mm, evenly_spaced
from mammometry.geometry.mesh import TriangleMesh, unique_edges
from mammometry.geometry.nearest import closest_on_mesh, point_tree
from mammometry.measure.solid.cut import OpenPart

_STEP_MM = 3.0  # spacing of the stops along a curve, about an edge's length
_STOPS = (1, 4, 12)  # the path passes every n-th stop; the values are tried one after the other until it is simple
BANDS_MM = (6.0, 12.0, 25.0, 40.0)  # half widths of the band around the curve, tried one after the other; not critical
_BESIDE_HOLE_MM = BANDS_MM[1]  # largest distance from the curve where an opening follows the edge of a hole
_OFF_MESH_MM = 5.0  # largest distance of a curve from its mesh; not critical
REACH_MM = BANDS_MM[-1] + _OFF_MESH_MM
"""Largest distance from a curve at which the mesh affects its path, mm."""
_OPEN_MM = 20.0  # gap from which a curve is open, if it is also `_GAP_STEPS` median steps; not critical
_GAP_STEPS = 5  # median steps: see `_OPEN_MM`
_LEG_COST = 30.0  # cost limit of a leg between stops; most cost less: `_STEP_MM` long, a few mm off the curve
_WIDER = 8.0  # factor on that limit if no path is found


def check_curve(name: str, points_world: Float64[Array, "n 3"], mesh: TriangleMesh) -> None:
    """Raise a MeasureError if a curve is open, crosses itself or is off the mesh."""
    gaps = np.linalg.norm(points_world - np.roll(points_world, 1, axis=0), axis=1)
    if gaps[0] > max(_GAP_STEPS * np.median(gaps[1:]), _OPEN_MM):
        raise MeasureError(
            f"boundary {name!r}",
            found=f"a gap of {gaps[0]:.0f} mm between its last point and its first",
            expected="a closed curve",
            remedy="Draw the boundary all the way around",
        )
    crossings = len(crossing_points(points_world))
    if crossings:
        raise CrossingError(
            f"boundary {name!r}",
            found=f"a curve that crosses itself {crossings} time{'s' if crossings > 1 else ''}",
            expected="a simple closed curve",
            remedy="Redraw the boundary so that it runs once around the breast",
        )
    distance = np.array(point_tree(mesh.vertices).query(points_world)[0])
    far = distance > _OFF_MESH_MM
    if far.any() and len(mesh.faces):  # distances to vertices: a coarse mesh's faces may be nearer
        distance[far] = closest_on_mesh(points_world[far], mesh).distances_mm
    off = distance > _OFF_MESH_MM
    if off.any():
        raise MeasureError(
            f"boundary {name!r}",
            found=f"{int(off.sum())} of {len(off)} points off the surface, by up to {distance.max():.0f} mm",
            expected=f"all of them within {_OFF_MESH_MM:.0f} mm of it",
            remedy="Check that boundary and surface are of the same session, in the same frame and in millimetres",
            mesh_remedy="Check that boundary and mesh belong together, in the same frame and in millimetres",
        )


def crossing_points(points: Float64[Array, "n 3"]) -> Float64[Array, "k 3"]:
    """Points at which a closed curve crosses itself in its best plane, less than 5 mm apart in depth, mm."""
    centred = points - points.mean(axis=0)
    flat = centred @ np.linalg.svd(centred, full_matrices=False)[2].T
    start, step = flat, np.roll(flat, -1, axis=0) - flat
    i, j = np.triu_indices(len(points), 2)
    apart = start[j] - start[i]
    turn = step[i, 0] * step[j, 1] - step[i, 1] * step[j, 0]
    turn = np.where(turn == 0, np.inf, turn)  # parallel edges do not cross
    s = (apart[:, 0] * step[j, 1] - apart[:, 1] * step[j, 0]) / turn
    t = (apart[:, 0] * step[i, 1] - apart[:, 1] * step[i, 0]) / turn
    depth = np.abs(start[i, 2] + s * step[i, 2] - start[j, 2] - t * step[j, 2])
    neighbours = (i == 0) & (j == len(points) - 1)
    meet = (s > 0) & (s < 1) & (t > 0) & (t < 1) & (depth < _OFF_MESH_MM) & ~neighbours & np.isfinite(turn)
    i, s = i[meet], s[meet, None]
    return np.asarray(points[i] + s * (np.roll(points, -1, axis=0)[i] - points[i]))


def edge_loop(name: str, points_world: Float64[Array, "n 3"], mesh: TriangleMesh) -> Int64[Array, " k"]:
    """Vertices of a simple closed path of mesh edges, as close to a curve as possible.

    On folded, unmeasured skin, the vertices nearest to the curve alternate between folds, and the path meets itself. It
    is then led through fewer of them, with shortest paths over the surface in between.

    Raises:
        MeasureError: the path cannot be closed, or the curve runs back along itself.
    """
    curve = _resampled(points_world)
    low, high = curve.min(axis=0) - BANDS_MM[-1], curve.max(axis=0) + BANDS_MM[-1]
    near = mesh.vertices_between(low, high)
    tree = point_tree(curve)
    paths = 0
    for reach in BANDS_MM:
        away = np.asarray(tree.query(mesh.vertices[near], distance_upper_bound=reach)[0])
        within = np.isfinite(away)
        band, away = near[within], away[within]
        vertices, edges = mesh.vertices[band], _edges_between(band, mesh)
        steps = vertices[edges[:, 1]] - vertices[edges[:, 0]]
        length = np.sqrt(np.einsum("ij,ij->i", steps, steps))
        apart = away[edges[:, 0]] + away[edges[:, 1]]
        # In the widest band the path may leave the curve, around a pocket in unmeasured skin.
        strictness = apart**2 if reach < BANDS_MM[-1] else apart / BANDS_MM[0]
        cost = length * (1 + strictness) + 1e-9
        for every in _STOPS:
            path = _path(curve[::every], vertices, edges, cost)
            if path is None:
                break
            paths += 1
            simple = _without_spurs(path)
            if simple is not None:
                return band[simple]
    if paths:
        raise _broken(name, "a curve that runs back along itself")
    raise _broken(name, f"a place farther than {BANDS_MM[-1]:.0f} mm from any connected surface")


def check_beside_holes(name: str, points_world: Float64[Array, "n 3"], part: OpenPart, mesh: TriangleMesh) -> None:
    """Raise an error if a part's opening goes around a hole of the mesh, far from its curve.

    Args:
        name: name of the boundary.
        points_world: its curve, mm.
        part: the part that was cut out along it.
        mesh: the mesh that it was cut from.

    Raises:
        MeasureError: it states the distance.
    """
    rim = mesh.vertices[mesh_kernels.open_vertices(len(mesh.vertices), mesh.faces)]
    opening = part.mesh.vertices[np.concatenate(part.loops)]
    on_rim = opening[np.asarray(point_tree(rim).query(opening)[0]) == 0] if len(rim) else rim
    away_mm = float(np.max(point_tree(_resampled(points_world)).query(on_rim)[0], initial=0.0))
    if away_mm > _BESIDE_HOLE_MM:
        raise MeasureError(
            f"boundary {name!r}",
            found=f"a hole in the mesh under it, whose edge is {away_mm:.0f} mm from the boundary",
            expected="skin along the whole boundary",
            remedy="Scan the breast again so that its fold is visible: lying, leaning, or with the breast lifted",
        )


def _edges_between(vertices: Int64[Array, " b"], mesh: TriangleMesh) -> Int64[Array, "e 2"]:
    """Edges with both ends in a list of vertices, each once, as indices into the list, smaller first."""
    number = np.full(len(mesh.vertices), -1, dtype=np.int64)
    number[vertices] = np.arange(len(vertices))
    starts, stops = number[mesh.faces].ravel(), number[mesh.faces[:, [1, 2, 0]]].ravel()
    both = (starts >= 0) & (stops >= 0)
    return unique_edges(starts[both], stops[both], len(vertices))


def _path(
    curve: Float64[Array, "k 3"],
    vertices: Float64[Array, "b 3"],
    edges: Int64[Array, "e 2"],
    cost: Float64[Array, " e"],
) -> list[int] | None:
    """Cheapest closed path within a band along a curve. None if the band is not connected."""
    if not len(edges):
        return None
    a, b = edges.T
    both = np.concatenate([a, b]), np.concatenate([b, a])  # both directions: else each search would transpose the graph
    graph = coo_matrix((np.tile(cost, 2), both), shape=(len(vertices), len(vertices))).tocsr()
    _, part = connected_components(graph, directed=False)
    main = np.flatnonzero(part == np.argmax(np.bincount(part)))
    away, nearest = (np.asarray(answer) for answer in point_tree(vertices[main]).query(curve))
    stops = main[nearest[away < _OFF_MESH_MM]]
    stops = stops[stops != np.roll(stops, 1)]
    if len(stops) < 3:
        return None
    path: list[int] = []
    for start, stop in zip(stops.tolist(), np.roll(stops, -1).tolist(), strict=True):
        before = _before(graph, start, stop)
        leg = [int(stop)]
        while leg[-1] != start:
            leg.append(int(before[leg[-1]]))
        path += leg[:0:-1]
    return path


def _before(graph: csr_matrix, start: int, stop: int) -> Array:
    """Predecessors on the cheapest paths from a vertex, complete at least along the path to `stop`."""
    reach = _LEG_COST
    while True:  # a path within a limit is the cheapest: all others cost more than the limit
        distance, before = dijkstra(  # type: ignore[call-overload]  # the stubs know only arrays of one kind
            graph, indices=start, return_predecessors=True, limit=reach
        )
        if np.isfinite(distance[stop]):
            return np.asarray(before)
        reach *= _WIDER


def _broken(name: str, found: str) -> CrossingError:
    return CrossingError(
        f"boundary {name!r}",
        found=found,
        expected="a simple closed curve on the surface",
        remedy="Draw the boundary there with `mammometry edit`",
    )


def _without_spurs(path: list[int]) -> Int64[Array, " k"] | None:
    """The path without loops: where it meets itself, the longer part is kept. None if under half is left."""
    whole = len(path)
    while True:
        place: dict[int, int] = {}
        for j, vertex in enumerate(path):
            if vertex in place:
                i = place[vertex]
                path = path[i:j] if 2 * (j - i) > len(path) else path[:i] + path[j:]
                break
            place[vertex] = j
        else:
            break
    if len(path) < max(3, whole / 2):
        return None
    return np.array(path, dtype=np.int64)


def _resampled(points: Float64[Array, "n 3"]) -> Float64[Array, "m 3"]:
    """Closed curve resampled at about `_STEP_MM`."""
    return evenly_spaced(points, max(int(np.ceil(closed_length_mm(points) / _STEP_MM)), 8))
