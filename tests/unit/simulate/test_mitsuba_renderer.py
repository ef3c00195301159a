"""Two renderers, one scene: Mitsuba's picture lies where the built-in one does. Slow; needs the extra ``sim``."""

import importlib.util

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from mammometry.base.errors import SettingsError
from mammometry.geometry.transform import Transform
from mammometry.simulate.rendering import mitsuba_renderer
from mammometry.simulate.rendering.mitsuba_renderer import _quartered, render_by_mitsuba
from mammometry.simulate.rendering.render import render_subject
from mammometry.simulate.rendering.scene import light_scene
from mammometry.simulate.rendering.skin import SkinReflectance
from mammometry.simulate.rigs.build import flashes
from mammometry.simulate.rigs.rig_file import make_rig
from mammometry.simulate.studio import Studio
from mammometry.simulate.subjects.shapes import sphere


def test_quartering_keeps_the_surface():
    mesh = sphere(20.0, 4.0).mesh
    values, faces = _quartered(mesh.vertices, mesh.faces)
    assert len(faces) == 4 * len(mesh.faces)
    assert len(values) == len(mesh.vertices) + 3 * len(mesh.faces) // 2

    def volume(points, corners):
        a, b, c = (points[corners[:, k]] for k in range(3))
        return float((a * np.cross(b, c)).sum() / 6.0)

    assert volume(values, faces) == pytest.approx(mesh.volume_mm3(), rel=1e-12)


def test_without_the_extra_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setattr(mitsuba_renderer.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(SettingsError, match=r"mammometry\[sim\]"):
        Studio(renderer="mitsuba")


def _shift_px(a: np.ndarray, b: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """By how many pixels (u, v) picture b lies beside a, with a gain of its own: linear least squares, iterated."""
    from scipy.ndimage import shift as moved

    total = np.zeros(2)
    for _ in range(4):
        back = moved(b, -total[::-1], order=3, mode="nearest")
        gy, gx = np.gradient(0.5 * (a + back))
        design = np.stack([gx[mask], gy[mask], back[mask], np.ones(mask.sum())], axis=1)
        total += np.linalg.lstsq(design, (a - back)[mask] + back[mask], rcond=None)[0][:2]
    return total


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("mitsuba") is None, reason="the extra sim is not installed")
def test_mitsubas_surface_lies_under_the_same_pixels():
    import mitsuba as mi

    camera = make_rig("reference:front", 0.25, 3).cameras["front_right"]
    scene = light_scene(sphere(40.0, 3.0), Transform.identity(), flashes())
    mi.set_variant("scalar_rgb")
    world = mitsuba_renderer._world(scene, SkinReflectance(), 5)
    rng = np.random.default_rng(0)
    uv = camera.project(np.zeros((1, 3))) + rng.uniform(-110.0, 110.0, (600, 2))
    directions = camera.rays_world(uv)
    start = camera.centre_world
    found = []
    for direction in directions.tolist():
        hit = world.ray_intersect(mi.Ray3f(mi.Point3f(*start.tolist()), mi.Vector3f(*direction)))
        found.append(list(hit.p) if hit.is_valid() else [np.nan] * 3)
    seen = np.isfinite(found).all(axis=1)
    ours = scene.rays.run(
        np.broadcast_to(start.astype(np.float32), (600, 3)).copy(), directions.astype(np.float32), output=True
    )
    assert 300 < seen.sum() < 600
    assert np.array_equal(seen, ours["primID"] >= 0)
    points = np.array(found)[seen]
    # In float32 a place at 0.8 m is known to 0.00006 mm, 0.0002 px.
    assert np.abs(camera.project(points) - uv[seen]).max() < 0.002
    assert np.linalg.norm(points - start, axis=1) == pytest.approx(ours["tfar"][seen], abs=2e-3)


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("mitsuba") is None, reason="the extra sim is not installed")
def test_renderers_agree_in_the_place_of_the_paint_to_two_hundredths_of_a_pixel():
    camera = make_rig("reference:front", 0.1, 3).cameras["front_left"]
    # Strong paint, so that the paths' noise does not count.
    skin = SkinReflectance(base_rgb=(0.15, 0.15, 0.15), contrast=0.35, colour_contrast=0.0, specular=0.0, wrap=0.0)
    scene = light_scene(sphere(40.0, 0.6), Transform.identity(), flashes(), skin=skin)
    built_in = render_subject(scene, camera, skin, seed=5)[..., 1].astype(float)
    physical = render_by_mitsuba(scene, camera, skin, seed=5)[..., 1].astype(float)
    # The paint: within the ball, without what is as coarse as the shading.
    u, v = camera.project(np.zeros((1, 3)))[0]
    row, column = np.mgrid[: built_in.shape[0], : built_in.shape[1]]
    radius = np.hypot(column - u, row - v)
    disc_px = 40.0 * camera.matrix[0, 0] / 780.0
    paint = [np.log(np.maximum(image, 1e-3)) for image in (built_in, physical)]
    paint = [gaussian_filter(image, 0.8) - gaussian_filter(image, 6.0) for image in paint]
    assert np.abs(_shift_px(*paint, radius < 0.75 * disc_px)).max() < 0.02
    assert np.corrcoef(*(image[radius < 0.75 * disc_px] for image in paint))[0, 1] > 0.8
    # And the light: the same flashes and surroundings, plus what the ball's own reflections do not add.
    bright = radius < 0.75 * disc_px
    assert physical[bright].mean() == pytest.approx(built_in[bright].mean(), rel=0.10)


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("mitsuba") is None, reason="the extra sim is not installed")
def test_renderers_agree_in_the_place_of_the_outline_to_two_hundredths_of_a_pixel():
    camera = make_rig("reference:front", 0.1, 3).cameras["front_left"]
    skin = SkinReflectance(contrast=0.0, colour_contrast=0.0, specular=0.0, wrap=0.0)
    # Without flashes the limb is lit alike all round: how the renderers' limbs darken can move no outline sideways.
    dark = np.array([[0.0, 0.0, 900.0, 0.0]])
    scene = light_scene(sphere(25.0, 0.6), Transform.identity(), dark, skin=skin)
    u, v = camera.project(np.zeros((1, 3)))[0]
    radius_px = 25.0 * camera.matrix[0, 0] / np.linalg.norm(camera.centre_world)
    angle = np.linspace(0.0, 2 * np.pi, 720, endpoint=False)
    steps = np.linspace(radius_px - 6.0, radius_px + 3.0, 91)
    x, y = u + np.cos(angle)[:, None] * steps, v + np.sin(angle)[:, None] * steps
    places = []
    for render in (render_subject, render_by_mitsuba):
        image = render(scene, camera, skin, seed=5)[..., 1].astype(float)
        profiles = map_coordinates(image, [y, x], order=1)
        places.append([np.interp(0.5 * p[:30].mean(), p[:29:-1], steps[:29:-1]) for p in profiles])
    offset = np.subtract(places[1], places[0])
    assert abs(offset.mean()) < 0.1  # Mitsuba's limb is of another brightness, which moves the half of it
    for wave in (np.cos(angle), np.sin(angle)):
        assert abs(2.0 * (offset * wave).mean()) < 0.02
