"""Pictures of a ball and of a cube, against what geometry says they must show."""

import numpy as np
import pytest
import synthetic
import trimesh
from embreex.mesh_construction import TriangleMesh as EmbreeMesh
from embreex.rtcore_scene import EmbreeScene

from mammometry.geometry.mesh import TriangleMesh
from mammometry.report.figures.shading import (
    ShadedMesh,
    ViewDirection,
    front_frame,
    join_segments,
    picture_wh,
    section,
    standard_views,
    visible,
)
from mammometry.report.figures.shading_kernels import shaded

FRONT = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
"""Right, up and towards the viewer for a viewer at negative z with y down."""


@pytest.fixture(scope="module")
def ball() -> TriangleMesh:
    return synthetic.ball()


@pytest.fixture(scope="module")
def view(ball: TriangleMesh) -> ViewDirection:
    return ViewDirection(name="front", view_from_world=FRONT, centre_world=np.zeros(3), span_mm=(160.0, 160.0))


def test_a_ball_fills_its_disc_and_bulges_to_its_radius(ball: TriangleMesh, view: ViewDirection) -> None:
    cast = ShadedMesh(ball).cast(view, 320)
    disc_mm2 = cast.hit.mean() * 160.0**2
    # inscribed polyhedron of edge 4 mm: radius short by at most 0.1 mm of 60; the raster adds less than .1 %
    assert disc_mm2 == pytest.approx(np.pi * synthetic.RADIUS_MM**2, rel=0.005)
    assert disc_mm2 < np.pi * synthetic.RADIUS_MM**2 * 1.001
    assert cast.towards_mm.max() == pytest.approx(synthetic.RADIUS_MM, abs=0.15)
    row, column = np.nonzero(cast.hit)
    x = (column + 0.5) / 2 - 80
    y = 80 - (row + 0.5) / 2
    bulge = np.sqrt(np.maximum(synthetic.RADIUS_MM**2 - x**2 - y**2, 0))
    inner = bulge > 20
    assert np.abs(cast.towards_mm[cast.hit] - bulge)[inner].max() < 0.5


def test_the_picture_is_not_mirrored(view: ViewDirection) -> None:
    """A small ball to the right of and above the middle appears there: world +x is right, world −y is up."""
    mesh = synthetic.ball(2)
    moved = TriangleMesh(vertices=mesh.vertices * 0.1 + (40.0, -30.0, 0.0), faces=mesh.faces)
    row, column = np.nonzero(ShadedMesh(moved).render(view, size_px=160)[..., 3])
    assert column.mean() == pytest.approx(80 + 40, abs=1)
    assert row.mean() == pytest.approx(80 - 30, abs=1)


def test_light_falls_off_away_from_the_lamps_and_edges_are_smooth(ball: TriangleMesh, view: ViewDirection) -> None:
    picture = ShadedMesh(ball).render(view, size_px=200)
    grey = picture[..., :3].mean(axis=2)
    assert grey[100, 100] > 1.5 * grey[100, 30]
    alpha = picture[..., 3]
    assert set(np.unique(alpha)) - {0, 255}
    assert alpha[0, 0] == 0
    assert alpha[100, 100] == 255


def test_colours_of_vertices_and_faces_arrive_unlit_as_they_are(ball: TriangleMesh, view: ViewDirection) -> None:
    blue = np.tile(np.array([10, 20, 200], dtype=np.uint8), (len(ball.vertices), 1))
    picture = ShadedMesh(ball).render(view, size_px=100, colours=blue, lit=False)
    np.testing.assert_array_equal(picture[50, 50], (10, 20, 200, 255))
    half = np.where((ball.corners()[:, :, 0].mean(axis=1) > 0)[:, None], np.float32([1, 0, 0]), np.float32([0, 1, 0]))
    picture = ShadedMesh(ball).render(view, size_px=100, face_colours=half, lit=False)
    assert tuple(picture[50, 70, :3]) == (255, 0, 0)
    assert tuple(picture[50, 30, :3]) == (0, 255, 0)
    both = ShadedMesh(ball).render(view, size_px=100, colours=blue, face_colours=half, lit=False)
    np.testing.assert_array_equal(both, picture)


