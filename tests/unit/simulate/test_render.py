"""Pictures against analytic outlines and against what stereo needs: the same paint from every side."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from skimage.measure import find_contours

from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform
from mammometry.simulate.rendering import kernels, render
from mammometry.simulate.rendering.render import blocks, render_subject, subject_coverage
from mammometry.simulate.rendering.sampling import PINHOLE, lens_parameters, net_offsets
from mammometry.simulate.rendering.scene import Room, StudioScene, light_scene
from mammometry.simulate.rendering.skin import SKINS, SkinReflectance
from mammometry.simulate.rigs.build import flashes
from mammometry.simulate.rigs.rig_file import make_rig
from mammometry.simulate.subjects.plaster import PlasterShape, plaster
from mammometry.simulate.subjects.shapes import sphere
from mammometry.simulate.subjects.solid import SubjectSolid

_RADIUS_MM = 60.0
_SCALE = 0.12
_PLAIN = SkinReflectance(contrast=0.0, colour_contrast=0.0, specular=0.0)


@pytest.fixture(scope="module")
def camera() -> Camera:
    return make_rig("reference:front", _SCALE, 3).cameras["front_left"]


@pytest.fixture(scope="module")
def ball() -> StudioScene:
    # Facets of 0.5 mm on a radius of 60 mm lie at most 0.0005 mm inside the sphere.
    solid = sphere(_RADIUS_MM, 1.0)
    return light_scene(solid, Transform.identity(), flashes())


def _offset_from_outline_px(camera: Camera, uv: np.ndarray) -> np.ndarray:
    """How far pixel positions lie outside the analytic outline of the sphere around the origin, px."""
    distance = np.linalg.norm(camera.centre_world)
    angle = np.arccos(camera.rays_world(uv) @ (-camera.centre_world / distance))
    return (angle - math.asin(_RADIUS_MM / distance)) * camera.matrix[0, 0]


def test_coverage_is_the_spheres_outline(ball, camera):
    coverage = subject_coverage(ball, camera)
    contour = max(find_contours(coverage, 0.5), key=len)[:, ::-1]
    offset = _offset_from_outline_px(camera, contour)
    assert len(contour) > 300
    assert abs(offset.mean()) < 0.01
    assert np.abs(offset).max() < 0.15  # contours interpolate linearly what is a box's ramp
    row, column = np.mgrid[: coverage.shape[0], : coverage.shape[1]]
    outside = _offset_from_outline_px(camera, np.stack([column, row], axis=-1).reshape(-1, 2).astype(float)).reshape(
        coverage.shape
    )
    assert coverage[outside < -1.0].min() == 1.0
    assert coverage[outside > 1.0].max() == 0.0


@pytest.mark.slow
def test_silhouette_in_the_picture_is_the_true_one(ball, camera):
    image = render_subject(ball, camera, _PLAIN, seed=1)[..., 0]
    coverage = subject_coverage(ball, camera)
    contour = max(find_contours(coverage, 0.5), key=len)[:, ::-1]
    middle = camera.project(np.zeros((1, 3)))[0]
    outward = (contour - middle) / np.linalg.norm(contour - middle, axis=1, keepdims=True)
    # The limb is shaded: its own brightness just inside is what half of the step is measured against.
    steps = np.linspace(-3.0, 3.0, 61)
    offsets = []
    for point, direction in zip(contour[::3], outward[::3], strict=True):
        line = point + steps[:, None] * direction
        profile = map_coordinates(image, [line[:, 1], line[:, 0]], order=1)
        inside = np.interp(-1.2, steps, profile)
        if inside > 0.02:
            offsets.append(np.interp(-0.5 * inside, -profile[18:], steps[18:]))
    assert len(offsets) > 80
    assert abs(np.mean(offsets)) < 0.1


def test_nothing_is_lit_where_no_flash_reaches(camera):
    solid = sphere(_RADIUS_MM, 4.0)
    behind = np.array([[0.0, 0.0, -900.0, 900.0**2]])
    scene = light_scene(solid, Transform.identity(), behind)
    image = render_subject(scene, camera, _PLAIN, seed=1)
    row, column = np.round(camera.project(np.zeros((1, 3)))[0]).astype(int)[::-1]
    assert 0 < image[row, column, 0] < 0.1  # the surroundings alone


def test_breast_shades_its_own_fold_and_its_backdrop():
    solid = plaster(PlasterShape(sag=0.8, volume_cc=300.0), edge_mm=3.0)
    light = np.array([[0.0, 900.0, 300.0, 900.0**2]])  # from above
    scene = light_scene(solid, Transform.identity(), light, Room(backdrop=True))
    seen = scene.attributes[:, 8]
    vertices = scene.vertices
    board = np.arange(len(vertices)) >= scene.subject_vertices
    below = board & (np.abs(vertices[:, 0]) < 10.0) & (vertices[:, 1] < solid.base_boundary[:, 1].min() - 2.0)
    below &= vertices[:, 1] > solid.base_boundary[:, 1].min() - 8.0
    above = board & (vertices[:, 1] > solid.base_boundary[:, 1].max() + 10.0)
    assert below.any()
    assert seen[below].max() < 0.1
    assert seen[above].min() == pytest.approx(1.0)
    assert scene.subject.volume_mm3() == pytest.approx(solid.mesh.volume_mm3(), rel=1e-6)


@pytest.mark.slow
def test_samples_of_plain_pixels_lie_on_their_own_rays(ball, camera):
    (plain,) = (block for block in blocks(ball, camera, PINHOLE) if not block.is_edge)
    offsets = net_offsets(4)
    second, third = np.zeros(4 * len(plain.row)), np.zeros(4 * len(plain.row))
    kernels.in_plane(
        plain.row,
        plain.column,
        offsets,
        lens_parameters(camera),
        camera.camera_from_world.rotation.copy(),
        camera.centre_world,
        ball.mesh.faces,
        ball.vertices,
        plain.face,
        second,
        third,
    )
    corners = ball.mesh.vertices[ball.mesh.faces[np.repeat(plain.face, 4)]]
    weights = np.stack([1.0 - second - third, second, third], axis=1)
    points = (weights[:, :, None] * corners).sum(axis=1)
    middle = np.stack([plain.column, plain.row], axis=1)
    assert camera.project(points) == pytest.approx((middle[:, None] + offsets).reshape(-1, 2), abs=1e-3)
    # And on the sphere: what faces beside a pixel's own would tell differs by their bend over half a pixel.
    radius = np.linalg.norm(points, axis=1)
    assert np.abs(radius - _RADIUS_MM).max() < 0.02
    assert np.abs(radius - _RADIUS_MM).mean() < 0.002


@pytest.mark.slow
@pytest.mark.parametrize("name", ["plaster", "skin"])
def test_sharing_light_and_coarse_paint_within_a_pixel_changes_nothing_to_be_seen(ball, camera, monkeypatch, name):
    skin = SKINS[name]
    shared = render_subject(ball, camera, skin, seed=5)
    rows = np.zeros(camera.shape_hw, dtype=bool)
    (plain,) = (block for block in blocks(ball, camera, PINHOLE) if not block.is_edge)
    rows[plain.row, plain.column] = True
    monkeypatch.setattr(render, "blocks", lambda *_: (replace(plain, is_edge=True),))
    alone = render_subject(ball, camera, skin, seed=5)
    difference = (shared - alone)[rows] / alone[rows].mean()
    assert abs(difference.mean()) < 1e-3
    assert np.sqrt((difference**2).mean()) < 0.01  # of 4 samples against 32; the sensor's noise is as large


def test_a_boxs_sides_are_pieces_of_their_own():
    scene = light_scene(sphere(20.0, 4.0), Transform.identity(), flashes(), Room(backdrop=True, clutter=True), seed=1)
    assert (scene.piece[: scene.subject_faces] == 0).all()
    board = scene.piece[scene.subject_faces : -240 * 12]
    assert len(np.unique(board)) == 1
    sides = scene.piece[-240 * 12 :].reshape(-1, 2)  # two triangles each
    assert (sides[:, 0] == sides[:, 1]).all()
    assert len(np.unique(sides)) == 240 * 6


def _ridged(solid: SubjectSolid) -> StudioScene:
    return light_scene(solid, Transform.identity(), flashes())


@pytest.mark.slow
def test_both_cameras_of_a_pair_see_the_same_paint():
    rig = make_rig("reference:front", 0.25, 3)
    scene = _ridged(sphere(40.0, 1.0))
    left, right = rig.pair("front").left, rig.pair("front").right
    skin = SkinReflectance(specular=0.0)
    luma = {c.name: render_subject(scene, c, skin, seed=5)[..., 1] for c in (left, right)}
    # Points that face both cameras.
    x, y = np.meshgrid(np.linspace(-15, 15, 60), np.linspace(-15, 15, 60))
    points = np.stack([x, y, np.sqrt(40.0**2 - x**2 - y**2)], axis=-1).reshape(-1, 3)
    values = []
    for camera in (left, right):
        uv = camera.project(points)
        values.append(map_coordinates(luma[camera.name], [uv[:, 1], uv[:, 0]], order=1))
    assert np.std(values[0]) / np.mean(values[0]) > 0.05  # there is something to match
    assert np.corrcoef(values)[0, 1] > 0.95


@pytest.mark.slow
def test_mottling_reaches_down_to_the_pixel_at_every_scale():
    for scale in (0.1, 0.4):
        camera = make_rig("reference:front", scale, 3).cameras["front_left"]
        scene = _ridged(sphere(20.0, 1.0))
        luma = render_subject(scene, camera, SkinReflectance(specular=0.0), seed=5)[..., 1]
        column, row = np.round(camera.project(np.array([[0.0, 0.0, 20.0]]))[0]).astype(int)
        half = int(8.0 / (780.0 / camera.matrix[0, 0]))
        patch = luma[row - half : row + half, column - half : column + half]
        fine = np.diff(patch, axis=1)  # neighbouring pixels differ by more than a twentieth of an 8-bit grey
        assert fine.std() / patch.mean() > 0.01


@pytest.mark.slow
def test_contrast_can_be_nearly_nothing(camera):
    scene = _ridged(sphere(40.0, 4.0))
    spreads = []
    for contrast in (0.005, 0.045):
        skin = SkinReflectance(contrast=contrast, colour_contrast=0.0, specular=0.0)
        ratio = render_subject(scene, camera, skin, seed=5) / np.maximum(
            render_subject(scene, camera, _PLAIN, seed=5), 1e-6
        )
        row, column = np.round(camera.project(np.zeros((1, 3)))[0]).astype(int)[::-1]
        spreads.append(np.log(ratio[row - 20 : row + 20, column - 20 : column + 20, 1]).std())
    assert spreads[0] < 0.02
    assert spreads[1] == pytest.approx(9 * spreads[0], rel=0.05)
