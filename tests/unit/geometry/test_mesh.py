"""Meshes of closed forms: polyhedra exactly, inscribed spheres from below with the known order, topology by Euler."""

import numpy as np
import pytest
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from mammometry.geometry import mesh_kernels
from mammometry.geometry.arrays import bounds
from mammometry.geometry.mesh import TriangleMesh, joined
from mammometry.geometry.transform import Transform


def from_trimesh(mesh: trimesh.Trimesh) -> TriangleMesh:
    return TriangleMesh(
        vertices=np.asarray(mesh.vertices, dtype=np.float64), faces=np.asarray(mesh.faces, dtype=np.int32)
    )


@pytest.fixture(scope="module")
def box() -> TriangleMesh:
    """20 × 30 × 40 mm, 5 m from the origin: coordinates that would eat digits."""
    return from_trimesh(trimesh.creation.box((20, 30, 40))).transformed(
        Transform(rotation=Rotation.from_euler("xyz", (0.3, 0.5, 0.7)).as_matrix(), translation_mm=np.full(3, 5000.0))
    )


def sphere(subdivisions: int, radius_mm: float = 50.0) -> TriangleMesh:
    return from_trimesh(trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_mm))


def test_a_box_has_its_volume_and_area(box: TriangleMesh) -> None:
    assert box.volume_mm3() == pytest.approx(20 * 30 * 40, abs=1e-6)
    assert box.area_mm2() == pytest.approx(2 * (20 * 30 + 30 * 40 + 40 * 20), abs=1e-8)
    assert box.is_watertight()
    assert box.euler_number() == 2


def test_an_inscribed_sphere_is_too_small_and_four_times_less_so_at_each_subdivision() -> None:
    exact_mm3, exact_mm2 = 4 / 3 * np.pi * 50.0**3, 4 * np.pi * 50.0**2
    volume_errors = [exact_mm3 - sphere(n).volume_mm3() for n in (2, 3, 4, 5)]
    area_errors = [exact_mm2 - sphere(n).area_mm2() for n in (2, 3, 4, 5)]
    assert min(volume_errors) > 0
    assert min(area_errors) > 0
    # a chord's sagitta goes with the square of its length, which halves; 3 % covers the next order
    assert volume_errors[1] / volume_errors[2] == pytest.approx(4, rel=0.03)
    assert volume_errors[2] / volume_errors[3] == pytest.approx(4, rel=0.01)
    assert area_errors[2] / area_errors[3] == pytest.approx(4, rel=0.01)


def test_normals_of_a_sphere_point_outwards_along_the_radius() -> None:
    mesh = sphere(4)
    radial = mesh.vertices / 50.0
    cosines = np.einsum("ij,ij->i", mesh.vertex_normals(), radial)
    assert cosines.min() > np.cos(0.02)  # an edge of 4 mm on 50 mm turns by 0.08 rad; averaged over the fan much less


def test_a_vertex_without_area_has_no_normal() -> None:
    mesh = TriangleMesh(vertices=np.eye(4, 3), faces=np.array([[0, 1, 1]], dtype=np.int32))
    np.testing.assert_array_equal(mesh.vertex_normals(), 0.0)


@pytest.mark.parametrize(
    ("mesh", "euler"),
    [
        (sphere(2), 2),
        (from_trimesh(trimesh.creation.torus(30, 10)), 0),
        (from_trimesh(trimesh.creation.annulus(5, 10, 20)), 0),
    ],
    ids=["sphere", "torus", "tube"],
)
def test_euler_number_counts_the_tunnels(mesh: TriangleMesh, euler: int) -> None:
    assert mesh.is_watertight()
    assert mesh.euler_number() == euler


def test_a_hole_a_flipped_face_and_a_doubled_face_are_not_watertight() -> None:
    mesh = sphere(2)
    assert not TriangleMesh(vertices=mesh.vertices, faces=mesh.faces[1:]).is_watertight()
    flipped = mesh.faces.copy()
    flipped[0] = flipped[0, ::-1]
    assert not TriangleMesh(vertices=mesh.vertices, faces=flipped).is_watertight()
    doubled = np.r_[mesh.faces, mesh.faces[:1], mesh.faces[:1, ::-1]]
    assert not TriangleMesh(vertices=mesh.vertices, faces=doubled).is_watertight()
    assert not TriangleMesh(vertices=mesh.vertices, faces=mesh.faces[:0]).is_watertight()


def test_an_open_mesh_keeps_its_euler_number() -> None:
    assert sphere(2).submesh(np.arange(1, 320)).euler_number() == 1


