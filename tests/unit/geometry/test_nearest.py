import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from mammometry.geometry import nearest
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.nearest import closest_on_mesh, closest_on_triangles, point_tree
from mammometry.geometry.nearest_kernels import IN_A_LEAF, boxes


def box_mesh() -> TriangleMesh:
    """Unit cube, two triangles a side."""
    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], dtype=float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [(a, b, c) for a, b, c, _ in quads] + [(a, c, d) for a, _, c, d in quads]
    return TriangleMesh(vertices=corners, faces=np.array(faces, dtype=np.int32))


def test_distance_from_a_cube_is_that_of_the_clamped_point():
    points = np.random.default_rng(0).uniform(-2, 3, size=(500, 3))
    outside = points[(np.abs(points - 0.5) > 0.5).any(axis=1)]
    found = closest_on_mesh(outside, box_mesh())
    np.testing.assert_allclose(found.points, np.clip(outside, 0, 1), atol=1e-12)
    np.testing.assert_allclose(found.distances_mm, np.linalg.norm(outside - np.clip(outside, 0, 1), axis=1))


def test_inside_a_cube_the_nearest_side_counts():
    points = np.random.default_rng(1).uniform(0.01, 0.99, size=(200, 3))
    expected = np.minimum(points, 1 - points).min(axis=1)
    np.testing.assert_allclose(closest_on_mesh(points, box_mesh()).distances_mm, expected, atol=1e-12)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10_000), st.sampled_from([3, 100]))
def test_faces_of_very_different_size_equal_brute_force(seed, count):
    """Of a few queries and of many."""
    rng = np.random.default_rng(seed)
    sizes = 10.0 ** rng.uniform(-2, 2, size=(40, 1, 1))
    corners = rng.normal(size=(40, 1, 3)) * 30 + rng.normal(size=(40, 3, 3)) * sizes
    mesh = TriangleMesh(vertices=corners.reshape(-1, 3), faces=np.arange(120, dtype=np.int32).reshape(40, 3))
    points = rng.normal(size=(count, 3)) * 40
    everywhere = np.stack([closest_on_triangles(points, np.broadcast_to(c, (count, 3, 3))) for c in corners])
    brute = np.linalg.norm(everywhere - points, axis=2).min(axis=0)
    found = closest_on_mesh(points, mesh)
    np.testing.assert_allclose(found.distances_mm, brute, rtol=1e-12, atol=1e-12)
    on_face = closest_on_triangles(points, mesh.corners()[found.faces])
    np.testing.assert_allclose(on_face, found.points, atol=1e-12)


def test_closest_point_of_a_triangle_beats_dense_samples():
    rng = np.random.default_rng(2)
    triangles, points = rng.normal(size=(200, 3, 3)), 2 * rng.normal(size=(200, 3))
    found = np.linalg.norm(closest_on_triangles(points, triangles) - points, axis=1)
    u, v = np.meshgrid(np.linspace(0, 1, 60), np.linspace(0, 1, 60))
    inside = u + v <= 1
    bary = np.stack([1 - u - v, u, v], axis=-1)[inside]
    sampled = np.linalg.norm(bary @ triangles - points[:, None], axis=2).min(axis=1)
    assert (found <= sampled + 1e-12).all()
    assert (sampled - found).max() < 0.1  # sample spacing


def test_triangles_without_area_are_segments():
    flat = np.array([[[0.0, 0, 0], [1.0, 0, 0], [0.5, 0, 0]]])
    np.testing.assert_allclose(closest_on_triangles(np.array([[0.25, 2.0, 0]]), flat), [[0.25, 0, 0]], atol=1e-12)


