"""Cut a closed mesh by a surface or along a closed curve.

The surface is a level set of height zero. The curve runs along edges of the mesh. The cut is exact: triangles that
cross it are split, none is dropped, and the edges of the opening are returned as closed loops, to which a wall can be
sewn without a gap.

No camera sees the skin between two large breasts, and the surface may join them in front of the cleavage. A curve
around one of them then does not separate it: the other one connects it to the trunk. A second cut is made along the
shortest closed curve, by maximum flow and minimum cut (Ford and Fulkerson, 1956): faces are nodes, and the capacity
between two faces is the length of their common edge.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from mammometry.base.errors import MeasureError
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Float64, Int64, TriangleMesh, mesh_kernels, read_only
from mammometry.geometry.mesh_kernels import edge_rings, face_parts

_CELL_MM = 6.0  # patch size of the coarse search; a neck is wider
_AROUND = 2  # rings of patches around the coarse cut in which the cut is refined by face; not critical
_UNITS_PER_MM = 100  # flow is an integer
_ENDLESS = 10**8  # capacity of 1 km: more than any cut


def neck_sides(mesh: TriangleMesh, curve: Int64[Array, " n"]) -> Bool[Array, " h"]:
    """Second cut, for a curve that does not separate a breast, as a mask of sides of faces.

    Args:
        mesh: the skin around a breast, mm.
        curve: vertices of a closed curve of edges.

    Returns:
        Whether each side of a face is on the second cut. Side 3 f + k runs from corner k of face f to the next. All
        false if the cut would be longer than the curve: then there is no neck.
    """
    after = np.full(len(mesh.vertices), -1, dtype=np.int64)
    after[curve] = np.roll(curve, -1)
    starts, stops = mesh.faces.ravel(), mesh.faces[:, [1, 2, 0]].ravel()
    with_it, against_it = after[starts] == stops, after[stops] == starts
    face = np.arange(len(starts)) // 3
    ends = face[with_it], face[against_it]
    rings = np.asarray(edge_rings(len(mesh.vertices), mesh.faces))
    joined = ~(with_it | against_it) & (face[rings] != face)
    lengths_mm = np.linalg.norm(mesh.vertices[starts] - mesh.vertices[stops], axis=1)
    a, b, width = face[joined], face[rings[joined]], lengths_mm[joined]

    cell = np.floor(mesh.corners().mean(axis=1) / _CELL_MM).astype(np.int64)
    other_cell = (cell[face] != cell[face[rings]]).any(axis=1)
    count, labels = face_parts(rings, ~joined | other_cell)
    patch = labels.astype(np.int64)
    before, _ = _before_cut(count, patch[a], patch[b], width, (patch[ends[0]], patch[ends[1]]))
    near = np.zeros(count, dtype=bool)
    near[patch[a][before[patch[a]] != before[patch[b]]]] = True
    for _ in range(_AROUND):
        near[patch[a][near[patch[b]]]] = True
    # Faces near the coarse cut are nodes of their own; all others are merged into the end on their side.
    fine = near[patch]
    node = np.where(fine, 2 + np.cumsum(fine) - 1, before[patch].astype(np.int64))
    own = np.concatenate([[1], node[ends[0]]]), np.concatenate([[0], node[ends[1]]])
    before, cut_mm = _before_cut(2 + int(fine.sum()), node[a], node[b], width, own)
    sides = np.zeros(len(starts), dtype=bool)
    along_curve_mm = float(lengths_mm[with_it].sum())
    if cut_mm < along_curve_mm:
        sides[joined] = before[node[a]] != before[node[b]]
    return sides


def _before_cut(
    count: int,
    a: Int64[Array, " k"],
    b: Int64[Array, " k"],
    width_mm: Float64[Array, " k"],
    ends: tuple[Int64[Array, " i"], Int64[Array, " j"]],
) -> tuple[Bool[Array, " count"], float]:
    """Nodes on the source side of the minimum cut between two ends, and the cut's length, mm."""
    between = a != b
    source, sink = count, count + 1
    first, last = np.unique(ends[0]), np.unique(ends[1])
    rows = np.concatenate([a[between], np.full(len(first), source), last])
    columns = np.concatenate([b[between], first, np.full(len(last), sink)])
    # Sums are exact in 64 bits; the flow needs 32.
    width = np.concatenate([width_mm[between] * _UNITS_PER_MM, np.full(len(first) + len(last), float(_ENDLESS))])
    net = csr_array((width, (rows, columns)), shape=(count + 2, count + 2))
    net.sum_duplicates()
    net = csr_array((np.maximum(1, np.rint(net.data)).astype(np.int32), net.indices, net.indptr), shape=net.shape)
    found = maximum_flow(net, source, sink)
    left = csr_array(net - found.flow)
    left.data = np.maximum(left.data, 0)
    left.eliminate_zeros()
    before = np.zeros(count + 2, dtype=bool)
    before[breadth_first_order(left, source, return_predecessors=False)] = True
    return before[:count], found.flow_value / _UNITS_PER_MM