def test_each_edge_once() -> None:
    edges = sphere(1).edges()
    assert len(edges) == 80 * 3 // 2
    assert (edges[:, 0] < edges[:, 1]).all()
    assert len(np.unique(edges, axis=0)) == len(edges)


def test_two_balls_are_two_components_and_a_loose_vertex_a_third() -> None:
    one = sphere(1)
    n = len(one.vertices)
    both = TriangleMesh(
        vertices=np.r_[one.vertices, one.vertices + 200.0, np.zeros((1, 3))],
        faces=np.r_[one.faces, one.faces + np.int32(n)],
    )
    count, labels = both.components()
    assert count == 3
    assert len(set(labels[:n])) == len(set(labels[n : 2 * n])) == 1
    assert len({labels[0], labels[n], labels[2 * n]}) == 3
    assert both.euler_number() == 4


def test_a_submesh_keeps_geometry_and_drops_unused_vertices() -> None:
    mesh = sphere(2)
    upper = mesh.submesh(mesh.corners()[:, :, 2].min(axis=1) > 0)
    assert upper.vertices[:, 2].min() > 0
    assert len(np.unique(upper.faces)) == len(upper.vertices)
    expected = np.linalg.norm(mesh.face_vectors()[mesh.corners()[:, :, 2].min(axis=1) > 0], axis=1).sum()
    assert upper.area_mm2() == pytest.approx(expected)


def test_impossible_meshes_are_refused() -> None:
    vertices = np.zeros((3, 3))
    with pytest.raises(ValueError, match="vertices"):
        TriangleMesh(vertices=vertices, faces=np.array([[0, 1, 3]], dtype=np.int32))
    with pytest.raises(ValueError, match="vertices"):
        TriangleMesh(vertices=vertices, faces=np.array([[0, 1, -1]], dtype=np.int32))
    with pytest.raises(ValueError, match="finite"):
        TriangleMesh(vertices=np.full((3, 3), np.inf), faces=np.array([[0, 1, 2]], dtype=np.int32))


def test_arrays_cannot_be_written_through_the_mesh() -> None:
    with pytest.raises(ValueError, match="read-only"):
        sphere(1).vertices[0, 0] = 1.0


def test_annotated_shapes_are_checked_while_tests_run() -> None:
    from jaxtyping import TypeCheckError

    with pytest.raises(TypeCheckError):
        TriangleMesh(vertices=np.zeros((3, 2)), faces=np.zeros((1, 3), dtype=np.int32))


def test_angle_defects_sum_to_the_euler_number_and_are_a_box_corner_s(box: TriangleMesh) -> None:
    defects = mesh_kernels.angle_defects(box.vertices, box.faces)
    np.testing.assert_allclose(defects, np.pi / 2, atol=1e-6)  # three right angles are missing a quarter of a turn
    for mesh in (sphere(2), from_trimesh(trimesh.creation.torus(30.0, 10.0))):
        turns = mesh_kernels.angle_defects(mesh.vertices, mesh.faces).sum() / (2 * np.pi)
        assert turns == pytest.approx(mesh.euler_number(), abs=1e-9)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_open_vertices_are_the_ends_of_sides_without_opposites(seed: int) -> None:
    mesh = sphere(3)
    faces = mesh.faces[np.random.default_rng(seed).uniform(size=len(mesh.faces)) < 0.9]
    sides = {(int(a), int(b)) for a, b in faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)}
    expected = np.zeros(len(mesh.vertices), dtype=bool)
    expected[[end for a, b in sides if (b, a) not in sides for end in (a, b)]] = True
    np.testing.assert_array_equal(mesh_kernels.open_vertices(len(mesh.vertices), faces), expected)
    assert not mesh_kernels.open_vertices(len(mesh.vertices), mesh.faces).any()


def test_every_part_has_its_own_volume(box: TriangleMesh) -> None:
    ball = sphere(2)
    hollow = TriangleMesh(vertices=0.5 * ball.vertices, faces=ball.faces[:, ::-1])
    three = [box, ball, hollow]
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in three])
    faces = np.concatenate([mesh.faces + start for mesh, start in zip(three, starts, strict=False)]).astype(np.int32)
    all_vertices = np.concatenate([mesh.vertices for mesh in three])
    count, part = TriangleMesh(vertices=all_vertices, faces=faces).components()
    volumes = mesh_kernels.part_volumes(all_vertices, faces, part, count)
    np.testing.assert_allclose(volumes, [mesh.volume_mm3() for mesh in three], rtol=1e-6)
    assert volumes[2] < 0


