import numpy as np
import pytest
from spheres import camera_towards, rig_of, sphere_mesh

from mammometry.base.photograph import Photograph
from mammometry.geometry.mesh import TriangleMesh
from mammometry.surface.texture.texture import TexturedMesh, paint


def plain(name, rgb, size=120):
    return Photograph(name=name, pixels=np.full((size, size, 3), rgb, dtype=np.uint8))


def test_each_side_takes_the_colour_of_the_camera_that_sees_it():
    cameras = [camera_towards("top", (0, 0, 1)), camera_towards("bottom", (0, 0, -1))]
    mesh = sphere_mesh(30.0, rings=30)
    textured = paint(
        mesh, {"top": plain("top", (200, 50, 50)), "bottom": plain("bottom", (50, 50, 200))}, rig_of(cameras)
    )
    z = mesh.vertices[:, 2]
    np.testing.assert_array_equal(textured.colours[z > 10], np.broadcast_to([200, 50, 50], ((z > 10).sum(), 3)))
    np.testing.assert_array_equal(textured.colours[z < -10], np.broadcast_to([50, 50, 200], ((z < -10).sum(), 3)))
    # seen too obliquely by either: grey
    assert (textured.colours[np.abs(z) < 0.5] == 128).all()


def test_photographs_are_levelled_to_one_another():
    cameras = [camera_towards("a", (0, 0, 1)), camera_towards("b", (0.5, 0, 1))]
    textured = paint(
        sphere_mesh(30.0), {"a": plain("a", (100, 100, 100)), "b": plain("b", (160, 160, 160))}, rig_of(cameras)
    )
    seen = textured.colours[(textured.colours != 128).any(axis=1)]
    # the gains' logarithms sum to zero: both become the geometric mean, 126.5
    assert np.abs(seen.astype(int) - 126).max() <= 1


def test_position_in_the_photograph_counts():
    camera = camera_towards("a", (0, 0, 1))
    ramp = np.repeat((np.arange(120) * 2).astype(np.uint8)[None, :, None], 120, axis=0).repeat(3, axis=2)
    mesh = sphere_mesh(30.0)
    other = camera_towards("b", (0, 0, -1))
    textured = paint(mesh, {"a": Photograph(name="a", pixels=ramp.copy())}, rig_of([camera, other]))
    top = mesh.vertices[:, 2] > 20
    expected = 2 * camera.project(mesh.vertices[top])[:, 0]
    assert np.abs(textured.colours[top, 0] - expected).max() < 1.01  # rounding, and the ramp's own steps


def test_what_stands_between_hides():
    small, large = sphere_mesh(8.0, rings=20), sphere_mesh(30.0, rings=30)
    both = TriangleMesh(
        vertices=np.concatenate([large.vertices, small.vertices + np.array([0, 0, 80.0])]),
        faces=np.concatenate([large.faces, small.faces + len(large.vertices)]),
    )
    cameras = [camera_towards("a", (0, 0, 1)), camera_towards("b", (0, 0, -1))]
    textured = paint(both, {"a": plain("a", (250, 0, 0))}, rig_of(cameras))
    beside = np.hypot(large.vertices[:, 0], large.vertices[:, 1])
    upper = large.vertices[:, 2] > 0
    colours = textured.colours[: len(large.vertices)]
    assert (colours[upper & (beside < 6)] == 128).all()  # in the small sphere's shadow
    assert (colours[upper & (beside > 14) & (beside < 25)] == [250, 0, 0]).all()


def test_grey_photographs_give_grey():
    camera = camera_towards("a", (0, 0, 1))
    photograph = Photograph(name="a", pixels=np.full((120, 120), 90, dtype=np.uint8))
    mesh = sphere_mesh(30.0)
    textured = paint(mesh, {"a": photograph}, rig_of([camera, camera_towards("b", (0, 0, -1))]))
    assert (textured.colours[mesh.vertices[:, 2] > 15] == 90).all()


def test_one_colour_per_vertex():
    with pytest.raises(ValueError, match="colours"):
        TexturedMesh(mesh=sphere_mesh(10.0), colours=np.zeros((2, 3), dtype=np.uint8))
