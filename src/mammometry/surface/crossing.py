"""Triangles of a surface that pass through one another.

Space is cut in cells of the size of ordinary triangles; only triangles of one cell are compared. Two triangles cross
where a side of one that does not touch the other passes through its interior.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mammometry.geometry.arrays import Array, Float64, Int32, Int64
from mammometry.geometry.mesh import TriangleMesh

_CELL_IN_SIDES = 2.5
_LARGEST_CELLS = 4096


def crossing_faces(mesh: TriangleMesh) -> Int64[Array, "k 2"]:
    """Pairs of faces that pass through one another, smaller number first; mesh's frame, mm.

    Touching without passing through does not count, nor do faces that lie in one plane.
    """
    if len(mesh.faces) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    low, high = _boxes(mesh.vertices, mesh.faces)
    cell = max(_CELL_IN_SIDES * float(np.median((high - low).max(axis=1))), 1e-9)
    cell = max(cell, float((mesh.vertices.max(axis=0) - mesh.vertices.min(axis=0)).max()) / _LARGEST_CELLS)
    first = np.floor((low - mesh.vertices.min(axis=0)) / cell).astype(np.int64)
    last = np.floor((high - mesh.vertices.min(axis=0)) / cell).astype(np.int64)
    counts = (last - first + 1).prod(axis=1)
    cells, owners = _entries(first, last, int(counts.sum()))
    order = np.argsort(cells, kind="stable")
    found = _crossings(cells[order], owners[order], first, np.array(mesh.vertices), np.array(mesh.faces), low, high)
    return found[np.lexsort((found[:, 1], found[:, 0]))]


def _boxes(
    vertices: Float64[Array, "n 3"], faces: Int32[Array, "m 3"]
) -> tuple[Float64[Array, "m 3"], Float64[Array, "m 3"]]:
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


@njit(cache=True)
def _entries(
    first: Int64[Array, "m 3"], last: Int64[Array, "m 3"], total: int
) -> tuple[Int64[Array, " e"], Int32[Array, " e"]]:
    cells, owners = np.empty(total, dtype=np.int64), np.empty(total, dtype=np.int32)
    at = 0
    for face in range(len(first)):
        for i in range(first[face, 0], last[face, 0] + 1):
            for j in range(first[face, 1], last[face, 1] + 1):
                for k in range(first[face, 2], last[face, 2] + 1):
                    cells[at] = ((i << 20) + j << 20) + k
                    owners[at] = face
                    at += 1
    return cells, owners


@njit(cache=True)
def _crossings(
    cells: Int64[Array, " e"],
    owners: Int32[Array, " e"],
    first: Int64[Array, "m 3"],
    vertices: Float64[Array, "n 3"],
    faces: Int32[Array, "m 3"],
    low: Float64[Array, "m 3"],
    high: Float64[Array, "m 3"],
) -> Int64[Array, "k 2"]:
    pairs = []
    start = 0
    while start < len(cells):
        end = start + 1
        while end < len(cells) and cells[end] == cells[start]:
            end += 1
        for p in range(start, end):
            a = owners[p]
            for q in range(p + 1, end):
                b = owners[q]
                apart = False
                for axis in range(3):
                    apart = apart or low[a, axis] > high[b, axis] or low[b, axis] > high[a, axis]
                if apart:
                    continue
                # Each pair once: in the first cell that both reach.
                i = max(first[a, 0], first[b, 0])
                j = max(first[a, 1], first[b, 1])
                k = max(first[a, 2], first[b, 2])
                if ((i << 20) + j << 20) + k != cells[start]:
                    continue
                if _side_pierces(vertices, faces[a], faces[b]) or _side_pierces(vertices, faces[b], faces[a]):
                    pairs.append((min(a, b), max(a, b)))
        start = end
    result = np.empty((len(pairs), 2), dtype=np.int64)
    for number, (a, b) in enumerate(pairs):
        result[number, 0], result[number, 1] = a, b
    return result


@njit(cache=True)
def _side_pierces(vertices: Float64[Array, "n 3"], face: Int32[Array, " 3"], other: Int32[Array, " 3"]) -> bool:
    """Whether a side of `face` that shares no vertex with `other` passes through its interior."""
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


@njit(cache=True)
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