def _shaded_twin(seen, weights, faces, colours, by_face, normals, lit, lights, ambient):
    corners = faces[seen]
    surface = colours[seen] if by_face else np.einsum("hwk,hwkc->hwc", weights, colours[corners])
    upright = np.einsum("hwk,hwkc->hwc", weights, normals[corners])
    upright /= np.linalg.norm(upright, axis=2, keepdims=True).clip(1e-9)
    upright *= np.where(upright[..., 2:] < 0, -1, 1)
    light = ambient + (upright @ lights.T).clip(0).sum(axis=2, keepdims=True)
    hit = (seen >= 0)[..., None]
    full = np.where(hit, (surface * (1 + lit * (light - 1))).clip(0, 1), 0)
    sums, counts = (sum(a[y::2, x::2] for y in (0, 1) for x in (0, 1)) for a in (full, hit.astype(float)))
    return np.concatenate([sums / counts.clip(1), counts / 4], axis=2) * 255 + 0.5


@pytest.mark.parametrize(("by_face", "lit"), [(False, 0.0), (False, 0.5), (True, 1.0)])
def test_shading_is_its_plain_twins(ball: TriangleMesh, view: ViewDirection, by_face: bool, lit: float) -> None:
    rng = np.random.default_rng(5)
    cast = ShadedMesh(ball).cast(view, 120)
    colours = rng.random((len(ball.faces if by_face else ball.vertices), 3), dtype=np.float32)
    normals = ball.vertex_normals().astype(np.float32) @ FRONT.T.astype(np.float32)
    lights = rng.normal(0, 0.4, (3, 3)).astype(np.float32)
    given = (cast.faces, cast.weights, ball.faces, colours, by_face, normals, lit, lights, 0.2)
    twin = _shaded_twin(*given)
    made = shaded(*given)
    assert np.abs(made - np.floor(twin)).max() <= 1  # a level of 255, where single precision rounds the other way
    assert (made == np.floor(twin)).mean() > 0.999


def test_points_are_seen_in_front_and_hidden_behind(ball: TriangleMesh, view: ViewDirection) -> None:
    points = np.array([[0, 0, -synthetic.RADIUS_MM], [0, 0, synthetic.RADIUS_MM], [70.0, 0.0, 0.0]])
    np.testing.assert_array_equal(visible(points, view, ShadedMesh(ball).cast(view, 200)), [True, False, True])


def test_each_pixel_shows_what_a_ray_through_it_meets(ball: TriangleMesh) -> None:
    """Two balls, one partly behind the other, from an oblique direction, against embree's rays."""
    behind = ball.vertices * 0.7 + (30.0, -20.0, 40.0)
    both = TriangleMesh(
        vertices=np.concatenate([ball.vertices, behind]), faces=np.concatenate([ball.faces, ball.faces + len(behind)])
    )
    frame, _ = np.linalg.qr(np.array([[0.9, 0.2, -0.1], [0.3, 0.8, 0.4], [-0.2, 0.3, 0.9]]))
    frame *= np.sign(np.linalg.det(frame))
    view = ViewDirection(
        name="oblique", view_from_world=frame, centre_world=np.array([5.0, 3.0, 1.0]), span_mm=(150.0, 120.0)
    )
    cast = ShadedMesh(both).cast(view, 200)
    right, up, towards = frame
    width, height = picture_wh(view, 200)
    across, down = (np.arange(width) + 0.5) * 150 / width - 75, 60 - (np.arange(height) + 0.5) * 120 / height
    plane = view.centre_world + across[None, :, None] * right + down[:, None, None] * up
    scene = EmbreeScene()
    EmbreeMesh(scene, both.vertices.astype(np.float32)[both.faces])
    start = (plane + 200.0 * towards).reshape(-1, 3).astype(np.float32)
    met = scene.run(start, np.broadcast_to(-towards, start.shape).astype(np.float32).copy(), output=1)
    faces = met["primID"].reshape(height, width)
    # On an edge either face may be named; what is seen there is the same.
    assert (cast.faces == faces).mean() > 0.999
    assert np.array_equal(cast.hit, faces >= 0)
    far_mm = 200.0 - met["tfar"].reshape(height, width)
    assert np.abs(cast.towards_mm - far_mm)[cast.hit].max() < 5e-3  # rays of single precision, grazing faces
    points = (both.vertices[both.faces[cast.faces[cast.hit]]] * cast.weights[cast.hit][:, :, None]).sum(axis=1)
    assert np.abs(points - plane[cast.hit] - cast.towards_mm[cast.hit][:, None] * towards).max() < 1e-4