@pytest.mark.parametrize("count", [3, 100])
def test_faces_far_from_all_queries_change_nothing(monkeypatch, count):
    rng = np.random.default_rng(7)
    u, v = np.meshgrid(np.linspace(0, 100, 60), np.linspace(0, 100, 60))
    vertices = np.stack([u, v, rng.normal(size=u.shape)], axis=-1).reshape(-1, 3)
    corner = (np.arange(59)[:, None] * 60 + np.arange(59)).ravel()
    faces = np.stack([corner, corner + 1, corner + 61], axis=1).astype(np.int32)
    mesh = TriangleMesh(vertices=vertices, faces=faces)
    points = rng.uniform([60, 20, -8], [80, 40, 8], (count, 3))
    plain = closest_on_mesh(points, mesh)
    monkeypatch.setattr(nearest, "_LARGE", 1000)
    monkeypatch.setattr(nearest, "_SOME", 500)
    near = nearest._faces_near(points, mesh)
    assert near is not None
    assert len(near) < len(faces) / 4
    found = closest_on_mesh(points, mesh)
    np.testing.assert_array_equal(found.distances_mm, plain.distances_mm)
    on_face = closest_on_triangles(points, mesh.corners()[found.faces])  # at a shared corner it may be another face
    np.testing.assert_allclose(on_face, found.points, atol=1e-12)


def test_a_mesh_without_faces_is_refused():
    with pytest.raises(ValueError, match="faces"):
        closest_on_mesh(
            np.zeros((1, 3)), TriangleMesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int32))
        )


def test_a_fine_mesh_seen_from_afar_equals_brute_force():
    """Far away thousands of faces are almost equally near; one of them is a mere segment."""
    u, v = np.meshgrid(np.linspace(-1, 1, 40), np.linspace(-1, 1, 40))
    vertices = np.stack([20 * u, 20 * v, 3 * np.cos(2 * u) * np.sin(v)], axis=-1).reshape(-1, 3)
    corner = (np.arange(39)[:, None] * 40 + np.arange(39)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + 1, corner + 41], 1), np.stack([corner, corner + 41, corner + 40], 1), [[0, 1, 1]]]
    )
    mesh = TriangleMesh(vertices=vertices, faces=faces.astype(np.int32))
    points = np.random.default_rng(4).normal(size=(40, 3)) * [30, 30, 150]
    brute = [
        np.linalg.norm(closest_on_triangles(np.broadcast_to(p, (len(faces), 3)), mesh.corners()) - p, axis=1).min()
        for p in points
    ]
    np.testing.assert_allclose(closest_on_mesh(points, mesh).distances_mm, brute, rtol=1e-12)


@pytest.mark.parametrize("count", [1, 4, 5, 33])
def test_boxes_hold_what_lies_below_them(count):
    """The plain twin: every box from the faces that it stands for, at once."""
    corners = np.random.default_rng(count).normal(size=(count, 3, 3))
    low, high = boxes(corners)
    leaves = (len(low) + 1) // 2
    assert leaves * IN_A_LEAF >= count
    for node in range(len(low)):
        first, last = node, node
        while first < leaves - 1:
            first, last = 2 * first + 1, 2 * last + 2
        below = corners[(first - leaves + 1) * IN_A_LEAF : (last - leaves + 2) * IN_A_LEAF].reshape(-1, 3)
        np.testing.assert_array_equal(low[node], below.min(axis=0, initial=np.inf))
        np.testing.assert_array_equal(high[node], below.max(axis=0, initial=-np.inf))


def test_a_point_tree_finds_what_scipys_own_finds():
    """Points of a plane, seen from near and far; doubles too."""
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(-50, 50, (3000, 2)), np.zeros(3000)])
    asked = np.concatenate([points[:100] + 1e-3, rng.normal(size=(300, 3)) * 60])
    for tree in (point_tree(points), point_tree(np.concatenate([points, points]))):
        distance, nearest = tree.query(asked, distance_upper_bound=80.0)
        expected, there = cKDTree(points).query(asked, distance_upper_bound=80.0)
        np.testing.assert_array_equal(distance, expected)
        found = np.isfinite(expected)
        np.testing.assert_array_equal(nearest[found] % 3000, there[found])
