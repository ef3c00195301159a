"""The marks on the skin against plain NumPy twins, and what softness, sheen and hair do to a picture."""

from dataclasses import replace

import numpy as np
import pytest

from mammometry.geometry.transform import Transform
from mammometry.simulate.rendering import shading
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.render import render_subject
from mammometry.simulate.rendering.scene import LIGHTS, SCATTER, Room, light_scene
from mammometry.simulate.rendering.skin import SKINS, SkinReflectance, make_skin
from mammometry.simulate.rigs.rig_file import make_rig
from mammometry.simulate.subjects.shapes import sphere

_PLAIN = SkinReflectance(contrast=0.0, colour_contrast=0.0, specular=0.0)
_WORD = 1 << 64


def _mixed(state: int) -> int:
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        state = ((state ^ (state >> shift)) * factor) % _WORD
    return state ^ (state >> 31)


def _spots_twin(point, cell, least, most, share, seed):
    low = np.floor(np.asarray(point) / cell).astype(int)
    hashed = seed
    for index, prime in zip(low.tolist(), (0x8DA6B343, 0xD8163841, 0xCB1AB31F), strict=True):
        hashed ^= (index * prime) % _WORD
    bits = _mixed(hashed)
    size = _mixed(bits)
    if (size & 0xFFFF) >= share * 65535:
        return 0.0
    radius = least + (most - least) * ((size >> 16) & 0xFFFF) / 65535
    jitter = np.array([bits & 0xFFFF, (bits >> 16) & 0xFFFF, (bits >> 32) & 0xFFFF]) / 65535
    centre = low * cell + radius + (cell - 2 * radius) * jitter
    depth = np.clip(2.5 * (1 - np.linalg.norm(point - centre) / radius), 0, 1)
    return depth**2 * (3 - 2 * depth)


def test_spots_are_their_twin_and_lie_within_their_cells():
    rng = np.random.default_rng(3)
    values = []
    for point in rng.uniform(-20, 20, (400, 3)):
        twin = _spots_twin(point, 4.0, 1.0, 1.9, 0.7, 987654321)
        assert shading.spots(*point, 4.0, 1.0, 1.9, 0.7, np.uint64(987654321)) == pytest.approx(twin, abs=1e-9)
        values.append(twin)
    assert 0.05 < np.mean(np.array(values) > 0) < 0.5
    for edge in rng.uniform(-20, 20, (50, 2)):  # nothing is cut off at a cell's wall
        assert shading.spots(8.0, *edge, 4.0, 1.0, 1.9, 1.0, np.uint64(5)) == 0.0


def test_veins_are_lines_a_few_millimetres_wide():
    xs = np.arange(0.0, 3000.0, 0.1)
    line = np.array([shading.veins(x, 11.0, 7.0, np.uint64(77)) for x in xs])
    assert line.min() >= 0.0
    assert line.max() > 0.5
    inside = line > 0.3
    step = np.diff(inside.astype(int))
    first, last = np.flatnonzero(step == 1), np.flatnonzero(step == -1)
    runs = [last[last > start].min() - start for start in first if (last > start).any()]
    assert 1.0 < 0.1 * np.median(runs) < 12.0  # crossed at all angles
    assert 0.01 < inside.mean() < 0.3


def _painted(skin, points, footprint=0.1, areola=0.0):
    return shading.paint_at(
        points,
        np.full(len(points), areola),
        footprint,
        np.array([skin.base_rgb, skin.areola_rgb]),
        skin.spectrum(),
        skin.marks(),
        np.uint64(42),
    )


@pytest.mark.slow
def test_marks_only_darken_and_each_in_its_colour():
    points = np.random.default_rng(1).uniform(-100, 100, (60000, 3))
    bare = _painted(_PLAIN, points)
    assert bare == pytest.approx(np.broadcast_to(_PLAIN.base_rgb, bare.shape), abs=1e-12)
    assert _painted(_PLAIN, points[:5], areola=1.0)[0] == pytest.approx(_PLAIN.areola_rgb)
    for mark in ({"pores": 0.3}, {"moles": 40.0}, {"veins": 0.4}):
        ratio = _painted(replace(_PLAIN, **mark), points) / bare
        assert ratio.max() <= 1.0
        assert ratio.min() < 0.8
        if "pores" in mark:
            assert ratio.min() == pytest.approx(0.7, abs=1e-6)
            assert ratio[:, 0] == pytest.approx(ratio[:, 2])  # grey
        if "veins" in mark:  # they take red, so that they look blue
            assert ratio[:, 0].mean() < ratio[:, 1].mean() < ratio[:, 2].mean()


@pytest.mark.slow
def test_moles_come_as_often_as_said():
    skin = replace(_PLAIN, moles=30.0)
    step = 0.5
    # Slices through space: 30 × 1000 cm² hold 900 of them; count the connected dark places.
    from scipy.ndimage import label

    count, area = 0, 0.0
    for z in (3.0, 47.0, 91.0, 150.0):
        x, y = np.meshgrid(np.arange(0.0, 400.0, step), np.arange(0.0, 400.0, step))
        points = np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1)
        dark = (_painted(skin, points)[:, 0] / skin.base_rgb[0] < 0.97).reshape(x.shape)
        count += label(dark)[1]
        area += 400.0**2
    assert count / (area / 1e5) == pytest.approx(
        30.0, rel=0.5
    )  # of about 200: 7 % by chance, and small ones are missed


