"""The shortest second cut, where two breasts touch.

Skin between two large breasts is seen by no camera, and the surface may join them in front of the cleavage. A curve
around one of them alone then parts nothing: the other one leads back to the trunk. The second cut is the closed curve
of least length, by the theorem of maximum flow and minimum cut (Ford and Fulkerson, 1956): skin is a net of faces that
lets through as much as their common edge is long, from one side of the first curve to the other.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from mammometry.geometry.arrays import Array, Bool, Float64, Int64
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.mesh_kernels import edge_rings, face_parts

_CELL_MM = 6.0  # of the first, coarse search; a neck is wider
_AROUND = 2  # rings of coarse patches around their cut in which single faces are looked at; chosen by eye
_UNITS_PER_MM = 100  # flow is counted in whole numbers
_ENDLESS = 10**8  # 1 km: more than any cut


def neck_sides(mesh: TriangleMesh, curve: Int64[Array, " n"]) -> Bool[Array, " h"]:
    """Find a second cut where the curve parts nothing.

    Args:
        mesh: the skin around a breast, mm.
        curve: vertices of a closed curve of edges.

    Returns:
        Whether each side of a face lies on the second cut. None does where it would be longer than the curve: that is
        no neck. Side 3 f + k runs from corner k of face f to the next.
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
    # Faces near the coarse cut are nodes of their own, all others belong to the end on whose side they lie.
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
    """Which nodes lie before the narrowest place between two ends, and its width, mm."""
    between = a != b
    source, sink = count, count + 1
    first, last = np.unique(ends[0]), np.unique(ends[1])
    rows = np.concatenate([a[between], np.full(len(first), source), last])
    columns = np.concatenate([b[between], first, np.full(len(last), sink)])
    # Sums are exact in 64 bit; the flow wants 32.
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