def test_meshes_are_carried_turned_over_and_joined() -> None:
    ball = sphere(2)
    far = ball.mapped(lambda points: points * 2 + 500.0)
    assert far.volume_mm3() == pytest.approx(8 * ball.volume_mm3())
    assert far.turned_over().volume_mm3() == pytest.approx(-far.volume_mm3())
    mirrored = ball.mapped(lambda points: points * (-1, 1, 1)).turned_over()
    assert mirrored.volume_mm3() == pytest.approx(ball.volume_mm3())
    both = joined([ball, far])
    assert both.components()[0] == 2
    assert both.is_watertight()
    assert both.volume_mm3() == pytest.approx(9 * ball.volume_mm3())
    one = both.vertices_used_by(np.arange(len(ball.faces)))
    assert np.array_equal(np.flatnonzero(one), np.arange(len(ball.vertices)))


@pytest.fixture(params=["closed", "open", "three on an edge"])
def some_faces(request: pytest.FixtureRequest) -> TriangleMesh:
    """A ball; the same with holes; the same with a fin, whose edge on the ball three faces share."""
    ball = sphere(2)
    if request.param == "open":
        return TriangleMesh(vertices=ball.vertices, faces=np.delete(ball.faces, [3, 77, 78, 200], axis=0))
    if request.param == "three on an edge":
        a, b, _ = ball.faces[11]
        fin = np.array([[b, a, len(ball.vertices)]], dtype=np.int32)
        return TriangleMesh(
            vertices=np.concatenate([ball.vertices, [[90.0, 0.0, 0.0]]]), faces=np.concatenate([ball.faces, fin])
        )
    return ball


def sides_by_edge(faces: np.ndarray) -> dict[tuple[int, int], list[int]]:
    edges: dict[tuple[int, int], list[int]] = {}
    for number, (a, b) in enumerate(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()):
        edges.setdefault((min(a, b), max(a, b)), []).append(number)
    return edges


def test_rings_hold_the_sides_of_one_edge(some_faces: TriangleMesh) -> None:
    rings = mesh_kernels.edge_rings(len(some_faces.vertices), some_faces.faces)
    for sides in sides_by_edge(some_faces.faces).values():
        assert [int(rings[side]) for side in sides] == [*sides[1:], sides[0]]


def test_faces_fall_into_parts_along_walls(some_faces: TriangleMesh) -> None:
    """As scipy's search over all pairs of faces on one edge says."""
    faces = some_faces.faces
    height = some_faces.vertices[faces].mean(axis=1)[:, 2]
    walls = np.zeros(3 * len(faces), dtype=bool)
    pairs = []
    for sides in sides_by_edge(faces).values():
        above = {bool(height[side // 3] > 10.0) for side in sides}
        walls[sides] = len(above) > 1
        pairs += [(sides[0] // 3, side // 3) for side in sides[1:] if len(above) == 1]
    graph = coo_matrix((np.ones(len(pairs)), tuple(np.array(pairs).T)), shape=(len(faces), len(faces)))
    count, part = mesh_kernels.face_parts(mesh_kernels.edge_rings(len(some_faces.vertices), faces), walls)
    expected_count, expected = connected_components(graph, directed=False)
    assert count == expected_count >= 2
    np.testing.assert_array_equal(part, expected)  # both are numbered by their first faces


@pytest.mark.parametrize("columns", [2, 3])
def test_bounds_are_the_extremes_of_each_column(columns):
    points = np.random.default_rng(1).normal(size=(50, columns))
    low, high = bounds(points)
    np.testing.assert_array_equal(low, points.min(axis=0))
    np.testing.assert_array_equal(high, points.max(axis=0))


def test_topology_of_any_faces_is_that_of_their_sorted_sides() -> None:
    """Closed, open, doubled, turned over, folded up: against sorted keys of all sides."""
    rng = np.random.default_rng(22)
    solid = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]], dtype=np.int32)
    seen = {True: 0, False: 0}
    for number in range(600):
        faces = rng.integers(0, 8, (rng.integers(0, 8), 3)).astype(np.int32)
        if number % 2:
            faces = np.concatenate([solid, solid + 4 * (number % 4 == 1), faces[: number % 3]])
        mesh = TriangleMesh(vertices=rng.random((8, 3)), faces=faces)
        directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        forward, backward = np.sort(directed @ [8, 1]), np.sort(directed @ [1, 8])
        closed = len(faces) > 0 and len(np.unique(forward)) == len(forward) and (forward == backward).all()
        assert mesh.is_watertight() == closed
        assert mesh.euler_number() == len(np.unique(faces)) - len(mesh.edges()) + len(faces)
        seen[bool(closed)] += 1
    assert min(seen.values()) > 50