Height = Callable[[Float64[Array, "n 3"]], Float64[Array, " n"]]
"""Signed height of world points above a surface, mm; positive on the kept side."""

_BISECTIONS = 60  # most iterations of the Illinois method, which stops at 1e-10 mm
_ON_BASE_MM = 0.01  # tolerance; an opening made by the base is on it to 1e-10 mm
_FACING = 0.1  # cosine up to which the skin within a boundary may face inwards; not critical
_SPHERE, _SPHERE_MM = 1.6, 40.0
"""Radius of the sphere around the boundary's centre that contains the breast: factor of the boundary's radius, plus mm.
A part that reaches the sphere's edge is not the breast. Not critical."""


@value(eq=False)
class OpenPart:
    """Kept part of a closed mesh, and its openings."""

    mesh: TriangleMesh
    """mm, world frame."""
    loops: tuple[Int64[Array, " _"], ...]
    """Vertices of each opening, in the direction of the part's own faces, longest first."""


def above(mesh: TriangleMesh, height: Height) -> OpenPart:
    """Largest connected part of a mesh with positive `height`. Without faces if there is none.

    Edges that cross are split at zero height, to 1e-10 mm.
    """
    heights = height(mesh.vertices)
    inside = heights > 0
    count = inside[mesh.faces].sum(axis=1)
    whole = mesh.faces[count == 3].astype(np.int64)
    one, two = mesh.faces[count == 1].astype(np.int64), mesh.faces[count == 2].astype(np.int64)
    one = _rotate(one, inside[one])  # a inside, b and c outside
    two = _rotate(two, ~inside[two])  # a outside, b and c inside
    n = len(mesh.vertices)
    crossing = np.concatenate([one[:, [0, 1]], one[:, [0, 2]], two[:, [1, 0]], two[:, [2, 0]]])  # (inside, outside)
    keys, number = np.unique(crossing[:, 0] * n + crossing[:, 1], return_inverse=True)
    number = n + number.ravel()
    new = _roots(mesh.vertices, np.stack(np.divmod(keys, n), axis=1), height)
    ab, ac, ba, ca = np.split(number, np.cumsum([len(one), len(one), len(two)]))
    faces = np.concatenate(
        [
            whole,
            np.stack([one[:, 0], ab, ac], axis=1),
            np.stack([ba, two[:, 1], two[:, 2]], axis=1),
            np.stack([ba, two[:, 2], ca], axis=1),
        ]
    )
    return _largest(TriangleMesh(vertices=np.concatenate([mesh.vertices, new]), faces=faces.astype(np.int32)))


def inside_curve(mesh: TriangleMesh, curve: Int64[Array, " n"]) -> OpenPart:
    """Smaller part of a closed mesh cut along a closed curve. Empty if the curve separates nothing.

    Args:
        mesh: a closed mesh.
        curve: vertices of the curve in order, without repetition; neighbours are joined by an edge of the mesh.
    """
    return open_part(mesh, faces_inside(mesh, curve), curve)


