"""The photographs on the viewing mesh: where each face looks in the picture, and what it finds there."""

import numpy as np
import pytest
from scipy import ndimage
from spheres import camera_towards, rig_of, sphere_mesh

from mammometry.base.photograph import Photograph
from mammometry.io.meshes.own import write_glb, write_obj
from mammometry.surface.texture.simplify import thinned
from mammometry.surface.texture.texture_atlas import Atlas, best_views, cover

SIZE = 240
RADIUS = 30.0


def painted(points):
    """Colour of the sphere's paint at points on it, 0…255: smooth, different everywhere."""
    return 120.0 + 60.0 * np.sin(points / np.array([5.0, 7.0, 6.0]) + np.array([0.0, 1.0, 2.0]))


def photograph(camera, gain=1.0):
    """What a camera sees of the painted sphere."""
    uv = np.stack(np.meshgrid(np.arange(SIZE, dtype=float), np.arange(SIZE, dtype=float)), axis=-1)
    rays, origin = camera.rays_world(uv), camera.centre_world
    along = rays @ origin
    inside = along**2 - origin @ origin + RADIUS**2
    hits = origin + rays * (-along - np.sqrt(np.maximum(inside, 0.0)))[..., None]
    pixels = np.where((inside > 0)[..., None], gain * painted(hits), 10.0)
    return Photograph(name=camera.name, pixels=np.clip(np.rint(pixels), 0, 255).astype(np.uint8))


@pytest.fixture(scope="module")
def scene():
    directions = {"top": (0, 0.1, 1), "side": (1, 0, 0.3), "other": (-1, 0.2, 0.3)}
    cameras = [camera_towards(n, d, size=SIZE, focal=1000.0) for n, d in directions.items()]
    gains = {"top": 1.0, "side": 1.2, "other": 0.9}
    photographs = {camera.name: photograph(camera, gains[camera.name]) for camera in cameras}
    return rig_of(cameras), photographs


@pytest.fixture(scope="module")
def atlas(scene):
    rig, photographs = scene
    return cover(sphere_mesh(RADIUS, rings=40), photographs, rig)


def looked_up(atlas, faces):
    """The picture's colour at the middles of faces, and where those are."""
    at = atlas.uv_px[faces].mean(axis=1)
    colours = [ndimage.map_coordinates(atlas.picture[..., c].astype(float), at.T[::-1], order=1) for c in range(3)]
    return np.stack(colours, axis=1), atlas.mesh.corners()[faces].mean(axis=1)


def test_every_face_finds_its_own_paint_in_the_picture(atlas):
    shown = np.flatnonzero(atlas.view >= 0)
    assert 0.6 < len(shown) / len(atlas.view) < 0.95  # nobody sees it from below
    colours, middles = looked_up(atlas, shown)
    expected = painted(middles * RADIUS / np.linalg.norm(middles, axis=1, keepdims=True))
    # gains of .9 to 1.2 are levelled to one another, to a common brightness that is nobody's own
    level = np.median(colours / expected)
    assert 0.9 < level < 1.2
    error = np.abs(colours - level * expected)
    # half a pixel of paint: 60 levels · .4 mm / 5 mm = 5 levels, on the most slanting faces twice that
    assert np.median(error) < 2.5
    assert np.percentile(error, 95) < 10.0


def far_from_seams(atlas):
    """Vertices so far from faces of another photograph that nothing fades there: six rings."""
    near = np.zeros(len(atlas.mesh.vertices), dtype=bool)
    shown = [np.isin(np.arange(len(near)), atlas.mesh.faces[atlas.view == k]) for k in range(-1, len(atlas.names))]
    near[np.sum(shown, axis=0) > 1] = True
    for _ in range(6):
        near[atlas.mesh.faces[near[atlas.mesh.faces].any(axis=1)]] = True
    return np.flatnonzero(~near)


def test_photographs_keep_their_own_pixels(scene, atlas):
    rig, photographs = scene
    for k, name in enumerate(atlas.names):
        faces = np.flatnonzero(atlas.view == k)
        inside = rig.cameras[name].project(atlas.mesh.vertices)[atlas.mesh.faces[faces]]
        shift = atlas.uv_px[faces] - inside
        # each chart is a piece of the photograph, shifted by whole pixels: as sharp as it was taken
        np.testing.assert_allclose(shift, np.rint(shift[:, :1]) + 0 * shift, atol=1e-3)
        inner = faces[np.isin(atlas.mesh.faces[faces], far_from_seams(atlas)).all(axis=1)]
        colours, _ = looked_up(atlas, inner)
        at = rig.cameras[name].project(atlas.mesh.vertices)[atlas.mesh.faces[inner]].mean(axis=1).T[::-1]
        pixels = photographs[name].pixels.astype(float)
        own = np.stack([ndimage.map_coordinates(pixels[..., c], at, order=1) for c in range(3)], axis=1)
        assert len(inner) > 100
        # one smooth factor for exposure, and its rounding: nothing of another photograph
        assert np.std(colours / own) < 0.02


def seam_edges(atlas):
    """Sides that two faces of different photographs share: place of their middle in the one's piece and the other's."""
    of, places = {}, []
    for face, corners in enumerate(atlas.mesh.faces.tolist()):
        for k in range(3):
            side = frozenset((corners[k], corners[k - 2]))
            middle = (atlas.uv_px[face, k] + atlas.uv_px[face, k - 2]) / 2
            other = of.setdefault(side, (face, middle))
            if other[0] != face and -1 not in atlas.view[[face, other[0]]] and atlas.view[face] != atlas.view[other[0]]:
                places.append((middle, other[1]))
    return np.array(places)


