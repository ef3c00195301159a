"""The elastic energy as matrices (paper Eq. 4–6), apart from the loop that uses it.

With displacements δ = v − v̄ from the first surface's positions v̄, Eq. 4 is::

    E(δ) = Σ_i ω_i k_ext |δ_i − t_i|²  +  ρ k_int Σ_edges |δ_i − δ_j|²,    t_i = ṽ_i − v̄_i

whose minimum solves ``(k_ext Ω + ρ k_int L) δ = k_ext Ω t`` for each coordinate, with Ω = diag(ω) and L the graph
Laplacian of the mesh's edges. Each edge counts once; the paper's double sum would count it twice (it only rescales ρ).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, diags_array

from mammometry.geometry.arrays import Array, Float64, Int32, Int64
from mammometry.geometry.mesh import TriangleMesh


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Graph:
    """A mesh's edges as a compressed adjacency: the neighbours of i are ``indices[indptr[i]:indptr[i+1]]``."""

    indptr: Int32[Array, " n1"]
    indices: Int32[Array, " e2"]

    @property
    def degree(self) -> Int32[Array, " n"]:
        """Number of neighbours of each vertex."""
        return np.diff(self.indptr)


def graph_of(edges: Int64[Array, "e 2"] | Int32[Array, "e 2"], n: int) -> Graph:
    """Build the adjacency of n vertices from edges; it does not matter how often or which way round each is given."""
    rows, columns = np.concatenate([edges, edges[:, ::-1]]).astype(np.int32).T
    matrix = csr_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(n, n))  # joins duplicates
    return Graph(indptr=matrix.indptr, indices=matrix.indices)


def graph_of_mesh(mesh: TriangleMesh) -> Graph:
    """Build the adjacency of a mesh's vertices, from its faces' sides."""
    return graph_of(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), len(mesh.vertices))


def laplacian(graph: Graph) -> csr_array:
    """Graph Laplacian L = D − A: ``xᵀ L x = Σ_edges (x_i − x_j)²`` (the matrix of Eq. 6)."""
    n = len(graph.indptr) - 1
    adjacency = csr_array((np.ones(len(graph.indices)), graph.indices, graph.indptr), shape=(n, n))
    return csr_array(diags_array(graph.degree.astype(np.float64)) - adjacency)


def system(weights: Float64[Array, " n"], stiffness: csr_array, *, rho: float, k_ext: float, k_int: float) -> csr_array:
    """Return the matrix of the normal equations, ``k_ext Ω + ρ k_int L`` (Eq. 4–6); symmetric, positive definite.

    `stiffness` is the graph Laplacian. Positive definite as soon as each connected part has one positive weight.
    """
    return csr_array(diags_array(k_ext * weights) + (rho * k_int) * stiffness)


def energy(
    displacements: Float64[Array, "n 3"],
    targets: Float64[Array, "n 3"],
    weights: Float64[Array, " n"],
    stiffness: csr_array,
    *,
    rho: float,
    k_ext: float,
    k_int: float,
) -> float:
    """Value of Eq. 4, mm², for displacements and their targets (ṽ − v̄), mm."""
    external = k_ext * float(weights @ ((displacements - targets) ** 2).sum(axis=1))
    internal = k_int * float(np.sum(displacements * (stiffness @ displacements)))
    return external + rho * internal


def conjugate_gradient(
    matrix: csr_array,
    right_side: Float64[Array, "n k"],
    start: Float64[Array, "n k"],
    *,
    tolerance: float,
    max_iterations: int,
) -> tuple[Float64[Array, "n k"], int]:
    """Solve for all columns at once, preconditioned by the diagonal (Jacobi); also gives the iterations used.

    Stops when every column's residual is below `tolerance` times its right side's norm.
    """
    inverse_diagonal = (1.0 / matrix.diagonal())[:, None]
    x = start.copy()
    residual = right_side - matrix @ x
    goal2 = tolerance**2 * np.maximum(np.einsum("ij,ij->j", right_side, right_side), 1e-24)
    z = inverse_diagonal * residual
    direction = z.copy()
    rz = _dots(residual, z)
    for iteration in range(max_iterations):
        if (_dots(residual, residual) <= goal2).all():
            return x, iteration
        image = matrix @ direction
        curvature = _dots(direction, image)
        alpha = np.divide(rz, curvature, out=np.zeros_like(rz), where=curvature > 0).astype(x.dtype)
        x += alpha * direction
        residual -= np.multiply(alpha, image, out=image)
        np.multiply(inverse_diagonal, residual, out=z)
        rz, before = _dots(residual, z), rz
        direction *= np.divide(rz, before, out=np.zeros_like(rz), where=before > 0).astype(x.dtype)
        direction += z
    return x, max_iterations


def _dots(a: Float64[Array, "n k"], b: Float64[Array, "n k"]) -> Float64[Array, " k"]:
    """Scalar product of each column of a with that of b, as BLAS does it."""
    return np.array([np.dot(a[:, column], b[:, column]) for column in range(a.shape[1])], dtype=np.float64)
