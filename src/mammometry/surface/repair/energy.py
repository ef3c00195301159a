"""Elastic energy (paper Eq. 4–6) and its minimum.

With displacements δ = v − v̄ from the first surface's positions v̄, Eq. 4 is::

    E(δ) = Σ_i ω_i |δ_i − t_i|²  +  ρ Σ_edges |δ_i − δ_j|²,    t_i = ṽ_i − v̄_i

Its minimum solves ``(Ω + ρ L) δ = Ω t`` for each coordinate, with Ω = diag(ω) and L the graph Laplacian of the mesh's
edges. The moduli k_ext and k_int (Eq. 5, 6) are 1: only ρ k_int / k_ext matters. Each edge counts once. The paper's
double sum counts it twice, which only rescales ρ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, diags_array

from mammometry.geometry import Array, Float64, Int32, Int64, TriangleMesh
from mammometry.surface.repair import elastic_kernels


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Graph:
    """Adjacency of a mesh's vertices. The neighbours of i are ``indices[indptr[i]:indptr[i+1]]``."""

    indptr: Int64[Array, " n1"]
    indices: Int32[Array, " e2"]

    @property
    def degree(self) -> Int64[Array, " n"]:
        """Number of neighbours of each vertex."""
        return np.diff(self.indptr)


def graph_of(edges: Int64[Array, "e 2"] | Int32[Array, "e 2"], n: int) -> Graph:
    """Adjacency of n vertices. Edges may be repeated, in any direction."""
    indptr, indices = elastic_kernels.adjacency(n, np.ascontiguousarray(edges, dtype=np.int32))
    return Graph(indptr=indptr, indices=indices)


def graph_of_mesh(mesh: TriangleMesh) -> Graph:
    """Adjacency of a mesh's vertices."""
    return graph_of(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), len(mesh.vertices))


def laplacian(graph: Graph) -> csr_array:
    """Graph Laplacian L = D − A (matrix of Eq. 6): ``xᵀ L x = Σ_edges (x_i − x_j)²``."""
    n = len(graph.indptr) - 1
    adjacency = csr_array((np.ones(len(graph.indices)), graph.indices, graph.indptr), shape=(n, n))
    return csr_array(diags_array(graph.degree.astype(np.float64)) - adjacency)


def minimum(
    targets: Float64[Array, "n 3"],
    weights: Float64[Array, " n"],
    graph: Graph,
    rho: float,
    *,
    start: Float64[Array, "n 3"],
    tolerance: float,
    max_iterations: int,
) -> tuple[Float64[Array, "n 3"], int]:
    """Displacements that minimise Eq. 4, mm, and the iterations of conjugate gradients.

    Single precision: displacements of millimetres are needed to a thousandth. Preconditioned by the diagonal. Each
    connected part needs a positive weight.

    Args:
        targets: t_i = ṽ_i − v̄_i, mm.
        weights: ω_i.
        graph: the mesh's edges.
        rho: weight ρ of the internal energy, dimensionless.
        start: initial displacements, mm.
        tolerance: residual of each coordinate, relative to the right side, at which to stop.
        max_iterations: limit of iterations.
    """
    solved, iterations = elastic_kernels.minimised(
        graph.indptr,
        graph.indices,
        weights.astype(np.float32),
        rho,
        targets.astype(np.float32),
        start.astype(np.float32),
        tolerance,
        max_iterations,
    )
    return solved.astype(np.float64), int(iterations)