def check_above_base(part: OpenPart, height: Height) -> None:
    """Raise an error if a cast has a hole above its base.

    Args:
        part: the part above the base.
        height: gives the height above the base, mm.

    Raises:
        MeasureError: an opening is entirely above the base.
    """
    if any(float(height(part.mesh.vertices[loop]).min()) > _ON_BASE_MM for loop in part.loops):
        raise MeasureError(
            "model",
            found="a hole in the surface above the base",
            expected="skin without holes",
            remedy="Close the holes in the program that made the mesh",
        )


def check_whole(name: str, part: OpenPart) -> None:
    """Raise an error if a part is not a complete breast.

    Args:
        name: name of the boundary.
        part: the part that was cut out along it, or above a cast's base.

    Raises:
        MeasureError: it has another opening than the cut's, or is concave seen from outside.
    """
    if len(part.loops) != 1:
        raise MeasureError(
            f"boundary {name!r}",
            found="a hole or an edge of the surface within it" if part.loops else "no part of the surface within it",
            expected="skin without holes inside the boundary",
            remedy="Close the holes in the program that made the mesh, or draw the boundary elsewhere",
        )
    rim = part.mesh.vertices[part.loops[0]]
    outwards = part.mesh.face_vectors().sum(axis=0)
    stands_out = part.mesh.corners().mean(axis=(0, 1)) - rim.mean(axis=0)
    if outwards @ stands_out < -_FACING * np.linalg.norm(outwards) * np.linalg.norm(stands_out):
        raise MeasureError(
            f"boundary {name!r}",
            found="skin that is concave seen from outside",
            expected="a convex breast: faces that point outwards",
            remedy="Flip the mesh's normals in the program that made it, or draw the boundary around a breast",
        )


def faces_inside(mesh: TriangleMesh, curve: Int64[Array, " n"]) -> Bool[Array, " m"]:
    """Faces of the part that `inside_curve` keeps, which ends at the neck to a touching breast."""
    around = faces_around(mesh.vertices[curve], mesh)
    inside = np.zeros(len(mesh.faces), dtype=bool)
    near = TriangleMesh(vertices=mesh.vertices, faces=mesh.faces[around])
    chosen = _smaller_part(near, curve, goes_on=True)
    if chosen is None:  # both sides leave the neighbourhood: another breast connects them
        return np.asarray(_smaller_part(mesh, curve, goes_on=False))
    inside[around] = chosen
    return inside


