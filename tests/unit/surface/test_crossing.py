"""Faces that pass through one another, against a second library and closed cases."""

import numpy as np
import pytest
from spheres import sphere_mesh
from tests.first_cases import first

from mammometry.geometry.mesh import TriangleMesh
from mammometry.surface.repair.untangle import crossing_faces


def brute_force(mesh):
    """Plain twin: every side against every face, by solving for the crossing point."""
    found = set()
    for a, face in enumerate(mesh.faces):
        for b, other in enumerate(mesh.faces):
            corner, first, second = mesh.vertices[other]
            for p, q in zip(face, np.roll(face, -1), strict=True):
                if a == b or {p, q} & set(other):
                    continue
                matrix = np.stack([mesh.vertices[p] - mesh.vertices[q], first - corner, second - corner], axis=1)
                if abs(np.linalg.det(matrix)) < 1e-12:
                    continue
                t, u, v = np.linalg.solve(matrix, mesh.vertices[p] - corner)
                if 0 < t < 1 and u > 0 and v > 0 and u + v < 1:
                    found.add((min(a, b), max(a, b)))
    return sorted(found)


def test_a_sphere_does_not_cross_itself():
    assert len(crossing_faces(sphere_mesh(20.0, rings=30))) == 0


@pytest.mark.parametrize("seed", first(2, range(4)))
def test_loose_triangles_cross_where_a_plain_search_says(seed):
    rng = np.random.default_rng(seed)
    middles = rng.uniform(0, 6, size=(40, 1, 3))
    sizes = rng.choice([0.4, 1.0, 5.0], size=(40, 1, 1))  # as where fine and coarse cubes meet
    vertices = (middles + sizes * rng.normal(size=(40, 3, 3))).reshape(-1, 3)
    mesh = TriangleMesh(vertices=vertices, faces=np.arange(120, dtype=np.int32).reshape(-1, 3))
    expected = brute_force(mesh)
    assert len(expected) > 3
    assert [tuple(pair) for pair in crossing_faces(mesh).tolist()] == expected


@pytest.mark.parametrize("seed", range(3))
def test_pairs_among_chosen_faces_are_those_of_all_that_have_one(seed):
    rng = np.random.default_rng(seed)
    corners = rng.uniform(0, 12, size=(150, 1, 3)) + rng.choice([0.4, 3.0], size=(150, 1, 1)) * rng.normal(
        size=(150, 3, 3)
    )
    mesh = TriangleMesh(vertices=corners.reshape(-1, 3), faces=np.arange(450, dtype=np.int32).reshape(-1, 3))
    chosen = rng.uniform(size=150) < 0.1
    pairs = crossing_faces(mesh)
    expected = pairs[chosen[pairs].any(axis=1)]
    assert 0 < len(expected) < len(pairs)
    np.testing.assert_array_equal(crossing_faces(mesh, chosen), expected)
    assert not len(crossing_faces(mesh, np.zeros(150, dtype=bool)))


def test_two_overlapping_spheres_cross_along_a_circle():
    one = sphere_mesh(20.0, rings=24)
    both = TriangleMesh(
        vertices=np.concatenate([one.vertices, one.vertices + np.array([7.1, 3.3, 15.2])]),
        faces=np.concatenate([one.faces, one.faces + len(one.vertices)]),
    )
    pairs = crossing_faces(both)
    assert len(pairs) > 20
    assert (pairs[:, 0] < len(one.faces)).all()  # only one sphere with the other
    assert (pairs[:, 1] >= len(one.faces)).all()
    # the circle lies in the plane half-way between the centres
    shift = np.array([7.1, 3.3, 15.2])
    middles = both.corners()[pairs].mean(axis=2)
    along = (middles - shift / 2) @ shift / np.linalg.norm(shift)
    assert np.abs(along).max() < 4.0  # a triangle's own size


def test_a_vertex_pushed_through_the_far_side_is_found():
    sphere = sphere_mesh(20.0, rings=20)
    vertices = sphere.vertices.copy()
    vertices[-2] = [0.3, 0.4, -25.0]  # the upper pole, below the lower one
    pairs = crossing_faces(TriangleMesh(vertices=vertices, faces=sphere.faces))
    assert len(pairs) > 0
    assert ((sphere.faces[pairs] == len(vertices) - 2).any(axis=2)).any(axis=1).all()


def test_no_faces_no_crossings():
    empty = TriangleMesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int32))
    assert crossing_faces(empty).shape == (0, 2)
