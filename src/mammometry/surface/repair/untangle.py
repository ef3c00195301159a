"""Find faces that a repair turned over or crossed, and move them back.

Two triangles cross if a side of one that does not touch the other passes through its interior. Only triangles in the
same cell are compared; cells have about the size of a triangle.
"""

from __future__ import annotations

import numpy as np

from mammometry.base.machine.compiled import kernel
from mammometry.base.machine.cores import in_bands
from mammometry.geometry.arrays import Array, Bool, Float64, Int32, Int64, bounds
from mammometry.geometry.mesh import TriangleMesh, on_microns
from mammometry.surface.fusion.marching import longer
from mammometry.surface.repair import elastic_kernels
from mammometry.surface.repair.energy import Graph

_FLIP_ATTEMPTS = 8  # most smoothings of flipped triangles; it ends earlier when none is flipped
_CROSSING_ATTEMPTS = 12  # half of them move crossing faces half-way back, the rest all the way


def without_flips(initial: TriangleMesh, displacement: Float64[Array, "n 3"], graph: Graph) -> Float64[Array, "n 3"]:
    """Smooth displacements where they would turn triangles over."""
    result = displacement.copy()
    suspects = np.arange(len(initial.faces))
    for _ in range(_FLIP_ATTEMPTS):
        flipped = elastic_kernels.turned_over(initial.vertices, initial.vertices + result, initial.faces[suspects])
        if not flipped.any():
            break
        bad = np.unique(initial.faces[suspects[flipped]])
        bad = np.unique(_neighbours(bad, graph)[1])
        touched = np.zeros(len(result), dtype=bool)
        touched[bad] = True
        suspects = np.flatnonzero(touching(touched, initial.faces))
        owner, neighbour = _neighbours(bad, graph)
        position = np.searchsorted(bad, owner)
        sums = np.stack([np.bincount(position, result[neighbour, axis], len(bad)) for axis in range(3)], axis=1)
        result[bad] = sums / graph.degree[bad][:, None]
    return result