def test_an_empty_mesh_is_an_empty_picture(view: ViewDirection) -> None:
    empty = TriangleMesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int32))
    assert not ShadedMesh(empty).render(view, size_px=40).any()


def test_a_section_of_a_ball_is_a_circle(ball: TriangleMesh) -> None:
    height_mm = 20.0
    normal = np.array([0.0, 1.0, 0.0])
    segments, faces = section(ball, np.array([0.0, height_mm, 0.0]), normal)
    np.testing.assert_allclose(segments @ normal, height_mm, atol=1e-9)
    radii = np.linalg.norm(segments[..., [0, 2]], axis=-1)
    assert radii.max() <= np.sqrt(synthetic.RADIUS_MM**2 - height_mm**2) + 1e-9
    assert radii.min() > np.sqrt(synthetic.RADIUS_MM**2 - height_mm**2) - 0.3
    assert len(np.unique(faces)) == len(faces)
    lines = join_segments(segments[..., [0, 2]])
    assert len(lines) == 1
    np.testing.assert_allclose(lines[0][0], lines[0][-1])
    length = np.linalg.norm(np.diff(lines[0], axis=0), axis=1).sum()
    assert length == pytest.approx(2 * np.pi * np.sqrt(synthetic.RADIUS_MM**2 - height_mm**2), rel=0.003)


def test_a_section_beside_the_mesh_is_empty(ball: TriangleMesh) -> None:
    segments, _ = section(ball, np.array([0.0, 100.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    assert join_segments(segments) == []


def test_the_front_is_where_the_cameras_stand_and_up_is_theirs() -> None:
    frame = front_frame(synthetic.rig())
    np.testing.assert_allclose(frame, FRONT, atol=0.01)
    assert np.linalg.det(frame) == pytest.approx(1.0)


def test_the_patients_left_is_on_the_right_of_the_picture() -> None:
    frame = front_frame(synthetic.rig(), patient_left_world=np.array([0.0, 5.0, 1.0]))
    np.testing.assert_allclose(frame[0], (0, 1, 0), atol=0.01)
    assert np.linalg.det(frame) == pytest.approx(1.0)


def test_standard_views_share_one_scale_and_turn_as_named() -> None:
    mesh = synthetic.ball(2)
    nose = TriangleMesh(vertices=mesh.vertices * 0.05 - (0.0, 0.0, synthetic.RADIUS_MM), faces=mesh.faces)
    box = trimesh.creation.box((120, 100, 80))
    views = standard_views(
        TriangleMesh(vertices=np.asarray(box.vertices), faces=np.asarray(box.faces, dtype=np.int32)), FRONT
    )
    assert len({view.span_mm for view in views}) == 1
    across = {view.name: view.view_from_world @ nose.vertices.mean(axis=0) for view in views}
    assert across["45° from the left"][0] > 40  # a viewer to the left sees what stands out to the right
    assert across["45° from the right"][0] < -40
    assert across["45° from below"][1] > 40  # and one below sees it above
    for view in views:
        assert np.linalg.det(view.view_from_world) == pytest.approx(1.0)


def test_pictures_have_even_sides_in_the_views_proportion() -> None:
    view = ViewDirection(name="", view_from_world=np.eye(3), centre_world=np.zeros(3), span_mm=(100.0, 37.0))
    width, height = picture_wh(view, 301)
    assert width % 2 == height % 2 == 0
    assert height / width == pytest.approx(0.37, abs=0.01)
