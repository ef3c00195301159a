"""The elastic energy's matrices against dense algebra and closed-form minima."""

import numpy as np
import pytest
from scipy.sparse import csr_array
from spheres import sphere_mesh

from mammometry.surface.energy import conjugate_gradient, energy, graph_of, laplacian, system

CONSTANTS = dict(rho=0.7, k_ext=1.3, k_int=2.1)


def small_problem(seed=0):
    mesh = sphere_mesh(10.0, rings=5)
    rng = np.random.default_rng(seed)
    n = len(mesh.vertices)
    return mesh, rng.normal(size=(n, 3)), rng.uniform(0, 1, n), rng.normal(size=(n, 3))


def plain_energy(displacements, targets, weights, mesh):
    """Eq. 4–6, term by term, each edge once."""
    external = sum(w * np.sum((d - t) ** 2) for w, d, t in zip(weights, displacements, targets, strict=True))
    internal = sum(np.sum((displacements[i] - displacements[j]) ** 2) for i, j in mesh.edges())
    return CONSTANTS["k_ext"] * external + CONSTANTS["rho"] * CONSTANTS["k_int"] * internal


def test_energy_is_the_papers_sum():
    mesh, targets, weights, displacements = small_problem()
    matrix = laplacian(graph_of(mesh.edges(), len(mesh.vertices)))
    expected = plain_energy(displacements, targets, weights, mesh)
    assert energy(displacements, targets, weights, matrix, **CONSTANTS) == pytest.approx(expected, rel=1e-12)


def test_laplacian_is_degree_minus_adjacency():
    mesh, *_ = small_problem()
    n = len(mesh.vertices)
    dense = np.zeros((n, n))
    for i, j in mesh.edges():
        dense[i, j] = dense[j, i] = -1.0
    dense -= np.diag(dense.sum(axis=1))
    np.testing.assert_array_equal(laplacian(graph_of(mesh.edges(), n)).toarray(), dense)


def test_solution_is_where_the_gradient_vanishes():
    """Dense solution of the normal equations = minimiser: every perturbation costs energy."""
    mesh, targets, weights, _ = small_problem()
    stiffness = laplacian(graph_of(mesh.edges(), len(mesh.vertices)))
    matrix = system(weights, stiffness, **CONSTANTS)
    right = CONSTANTS["k_ext"] * weights[:, None] * targets
    solved, iterations = conjugate_gradient(matrix, right, np.zeros_like(right), tolerance=1e-10, max_iterations=500)
    assert 0 < iterations < 500
    np.testing.assert_allclose(solved, np.linalg.solve(matrix.toarray(), right), atol=1e-8)
    least = plain_energy(solved, targets, weights, mesh)
    rng = np.random.default_rng(1)
    for _ in range(10):
        assert plain_energy(solved + 1e-3 * rng.normal(size=solved.shape), targets, weights, mesh) > least


def test_two_vertices_in_closed_form():
    """Vertices drawn to +t and −t, joined by one edge: δ = ± t k_ext / (k_ext + 2 ρ k_int)."""
    stiffness = laplacian(graph_of(np.array([[0, 1]]), 2))
    matrix = system(np.ones(2), stiffness, **CONSTANTS)
    targets = np.array([[3.0, 0, 0], [-3.0, 0, 0]])
    solved, _ = conjugate_gradient(
        matrix, CONSTANTS["k_ext"] * targets, np.zeros((2, 3)), tolerance=1e-12, max_iterations=50
    )
    expected = 3.0 * 1.3 / (1.3 + 2 * 0.7 * 2.1)
    np.testing.assert_allclose(solved, [[expected, 0, 0], [-expected, 0, 0]], atol=1e-10)


def test_a_start_at_the_solution_needs_no_iteration():
    matrix = csr_array(np.diag([1.0, 2.0, 3.0]))
    solution = np.array([[1.0], [1.0], [1.0]])
    assert conjugate_gradient(matrix, matrix @ solution, solution, tolerance=1e-6, max_iterations=9)[1] == 0


def test_iterations_are_limited():
    mesh, targets, weights, _ = small_problem()
    matrix = system(weights, laplacian(graph_of(mesh.edges(), len(mesh.vertices))), **CONSTANTS)
    assert conjugate_gradient(matrix, targets, np.zeros_like(targets), tolerance=1e-14, max_iterations=3)[1] == 3
