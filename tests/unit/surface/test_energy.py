"""The elastic energy's matrices against dense algebra and closed-form minima."""

import numpy as np
from spheres import sphere_mesh

from mammometry.surface.repair.energy import graph_of, laplacian, minimum

RHO = 0.7


def small_problem(seed=0):
    mesh = sphere_mesh(10.0, rings=5)
    rng = np.random.default_rng(seed)
    n = len(mesh.vertices)
    return mesh, rng.normal(size=(n, 3)), rng.uniform(0, 1, n), rng.normal(size=(n, 3))


def plain_energy(displacements, targets, weights, mesh):
    """Eq. 4–6, term by term, each edge once."""
    external = sum(w * np.sum((d - t) ** 2) for w, d, t in zip(weights, displacements, targets, strict=True))
    internal = sum(np.sum((displacements[i] - displacements[j]) ** 2) for i, j in mesh.edges())
    return external + RHO * internal


def dense_system(weights, mesh):
    """Ω + ρ L, whose solution is where the gradient of Eq. 4 vanishes."""
    stiffness = laplacian(graph_of(mesh.edges(), len(mesh.vertices))).toarray()
    return np.diag(weights) + RHO * stiffness


def test_neighbours_are_listed_once_in_order():
    graph = graph_of(np.array([[0, 2], [2, 0], [3, 2], [0, 1], [2, 3]]), 5)
    np.testing.assert_array_equal(graph.indptr, [0, 2, 3, 5, 6, 6])
    np.testing.assert_array_equal(graph.indices, [1, 2, 0, 0, 3, 2])


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
    graph = graph_of(mesh.edges(), len(mesh.vertices))
    solved, iterations = minimum(
        targets,
        weights,
        graph,
        RHO,
        start=np.zeros_like(targets),
        tolerance=1e-6,
        max_iterations=500,
    )
    assert 0 < iterations < 500
    right = weights[:, None] * targets
    # single precision: seven digits, less those that the system's condition (about 100) takes
    np.testing.assert_allclose(solved, np.linalg.solve(dense_system(weights, mesh), right), atol=1e-5)
    least = plain_energy(solved, targets, weights, mesh)
    rng = np.random.default_rng(1)
    for _ in range(10):
        assert plain_energy(solved + 1e-2 * rng.normal(size=solved.shape), targets, weights, mesh) > least


def test_two_vertices_in_closed_form():
    """Vertices drawn to +t and −t, joined by one edge: δ = ± t / (1 + 2 ρ)."""
    graph = graph_of(np.array([[0, 1]]), 2)
    targets = np.array([[3.0, 0, 0], [-3.0, 0, 0]])
    solved, _ = minimum(targets, np.ones(2), graph, RHO, start=np.zeros((2, 3)), tolerance=1e-7, max_iterations=50)
    expected = 3.0 / (1 + 2 * RHO)
    np.testing.assert_allclose(solved, [[expected, 0, 0], [-expected, 0, 0]], atol=1e-6)


def test_a_start_at_the_solution_needs_no_iteration():
    mesh, _, weights, _ = small_problem()
    wish = np.ones((len(mesh.vertices), 3))  # all the same: no edge is stretched
    graph = graph_of(mesh.edges(), len(mesh.vertices))
    assert minimum(wish, weights, graph, RHO, start=wish, tolerance=1e-5, max_iterations=9)[1] == 0


def test_iterations_are_limited():
    mesh, targets, weights, _ = small_problem()
    graph = graph_of(mesh.edges(), len(mesh.vertices))
    start = np.zeros_like(targets)
    assert minimum(targets, weights, graph, RHO, start=start, tolerance=1e-14, max_iterations=3)[1] == 3
