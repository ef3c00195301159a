"""Move back faces that a repair turned over or crossed."""

from __future__ import annotations

import numpy as np

from mammometry.geometry.arrays import Array, Bool, Float64, Int32
from mammometry.geometry.mesh import TriangleMesh, on_microns
from mammometry.surface.repair import elastic_kernels
from mammometry.surface.repair.crossing import crossing_faces
from mammometry.surface.repair.energy import Graph

_FLIP_ATTEMPTS = 8  # smoothings of what is turned over; chosen by eye
_CROSSING_ATTEMPTS = 12  # half of them move crossing faces half-way back, the rest all the way


def without_flips(initial: TriangleMesh, displacement: Float64[Array, "n 3"], graph: Graph) -> Float64[Array, "n 3"]:
    """Smooth displacements where they would turn a triangle over, until none is."""
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
    """Move crossing faces back until none is left, and count pairs left.

    Each step moves them back half-way. After each step only what moved is compared with what lies around it: all pairs
    that stay are among those.
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
    """The vertices chosen and those up to so many edges away."""
    result = chosen.copy()
    for _ in range(rings):
        result[faces[touching(result, faces)]] = True
    return result


def touching(chosen: Bool[Array, " n"], faces: Int32[Array, "m 3"]) -> Bool[Array, " m"]:
    """Faces with any of the vertices chosen. Column by column, for a reduction over three values is slow."""
    a, b, c = faces.T
    touched: Bool[Array, " m"] = chosen[a] | chosen[b] | chosen[c]
    return touched


def _neighbours(of: Int32[Array, " k"], graph: Graph) -> tuple[Int32[Array, " m"], Int32[Array, " m"]]:
    """All (vertex, neighbour) pairs of the vertices given."""
    counts = graph.indptr[of + 1] - graph.indptr[of]
    ends = np.cumsum(counts)
    within = np.arange(int(ends[-1]) if len(ends) else 0) - np.repeat(ends - counts, counts)
    return np.repeat(of, counts), graph.indices[np.repeat(graph.indptr[of], counts) + within]