def test_no_step_is_left_at_seams(scene):
    """Stripes of brightness, different in each photograph and too fine to be levelled, fade into one another."""
    rig, photographs = scene
    stripes = {"top": 8.0, "side": -8.0, "other": 20.0}
    dark = (np.arange(SIZE) // 12 % 2 == 0)[:, None, None]
    striped = {}
    for name, shot in photographs.items():
        pixels = np.clip(shot.pixels + np.where(dark, 0.0, stripes[name]), 0, 255)
        striped[name] = Photograph(name=name, pixels=pixels.astype(np.uint8))
    atlas = cover(sphere_mesh(RADIUS, rings=40), striped, rig)
    here, there = seam_edges(atlas).transpose(1, 2, 0)
    both = (
        np.stack([ndimage.map_coordinates(atlas.picture[..., c].astype(float), at[::-1], order=1) for c in range(3)])
        for at in (here, there)
    )
    steps = np.subtract(*both)
    assert here.shape[1] > 100
    # without fading the stripes' 8 to 28 levels; what is left is half a pixel of stripe's edge between pixels' grids
    assert np.median(np.abs(steps)) < 1.0
    assert np.percentile(np.abs(steps), 95) < 3.5


def test_faces_show_the_photograph_that_faces_them(scene, atlas):
    rig, _ = scene
    middles = atlas.mesh.corners().mean(axis=1)
    for k, name in enumerate(atlas.names):
        axis = rig.cameras[name].centre_world / np.linalg.norm(rig.cameras[name].centre_world)
        faces_it = middles @ axis > 0.95 * RADIUS
        assert (atlas.view[faces_it] == k).all()
    assert (atlas.view[middles[:, 2] < -0.96 * RADIUS] == -1).all()
    grey, _ = looked_up(atlas, np.flatnonzero(atlas.view < 0))
    np.testing.assert_array_equal(grey, 128.0)


def test_a_face_that_nobody_sees_whole_shows_none():
    mesh = sphere_mesh(RADIUS, rings=10)
    weights = np.zeros((2, len(mesh.vertices)), dtype=np.float32)
    weights[0, mesh.faces[0]] = 1.0
    weights[1, mesh.faces[0][:2]] = 5.0  # stronger, but not at the third corner
    view = best_views(mesh, weights)
    assert view[0] == 0
    assert (view[(weights[0][mesh.faces] == 0).any(axis=1)] == -1).all()


def test_a_small_limit_makes_a_small_picture(scene, monkeypatch):
    rig, photographs = scene
    mesh = sphere_mesh(RADIUS, rings=40)
    whole = cover(mesh, photographs, rig)
    monkeypatch.setattr("mammometry.surface.texture.texture_atlas.ATLAS_PX", 150)
    small = cover(mesh, photographs, rig)
    assert max(small.picture.shape[:2]) <= 150 < max(whole.picture.shape[:2])
    np.testing.assert_array_equal(small.view, whole.view)
    inner = np.flatnonzero(np.isin(whole.mesh.faces, far_from_seams(whole)).all(axis=1) & (whole.view >= 0))
    error = np.abs(looked_up(small, inner)[0] - looked_up(whole, inner)[0])
    # a pixel of either and the mean of those that become one: a wave of the paint is some twelve pixels long
    assert np.median(error) < 6.0


def test_thinning_keeps_the_shape():
    mesh = sphere_mesh(RADIUS, rings=60)
    small = thinned(mesh, 4000)
    assert len(small.faces) <= 4000
    assert np.abs(np.linalg.norm(small.vertices, axis=1) - RADIUS).max() < 0.25
    assert thinned(small, 10**6) is small


def test_glb_and_obj_are_read_back_by_another_library(scene, tmp_path):
    import trimesh

    rig, photographs = scene
    atlas = cover(sphere_mesh(RADIUS, rings=30), photographs, rig)
    write_glb(tmp_path / "model.glb", atlas)
    write_obj(tmp_path / "model.obj", atlas)
    for name, unit in (("model.glb", 1000.0), ("model.obj", 1.0)):
        read = trimesh.load(tmp_path / name, force="mesh", process=False)
        assert len(read.faces) == len(atlas.mesh.faces)
        np.testing.assert_allclose(
            np.sort(unit * read.triangles_center, axis=0), np.sort(atlas.mesh.corners().mean(axis=1), axis=0), atol=1e-3
        )
        material = read.visual.material
        picture = material.baseColorTexture if name.endswith("glb") else material.image
        assert picture.size == atlas.picture.shape[1::-1]
        # the first face's first corner, in texture coordinates whose row 0 is at the bottom
        corner = read.visual.uv[read.faces[0][0]]
        width, height = picture.size
        np.testing.assert_allclose(
            [corner[0] * width - 0.5, (1 - corner[1]) * height - 0.5], atlas.uv_px[0, 0], atol=2e-2
        )


def test_one_place_per_corner():
    mesh = sphere_mesh(RADIUS, rings=4)
    with pytest.raises(ValueError, match=r"\b48 faces"):
        Atlas(
            mesh=mesh,
            uv_px=np.zeros((1, 3, 2), dtype=np.float32),
            picture=np.zeros((1, 1, 3), dtype=np.uint8),
            view=np.zeros(len(mesh.faces), dtype=np.int64),
            names=(),
        )