def _smaller_part(near: TriangleMesh, curve: Int64[Array, " n"], *, goes_on: bool) -> Bool[Array, " m"] | None:
    """Faces on the smaller side of a curve. All false if it separates nothing.

    If the mesh `goes_on` beyond its edge, parts that reach the edge are not small. None if both do.
    """
    walls = sides_on(near, curve)
    along = np.flatnonzero(walls) // 3
    rings = mesh_kernels.edge_rings(len(near.vertices), near.faces)
    count, part = mesh_kernels.face_parts(rings, walls)
    if len(np.unique(part[along])) < 2:
        count, part = mesh_kernels.face_parts(rings, walls | neck_sides(near, curve))
    touching = np.unique(part[along])
    if len(touching) < 2:
        return np.zeros(len(near.faces), dtype=bool)
    area = np.bincount(part, _areas_mm2(near), minlength=count)
    if goes_on:
        alone = np.flatnonzero(rings == np.arange(len(rings)))
        area[np.unique(part[alone // 3])] = np.inf
    smaller = touching[np.argsort(area[touching])[-2]]
    return np.asarray(part == smaller) if np.isfinite(area[smaller]) else None


def sides_on(mesh: TriangleMesh, curve: Int64[Array, " n"]) -> Bool[Array, " h"]:
    """Mask of the sides of faces on a closed curve. Side 3 f + k runs from corner k of face f to the next."""
    after = np.full(len(mesh.vertices), -1, dtype=np.int64)
    after[curve] = np.roll(curve, -1)
    starts, stops = mesh.faces.ravel(), mesh.faces[:, [1, 2, 0]].ravel()
    return np.asarray((after[starts] == stops) | (after[stops] == starts))


def open_part(mesh: TriangleMesh, faces: Bool[Array, " m"], curve: Int64[Array, " n"]) -> OpenPart:
    """Faces of a mesh with the opening along the curve. Openings by other cuts are closed."""
    return _without_chords(_without_necks(_compact(mesh, faces), mesh, faces, curve))


def _without_necks(part: OpenPart, mesh: TriangleMesh, faces: Bool[Array, " m"], curve: Int64[Array, " n"]) -> OpenPart:
    """Close openings made by a second cut, each by a fan of triangles around its centre."""
    if len(part.loops) < 2:
        return part
    had = mesh_kernels.open_vertices(len(mesh.vertices), mesh.faces)
    had[curve] = True
    had = had[mesh.vertices_used_by(faces)]
    necks = [loop for loop in part.loops if not had[loop].any()]
    n = len(part.mesh.vertices)
    # Loops have the direction of the part's own faces, so the fans' faces run against them.
    fans = [
        np.stack([np.roll(loop, -1), loop, np.full(len(loop), n + number)], axis=1) for number, loop in enumerate(necks)
    ]
    middles = [part.mesh.vertices[loop].mean(axis=0, keepdims=True) for loop in necks]
    return OpenPart(
        mesh=TriangleMesh(
            vertices=np.concatenate([part.mesh.vertices, *middles]),
            faces=np.concatenate([part.mesh.faces, *fans]).astype(np.int32),
        ),
        loops=tuple(loop for loop in part.loops if had[loop].any()),
    )


def faces_around(points: Float64[Array, "n 3"], mesh: TriangleMesh) -> Bool[Array, " m"]:
    """Faces within a sphere that contains the breast inside a curve."""
    centre = points.mean(axis=0)
    reach = _SPHERE * float(np.linalg.norm(points - centre, axis=1).max()) + _SPHERE_MM
    within = np.linalg.norm(mesh.vertices - centre, axis=1) < reach
    return mesh.faces_within(within)


def opening_loops(faces: Int64[Array, "m 3"], n_vertices: int) -> tuple[Int64[Array, " n"], ...]:
    """Closed loops of open edges, in the faces' direction, longest first."""
    a, b = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    rings = mesh_kernels.edge_rings(n_vertices, read_only(faces.astype(np.int32)))
    single = rings == np.arange(len(rings))
    follow: dict[int, list[int]] = {}
    for start, stop in zip(a[single].tolist(), b[single].tolist(), strict=True):
        follow.setdefault(start, []).append(stop)
    loops: list[Int64[Array, " n"]] = []
    while follow:
        start = next(iter(follow))
        path, place = [start], {start: 0}
        while True:
            stops = follow[path[-1]]
            stop = stops.pop()
            if not stops:
                del follow[path[-1]]
            if stop in place:  # a loop is closed; if loops touch in a vertex, the rest of the path continues
                closed = path[place[stop] :]
                loops.append(np.array(closed, dtype=np.int64))
                for vertex in closed[1:]:
                    del place[vertex]
                path = path[: place[stop] + 1]
                if len(path) == 1:
                    break
            else:
                place[stop] = len(path)
                path.append(stop)
    return tuple(sorted(loops, key=len, reverse=True))


def _rotate(faces: Int64[Array, "m 3"], odd: Bool[Array, "m 3"]) -> Int64[Array, "m 3"]:
    """Faces with their corners rotated so that the odd one comes first."""
    start = np.argmax(odd, axis=1) if len(faces) else np.zeros(0, dtype=np.int64)
    return np.take_along_axis(faces, (start[:, None] + np.arange(3)) % 3, axis=1)


def _roots(vertices: Float64[Array, "n 3"], pairs: Int64[Array, "k 2"], height: Height) -> Float64[Array, "k 3"]:
    """Points of zero height between inside and outside vertices, by the Illinois method."""
    a, b = vertices[pairs[:, 0]], vertices[pairs[:, 1]]
    if not len(pairs):
        return a
    h_a, h_b = height(a), height(b)
    t_a, t_b = np.zeros(len(a)), np.ones(len(a))
    t = t_a
    for _ in range(_BISECTIONS):
        t = t_a - h_a * (t_b - t_a) / np.where(h_b < h_a, h_b - h_a, -1.0)
        h = height(a + (b - a) * t[:, None])
        if np.all((np.abs(h) < 1e-10) | (t_b - t_a < 1e-12)):
            break
        positive = h > 0
        # Illinois: the value at an end that stays is halved, so that both ends converge.
        h_b = np.where(positive, h_b / 2, h)
        h_a = np.where(positive, h, h_a / 2)
        t_b = np.where(positive, t_b, t)
        t_a = np.where(positive, t, t_a)
    return a + (b - a) * t[:, None]


def _without_chords(part: OpenPart) -> OpenPart:
    """Split inner edges that join two vertices of the opening: the wall may contain the same edge."""
    if not part.loops:
        return part
    n = len(part.mesh.vertices)
    rim = np.concatenate(part.loops)
    on_rim = np.zeros(n, dtype=bool)
    on_rim[rim] = True
    around = np.concatenate([_edge_keys(loop, np.roll(loop, -1), n) for loop in part.loops])
    starts, stops = part.mesh.faces.ravel(), part.mesh.faces[:, [1, 2, 0]].ravel()
    both = on_rim[starts] & on_rim[stops]
    keys = _edge_keys(starts[both].astype(np.int64), stops[both].astype(np.int64), n)
    edges = np.stack(np.divmod(np.unique(keys), n), axis=1)
    edges = edges[~np.isin(edges[:, 0] * n + edges[:, 1], around)]
    rim_faces = np.flatnonzero(on_rim[part.mesh.faces].sum(axis=1) >= 2)
    around_rim: list[list[int]] = part.mesh.faces[rim_faces].tolist()
    for number, (a, b) in enumerate(edges.tolist()):
        for corners in [corners for corners in around_rim if a in corners and b in corners]:
            turn = next(i for i in range(3) if {corners[i], corners[(i + 1) % 3]} == {a, b})
            p, q, r = corners[turn], corners[(turn + 1) % 3], corners[(turn + 2) % 3]
            corners[:] = [p, n + number, r]
            around_rim.append([n + number, q, r])
    split = np.array(around_rim, dtype=np.int32).reshape(-1, 3)
    faces = part.mesh.faces.copy()
    faces[rim_faces] = split[: len(rim_faces)]
    middles = part.mesh.vertices[edges].mean(axis=1)
    return OpenPart(
        mesh=TriangleMesh(
            vertices=np.concatenate([part.mesh.vertices, middles]),
            faces=np.concatenate([faces, split[len(rim_faces) :]]),
        ),
        loops=part.loops,
    )


def _edge_keys(a: Int64[Array, "*n"], b: Int64[Array, "*n"], n: int) -> Int64[Array, "*n"]:
    return np.minimum(a, b) * n + np.maximum(a, b)


def _areas_mm2(mesh: TriangleMesh) -> Float64[Array, " m"]:
    x, y, z = mesh.face_vectors().T  # much faster than a norm over an axis of length 3
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def _largest(mesh: TriangleMesh) -> OpenPart:
    """Connected part with the largest area. Parts are connected by edges or corners."""
    part = mesh.components()[1][mesh.faces[:, 0]]
    return _compact(mesh, part == np.argmax(np.bincount(part, _areas_mm2(mesh), minlength=1)))


def _compact(mesh: TriangleMesh, chosen: Bool[Array, " m"]) -> OpenPart:
    """The chosen faces as a mesh of their own, with its openings."""
    part = mesh.submesh(chosen)
    return OpenPart(mesh=part, loops=opening_loops(part.faces.astype(np.int64), len(part.vertices)))