@pytest.mark.slow
def test_light_below_the_skin_moves_and_is_kept():
    solid = sphere(50.0, 1.0)
    light = np.array([[0.0, 0.0, 900.0, 900.0**2]])
    scene = light_scene(solid, Transform.identity(), light, skin=SKINS["skin"])
    gained = scene.attributes[:, SCATTER:LIGHTS]
    z = scene.vertices[:, 2]
    # It comes out beyond the terminator, red farthest, and is missing before it.
    beyond, before = np.abs(z + 1.0) < 2.0, np.abs(z - 7.0) < 2.0  # the terminator is at 50² / 900 = 2.8
    assert gained[beyond, 0].mean() > gained[beyond, 1].mean() > gained[beyond, 2].mean() > 0.0
    assert np.abs(gained[z > 45.0]).max() < 0.02
    assert gained[before, 0].mean() < 0.0
    hard = light_scene(solid, Transform.identity(), light)
    assert np.all(hard.attributes[:, SCATTER:LIGHTS] == 0.0)
    # Uniform mesh: what one place gains another has lost, to the unevenness of the mesh.
    assert abs(gained[:, 0].mean()) < 0.02 * np.abs(gained[:, 0]).mean() + 2e-4


@pytest.fixture(scope="module")
def camera():
    return make_rig("reference:front", 0.12, 3).cameras["front_left"]


def test_hairs_are_thin_dark_and_on_the_skin(camera):
    solid = sphere(30.0, 2.0)
    light = np.array([[0.0, 0.0, 900.0, 900.0**2]])
    skin = replace(_PLAIN, hair_per_cm2=4.0)
    hairy = light_scene(solid, Transform.identity(), light, skin=skin, seed=2)
    bald = light_scene(solid, Transform.identity(), light, skin=_PLAIN, seed=2)
    assert len(hairy.strands) == pytest.approx(4.0 * 4 * np.pi * 9.0, rel=0.02)
    roots = np.linalg.norm(hairy.strands[:, 0], axis=1)
    assert roots == pytest.approx(30.0, abs=0.05)
    assert np.linalg.norm(hairy.strands, axis=2).min() > 29.0
    assert hairy.subject.volume_mm3() == bald.subject.volume_mm3()
    with_hair = render_subject(hairy, camera, skin, seed=1)[..., 1]
    without = render_subject(bald, camera, skin, seed=1)[..., 1]
    inside = without > 0.3
    ratio = with_hair[inside] / without[inside]
    # 0.1 mm wide, 4.5 mm long in the mean, 4 a cm²: they hide 4.5 % of what is seen face on, more near the limb.
    assert 0.01 < 1.0 - ratio.mean() < 0.10
    assert ratio.min() < 0.95


@pytest.mark.slow
def test_clutter_fills_the_picture_and_leaves_the_subject(camera):
    solid = sphere(30.0, 2.0)
    light = np.array([[0.0, 0.0, 900.0, 900.0**2]])
    pictures = []
    for clutter in (False, True):
        scene = light_scene(solid, Transform.identity(), light, skin=_PLAIN, room=Room(clutter=clutter), seed=4)
        pictures.append(render_subject(scene, camera, _PLAIN, seed=1))
    column, row = np.round(camera.project(np.zeros((1, 3)))[0]).astype(int)
    middle = np.s_[row - 15 : row + 15, column - 15 : column + 15]
    assert np.array_equal(pictures[0][middle], pictures[1][middle])
    corner = np.s_[:60, :60]
    assert pictures[0][corner].max() == 0.0
    assert pictures[1][corner].min() > 0.0


@pytest.mark.slow
def test_sheen_moves_with_the_camera_and_paint_does_not():
    rig = make_rig("reference:front", 0.12, 3)
    solid = sphere(40.0, 2.0)
    light = np.array([[0.0, 260.0, 880.0, 900.0**2]])
    sweat = replace(SKINS["sweat"], contrast=0.0, colour_contrast=0.0, pores=0.0, moles=0.0, veins=0.0)
    dry = replace(sweat, specular=0.0)
    scene = light_scene(solid, Transform.identity(), light, skin=sweat)
    places = []
    for camera in rig.cameras.values():
        wet, matt = (render_subject(scene, camera, skin, seed=1)[..., 1] for skin in (sweat, dry))
        glint = wet - matt
        assert glint.min() >= -1e-6
        assert glint.max() > 0.3
        row, column = np.nonzero(glint > 0.3 * glint.max())
        uv = np.stack([column, row], axis=1).mean(axis=0)
        ray = camera.rays_world(uv[None])[0]
        along = -camera.centre_world @ ray
        nearest = camera.centre_world + along * ray
        places.append(nearest)
    assert np.linalg.norm(places[0] - places[1]) > 3.0  # mm on a ball of 40: a false match


def test_presets_and_words():
    assert make_skin("plaster") == SkinReflectance()
    assert make_skin("skin", contrast=0.01, hair_per_cm2=2.0).contrast == 0.01
    with pytest.raises(ValueError, match="plaster"):
        make_skin("leather")
    with pytest.raises(ValueError, match=r"pores .*0 .*1"):
        SkinReflectance(pores=1.5)
    with pytest.raises(ValueError, match="jpeg_quality"):
        Film(jpeg_quality=0)
