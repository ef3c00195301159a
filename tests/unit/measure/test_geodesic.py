"""The tape measure against closed forms: great circles, developable cylinders, a fold that must be gone around."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from solids import ball
from trunks import RADIUS_MM, trunk_mesh

from mammometry.base.errors import MeasureError
from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.landmarks.geodesic import geodesic
from mammometry.measure.landmarks.geodesic_kernels import shortest

BALL = ball(60.0, subdivisions=4)
TRUNK = trunk_mesh(step_mm=6.0)
directions = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda d: np.linalg.norm(d) > 0.2)


@settings(max_examples=6, deadline=None)
@given(directions, directions)
def test_great_circles(first: tuple[float, ...], second: tuple[float, ...]) -> None:
    a, b = (60.0 * np.array(d) / np.linalg.norm(d) for d in (first, second))
    angle = np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)
    path = geodesic(BALL, a, b)
    # 0.5 % is asked for; 0.2 mm is the facets' sag at both ends (8 mm edges on a ball of 60 mm).
    assert path.length_mm == pytest.approx(60.0 * angle, rel=0.005, abs=0.2)
    assert np.linalg.norm(np.diff(path.points_world, axis=0), axis=1).sum() == pytest.approx(path.length_mm)


def test_lengths_are_those_of_scipys_dijkstra() -> None:
    """Along a ball's edges: right for every place that may lie on a way of 1.2 times the shortest length and 3 mm."""
    faces, points = BALL.faces.astype(np.int64), BALL.vertices
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    apart = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    graph = coo_matrix((apart, tuple(pairs.T)), shape=(len(points), len(points))).tocsr()
    from_start, from_stop = dijkstra(graph, directed=True, indices=[0, 700])
    length, before = shortest(points, faces, 0, 700, 1.2, 3.0)
    most = 1.2 * from_start[700] + 3.0
    near = from_start + from_stop <= most
    assert 100 < near.sum() < len(points) - 100
    np.testing.assert_allclose(length[near], from_start[near], rtol=1e-12)
    assert (length >= from_start - 1e-9).all()
    assert np.isinf(length[from_start + np.linalg.norm(points - points[700], axis=1) > most + 20]).all()
    way = [700]
    while way[-1] != 0:
        way.append(before[way[-1]])
    assert np.linalg.norm(np.diff(points[way], axis=0), axis=1).sum() == pytest.approx(from_start[700])


def test_helices_on_a_cylinder() -> None:
    """The trunk's back is a circular cylinder: a geodesic is straight when it is rolled out."""
    for turn, climb in [(0.9, 0.0), (0.6, 90.0), (0.0, 150.0), (1.1, 37.0)]:
        start, stop = np.pi - turn / 2, np.pi + turn / 2
        ends = [
            np.array([RADIUS_MM * np.sin(t), y, RADIUS_MM * np.cos(t)]) for t, y in ((start, -50), (stop, climb - 50))
        ]
        path = geodesic(TRUNK, *ends)
        assert path.length_mm == pytest.approx(np.hypot(RADIUS_MM * turn, climb), rel=0.005)


def test_on_one_face_and_on_a_plane_it_is_straight() -> None:
    x, y = np.meshgrid(np.arange(0.0, 61.0, 5.0), np.arange(0.0, 41.0, 5.0))
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    a = (np.arange(8)[:, None] * 13 + np.arange(12)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + 14], axis=1), np.stack([a, a + 14, a + 13], axis=1)])
    plane = TriangleMesh(vertices=vertices, faces=faces.astype(np.int32))
    assert geodesic(plane, np.array([1.0, 0.5, 0]), np.array([3.0, 1.0, 0])).length_mm == pytest.approx(
        np.hypot(2, 0.5)
    )
    found = geodesic(plane, np.array([1.0, 39.0, 0]), np.array([58.0, 3.0, 0])).length_mm
    assert np.hypot(57, 36) <= found <= 1.005 * np.hypot(57, 36)


def test_parts_that_are_not_connected_are_named() -> None:
    other = TriangleMesh(vertices=BALL.vertices + np.array([200.0, 0, 0]), faces=BALL.faces)
    both = TriangleMesh(
        vertices=np.concatenate([BALL.vertices, other.vertices]),
        faces=np.concatenate([BALL.faces, other.faces + len(BALL.vertices)]).astype(np.int32),
    )
    with pytest.raises(MeasureError, match=r"^surface: .*connected"):
        geodesic(both, np.array([60.0, 0, 0]), np.array([260.0, 0, 0]))