def without_crossings(initial: TriangleMesh, displacement: Float64[Array, "n 3"]) -> tuple[TriangleMesh, int]:
    """Move crossing faces back step by step. Returns the mesh and the remaining crossing pairs.

    After each step only moved faces are compared with those around them: remaining pairs are among these.
    """
    result = on_microns(displacement)
    mesh = TriangleMesh(vertices=initial.vertices + result, faces=initial.faces)
    pairs = crossing_faces(mesh)
    for attempt in range(_CROSSING_ATTEMPTS):
        if not len(pairs):
            break
        back = np.zeros(len(result), dtype=bool)
        back[initial.faces[np.unique(pairs)]] = True
        back = _with_rings(back, initial.faces, 1 + attempt // 3)
        result[back] = on_microns(result[back] * (0.5 if attempt < _CROSSING_ATTEMPTS // 2 else 0.0))
        mesh = TriangleMesh(vertices=initial.vertices + result, faces=initial.faces)
        pairs = crossing_faces(mesh, touching(back, initial.faces))
    return mesh, len(pairs)


def _with_rings(chosen: Bool[Array, " n"], faces: Int32[Array, "m 3"], rings: int) -> Bool[Array, " n"]:
    """The chosen vertices and those up to `rings` edges away."""
    result = chosen.copy()
    for _ in range(rings):
        result[faces[touching(result, faces)]] = True
    return result


def touching(chosen: Bool[Array, " n"], faces: Int32[Array, "m 3"]) -> Bool[Array, " m"]:
    """Faces with any chosen vertex. Column by column, since reducing an axis of three is slow."""
    a, b, c = faces.T
    touched: Bool[Array, " m"] = chosen[a] | chosen[b] | chosen[c]
    return touched


def _neighbours(of: Int32[Array, " k"], graph: Graph) -> tuple[Int32[Array, " m"], Int32[Array, " m"]]:
    """All (vertex, neighbour) pairs of the given vertices."""
    counts = graph.indptr[of + 1] - graph.indptr[of]
    ends = np.cumsum(counts)
    within = np.arange(int(ends[-1]) if len(ends) else 0) - np.repeat(ends - counts, counts)
    return np.repeat(of, counts), graph.indices[np.repeat(graph.indptr[of], counts) + within]


_CELL_IN_SIDES = 2.5  # a cell's edge in sides of ordinary triangles; affects speed only
_MOST_CELLS = 1 << 25  # 128 MiB of cell starts
_PLACES = 256  # cells along the longest axis when only some faces are compared; affects speed only


def crossing_faces(mesh: TriangleMesh, among: Bool[Array, " m"] | None = None) -> Int64[Array, "k 2"]:
    """Pairs of crossing faces, smaller index first.

    Faces that only touch, or are in one plane, do not cross. With `among`, only pairs with at least one chosen face:
    after a local change the others need no new test.
    """
    if len(mesh.faces) < 2 or (among is not None and not among.any()):
        return np.zeros((0, 2), dtype=np.int64)
    used = mesh.vertices[mesh.faces.ravel()] if 3 * len(mesh.faces) < len(mesh.vertices) else mesh.vertices
    origin, high = bounds(used)
    extent = high - origin
    boxes, side = _boxes(mesh.vertices, mesh.faces, origin)
    if among is not None:
        wide = max(float(extent.max()) / _PLACES, 1e-9)
        near = np.flatnonzero(_reaching(boxes, among, wide, np.floor(extent / wide).astype(np.int64) + 1))
        pairs = near[crossing_faces(TriangleMesh(vertices=mesh.vertices, faces=mesh.faces[near]))]
        return pairs[among[pairs[:, 0]] | among[pairs[:, 1]]]
    cell = max(_CELL_IN_SIDES * float(np.median(side)), float(extent.max()) * 1e-6, 1e-9)
    cell = max(cell, float(np.prod(np.maximum(extent, cell)) / _MOST_CELLS) ** (1 / 3))
    shape = np.floor(extent / cell).astype(np.int64) + 1
    starts, owners = _sorted_into_cells(boxes, cell, shape)

    def crossings(layers: slice) -> Int64[Array, "k 2"]:
        last = min(layers.stop, int(shape[0]))
        return _crossings(layers.start, last, starts, owners, shape, cell, mesh.vertices, mesh.faces, boxes)

    found = np.concatenate(in_bands(crossings, int(shape[0])))
    return found[np.lexsort((found[:, 1], found[:, 0]))]


@kernel
def _boxes(
    vertices: Float64[Array, "n 3"], faces: Int32[Array, "m 3"], origin: Float64[Array, " 3"]
) -> tuple[Float64[Array, "m 6"], Float64[Array, " m"]]:
    """Bounding box of each face relative to the origin (low, high), and its longest extent."""
    boxes, side = np.empty((len(faces), 6)), np.empty(len(faces))
    for face in range(len(faces)):
        longest = 0.0
        for axis in range(3):
            a, b, c = vertices[faces[face, 0], axis], vertices[faces[face, 1], axis], vertices[faces[face, 2], axis]
            low, high = min(a, min(b, c)), max(a, max(b, c))
            boxes[face, axis], boxes[face, axis + 3] = low - origin[axis], high - origin[axis]
            longest = max(longest, high - low)
        side[face] = longest
    return boxes, side


@kernel
def _reaching(
    boxes: Float64[Array, "m 6"], chosen: Bool[Array, " m"], cell: float, shape: Int64[Array, " 3"]
) -> Bool[Array, " m"]:
    """Faces whose box shares a cell with a chosen face's. Chosen faces are included."""
    marked = np.zeros((shape[0], shape[1], shape[2]), dtype=np.bool_)
    reaching = np.zeros(len(boxes), dtype=np.bool_)
    for reading in range(2):
        for face in range(len(boxes)):
            if not reading and not chosen[face]:
                continue
            for i in range(int(boxes[face, 0] / cell), min(int(boxes[face, 3] / cell), shape[0] - 1) + 1):
                for j in range(int(boxes[face, 1] / cell), min(int(boxes[face, 4] / cell), shape[1] - 1) + 1):
                    for k in range(int(boxes[face, 2] / cell), min(int(boxes[face, 5] / cell), shape[2] - 1) + 1):
                        if reading:
                            reaching[face] |= marked[i, j, k]
                        else:
                            marked[i, j, k] = True
    return reaching


@kernel
def _sorted_into_cells(
    boxes: Float64[Array, "m 6"], cell: float, shape: Int64[Array, " 3"]
) -> tuple[Int32[Array, " c1"], Int32[Array, " e"]]:
    """Faces whose boxes reach into each cell. Those of cell c are owners[starts[c] : starts[c + 1]]."""
    starts = np.zeros(shape[0] * shape[1] * shape[2] + 1, dtype=np.int32)
    owners = np.empty(0, dtype=np.int32)
    for filling in range(2):
        for number in range(len(boxes)):
            # Backwards, since the second pass fills each cell from its end.
            face = len(boxes) - 1 - number
            for i in range(int(boxes[face, 0] / cell), min(int(boxes[face, 3] / cell), shape[0] - 1) + 1):
                for j in range(int(boxes[face, 1] / cell), min(int(boxes[face, 4] / cell), shape[1] - 1) + 1):
                    for k in range(int(boxes[face, 2] / cell), min(int(boxes[face, 5] / cell), shape[2] - 1) + 1):
                        at = (i * shape[1] + j) * shape[2] + k
                        if filling:
                            starts[at] -= 1
                            owners[starts[at]] = face
                        else:
                            starts[at] += 1
        if not filling:
            for at in range(1, len(starts)):
                starts[at] += starts[at - 1]
            owners = np.empty(starts[-1], dtype=np.int32)
    return starts, owners


@kernel
def _crossings(
    first: int,
    last: int,
    starts: Int32[Array, " c1"],
    owners: Int32[Array, " e"],
    shape: Int64[Array, " 3"],
    cell: float,
    vertices: Float64[Array, "n 3"],
    faces: Int32[Array, "m 3"],
    boxes: Float64[Array, "m 6"],
) -> Int64[Array, "k 2"]:
    """Crossing pairs in the layers of cells from `first` to `last`, which is excluded."""
    found, count = np.empty((16, 2), dtype=np.int64), 0
    for i in range(first, last):
        for j in range(shape[1]):
            for k in range(shape[2]):
                at = (i * shape[1] + j) * shape[2] + k
                for p in range(starts[at], starts[at + 1]):
                    a = owners[p]
                    for q in range(p + 1, starts[at + 1]):
                        b = owners[q]
                        apart = False
                        for axis in range(3):
                            apart = apart or boxes[a, axis] > boxes[b, axis + 3] or boxes[b, axis] > boxes[a, axis + 3]
                        if apart:
                            continue
                        # Count each pair once: in the first cell that both reach.
                        if (
                            int(max(boxes[a, 0], boxes[b, 0]) / cell) != i
                            or int(max(boxes[a, 1], boxes[b, 1]) / cell) != j
                            or int(max(boxes[a, 2], boxes[b, 2]) / cell) != k
                        ):
                            continue
                        if _side_pierces(vertices, faces[a], faces[b]) or _side_pierces(vertices, faces[b], faces[a]):
                            if count == len(found):
                                found = longer(found)
                            found[count, 0], found[count, 1] = min(a, b), max(a, b)
                            count += 1
    return found[:count].copy()


@kernel
def _side_pierces(vertices: Float64[Array, "n 3"], face: Int32[Array, " 3"], other: Int32[Array, " 3"]) -> bool:
    """Whether a side of `face` without a vertex in common with `other` pierces its interior."""
    a, b, c = other[0], other[1], other[2]
    for side in range(3):
        p, q = face[side], face[(side + 1) % 3]
        if p in (a, b, c) or q in (a, b, c):
            continue
        above, below = _volume(vertices, a, b, c, p), _volume(vertices, a, b, c, q)
        if not ((above > 0.0 and below < 0.0) or (above < 0.0 and below > 0.0)):
            continue
        u, v, w = _volume(vertices, p, q, a, b), _volume(vertices, p, q, b, c), _volume(vertices, p, q, c, a)
        if (u > 0.0 and v > 0.0 and w > 0.0) or (u < 0.0 and v < 0.0 and w < 0.0):
            return True
    return False


@kernel
def _volume(vertices: Float64[Array, "n 3"], a: int, b: int, c: int, d: int) -> float:
    """Six times the signed volume of the tetrahedron a, b, c, d."""
    ux = vertices[b, 0] - vertices[a, 0]
    uy = vertices[b, 1] - vertices[a, 1]
    uz = vertices[b, 2] - vertices[a, 2]
    vx = vertices[c, 0] - vertices[a, 0]
    vy = vertices[c, 1] - vertices[a, 1]
    vz = vertices[c, 2] - vertices[a, 2]
    wx = vertices[d, 0] - vertices[a, 0]
    wy = vertices[d, 1] - vertices[a, 1]
    wz = vertices[d, 2] - vertices[a, 2]
    return ux * (vy * wz - vz * wy) + uy * (vz * wx - vx * wz) + uz * (vx * wy - vy * wx)
