"""Compiled look-ups in photographs against plain NumPy and SciPy."""

import numpy as np
import pytest
from scipy import ndimage
from spheres import camera_towards, sphere_mesh

from mammometry.surface.fusion.camera_records import view_row
from mammometry.surface.texture import texture_kernels
from mammometry.surface.texture.texture import PhotographLevels


def test_weights_and_places_are_those_of_the_camera():
    camera, mesh = camera_towards("a", (0.3, 0.1, 1), size=60), sphere_mesh(40.0)
    normals = mesh.vertex_normals()
    row = view_row(camera, camera.shape_hw, 0)
    weights, places = texture_kernels.facing(np.array(mesh.vertices), normals, row, camera.centre_world, 0.1, 6.0)
    towards = camera.centre_world - mesh.vertices
    distance = np.linalg.norm(towards, axis=1)
    cosine = np.einsum("ij,ij->i", normals, towards) / distance
    expected = camera.project(mesh.vertices)
    shown = (cosine > 0.1) & (expected >= 0).all(axis=1) & (expected < 59).all(axis=1)
    assert 0 < shown.sum() < (cosine > 0.1).sum()  # some lie beside the picture
    np.testing.assert_array_equal(weights > 0, shown)
    np.testing.assert_allclose(places[shown, :2], expected[shown], atol=1e-9)
    depth = camera.camera_from_world.apply(mesh.vertices)[:, 2]
    np.testing.assert_allclose(1 / places[:, 2], depth, rtol=1e-12)
    np.testing.assert_allclose(weights[shown], (cosine**6 * (1000 / distance) ** 2)[shown], rtol=1e-6)


def test_a_plane_hides_nothing_of_itself_and_what_lies_behind_it():
    rows, columns = np.indices((40, 50))
    inverse = (1e-3 + 4e-5 * columns - 2e-5 * rows).astype(np.float32)  # steep: 10 mm and more a pixel
    uv = np.random.default_rng(2).uniform([0, 0], [48.9, 38.9], (300, 2))
    own = 1e-3 + 4e-5 * uv[:, 0] - 2e-5 * uv[:, 1]
    assert (own > 0).all()
    on_it = np.column_stack([uv, own])
    assert not texture_kernels.hidden(on_it, inverse, 0.1).any()
    far_behind = np.column_stack([uv, 1 / (1 / own + 800.0)])
    assert texture_kernels.hidden(far_behind, inverse, 0.1).all()
    beside = np.column_stack([uv + 60, 1 / (1 / own + 800.0)])
    assert not texture_kernels.hidden(beside, inverse, 0.1).any()


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [1, 3])
def test_colours_are_linear_between_pixels_and_the_borders_beside_them(kind, channels):
    rng = np.random.default_rng(5)
    levels = rng.integers(0, np.iinfo(kind).max, (20, 30, channels), dtype=kind)
    uv = rng.uniform(-3, 33, (500, 2))
    found = PhotographLevels(levels=levels, full_scale=float(np.iinfo(kind).max)).colours_at(uv)
    for channel in range(3):
        plain = levels[..., min(channel, channels - 1)] / np.iinfo(kind).max
        exact = ndimage.map_coordinates(plain, uv[:, ::-1].T, order=1, mode="nearest")
        np.testing.assert_allclose(found[:, channel], exact, atol=1e-6)
