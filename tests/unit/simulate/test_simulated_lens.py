"""The virtual lens and sensor against closed forms: unsharpness, its place, vignetting, photons."""

import math

import numpy as np
import pytest
from scipy.stats import poisson

from mammometry.calibration.detection.detect import detect_in
from mammometry.calibration.features.dots import measure_dots
from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.calibration.targets.kinds.circles import CirclesTarget
from mammometry.calibration.targets.kinds.cylinder import DottedCylinderTarget
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform
from mammometry.simulate.rendering import solid_target
from mammometry.simulate.rendering.develop import develop
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.render import render_subject, subject_coverage
from mammometry.simulate.rendering.sampling import PINHOLE, Aperture, disc_offsets, lens_rays, net_offsets
from mammometry.simulate.rendering.scene import light_scene
from mammometry.simulate.rendering.skin import SkinReflectance
from mammometry.simulate.rendering.solid_target import render_target
from mammometry.simulate.rigs.rig_file import make_rig
from mammometry.simulate.subjects.shapes import sphere

_LIGHT = np.array([[60.0, 40.0, -800.0, 800.0**2]])


def _camera(depth_mm: float = 600.0, tilt: tuple[float, float, float] = (0.25, -0.2, 0.3)) -> Camera:
    turn = Transform.from_rotation_vector(np.array(tilt), np.zeros(3))
    middle = np.array([50.0, 37.5, 0.0])
    pose = Transform(rotation=turn.rotation, translation_mm=np.array([0.0, 0.0, depth_mm]) - turn.rotation @ middle)
    return Camera(
        name="c",
        size_wh=(480, 360),
        matrix=np.array([[1700.0, 0.0, 238.3], [0.0, 1702.0, 181.9], [0.0, 0.0, 1.0]]),
        distortion=np.array([-0.25, 0.3, 1e-3, -2e-3, 0.0]),
        camera_from_world=pose,
    )


@pytest.mark.parametrize("count", [4, 16, 64])
def test_places_on_the_lens_have_the_discs_moments(count):
    places = disc_offsets(count)
    assert places.mean(axis=0) == pytest.approx(0.0, abs=1e-12)
    assert places.T @ places / count == pytest.approx(0.25 * np.eye(2), abs=1e-12)
    if count >= 16:  # they do not go with the places in the pixel
        assert np.abs(net_offsets(count).T @ places / count).max() < 0.02


def test_rays_through_the_lens_meet_in_the_sharp_plane_and_spread_by_the_closed_form():
    camera = _camera()
    aperture = Aperture(diameter_mm=8.0, focus_mm=550.0)
    uv = np.repeat([[100.0, 300.0]], 64, axis=0)
    middle = camera.rays_world(uv).astype(np.float32)
    origins, directions = lens_rays(camera, middle, aperture, disc_offsets(64))
    in_camera = camera.camera_from_world.rotate(directions.astype(float))
    starts = camera.camera_from_world.apply(origins.astype(float))
    assert np.linalg.norm(starts[:, :2], axis=1).max() <= 4.3
    for depth in (550.0, 700.0):
        points = starts + in_camera * (depth / in_camera[:, 2:])
        spread_px = points[:, :2].std(axis=0) / depth * 1700.0
        expected = 8.0 * 1700.0 * abs(1.0 / depth - 1.0 / 550.0) / 4.0  # a disc's deviation is a quarter of its width
        assert spread_px == pytest.approx(expected, abs=2e-3)
        chief = camera.camera_from_world.rotate(middle[:1].astype(float))[0]
        assert points.mean(axis=0) == pytest.approx(chief / chief[2] * depth, abs=1e-3)
    assert lens_rays(camera, middle, PINHOLE, disc_offsets(64))[1] is middle


def _edge_spread_px(image: np.ndarray) -> float:
    """Standard deviation of the blur across an upright edge in the middle rows, px."""
    profile = image[170:190].mean(axis=0)
    slope = np.abs(np.diff(profile))
    column = np.arange(len(slope))
    peak = int(slope.argmax())
    window = slice(peak - 4, peak + 5)
    weight = slope[window] / slope[window].sum()
    mean = (weight * column[window]).sum()
    return float(np.sqrt((weight * (column[window] - mean) ** 2).sum()))


def test_a_boards_edge_is_blurred_by_the_closed_form():
    target = CirclesTarget(grid=(2, 2), pitch_mm=5.0, diameter_mm=1.0)
    camera = Camera(
        name="c",
        size_wh=(480, 360),
        matrix=np.array([[1700.0, 0.0, 240.0], [0.0, 1700.0, 180.0], [0.0, 0.0, 1.0]]),
        distortion=np.zeros(5),
        camera_from_world=Transform(rotation=np.eye(3), translation_mm=np.array([10.0, 5.0, 600.0])),
    )
    for diameter, focus in ((6.0, 560.0), (10.0, 660.0)):
        picture = render_target(
            camera, Transform.identity(), target, _LIGHT, aperture=Aperture(diameter_mm=diameter, focus_mm=focus)
        )
        wide = diameter * 1700.0 * abs(1 / 600.0 - 1 / focus)
        assert _edge_spread_px(picture) == pytest.approx(math.hypot(wide / 4.0, math.sqrt(2 / 12)), rel=0.06)


_CHARUCO = CharucoTarget(squares=(5, 4), square_mm=20.0, marker_mm=15.0, dictionary="DICT_5X5_250")


@pytest.mark.slow
@pytest.mark.parametrize("focus_mm", [math.inf, 520.0, 720.0])
def test_corners_stay_where_they_are_sharp_or_not(focus_mm):
    # Every corner is looked at by our own fit; what it is compared with is the camera model alone.
    aperture = PINHOLE if focus_mm == math.inf else Aperture(diameter_mm=4.0, focus_mm=focus_mm)
    errors = []
    for tilt in ((0.25, -0.2, 0.3), (-0.3, 0.25, -0.2), (0.1, 0.4, 1.2)):
        camera = _camera(tilt=tilt)
        radiance = render_target(camera, Transform.identity(), _CHARUCO, _LIGHT, aperture=aperture)
        picture = develop(radiance, Film(electrons=1e9, read_noise=0.0), name="x", seed=1)
        found = detect_in(picture, _CHARUCO, camera="c", pose="0")
        assert found is not None
        assert len(found.ids) == 12
        errors.append(found.uv - camera.project(_CHARUCO.points_target)[found.ids])
    error = np.concatenate(errors)
    assert np.abs(error.mean(axis=0)).max() < 0.02
    assert np.sqrt((error**2).mean()) < 0.04


@pytest.mark.slow
def test_dots_of_a_cylinder_are_where_the_model_says(monkeypatch):
    target = DottedCylinderTarget(
        dots=(7, 20), radius_mm=100.0 / math.pi, row_pitch_mm=10.0, column_pitch_mm=10.0, dot_mm=5.0
    )
    turn = Transform.from_rotation_vector(np.array([math.pi / 2, 0.0, 0.0]), np.array([0.0, 30.0, 420.0]))
    camera = Camera(
        name="c",
        size_wh=(480, 480),
        matrix=np.array([[1700.0, 0.0, 238.3], [0.0, 1702.0, 241.9], [0.0, 0.0, 1.0]]),
        distortion=np.array([-0.1, 0.0, 0.0, 0.0, 0.0]),
        camera_from_world=turn,
    )
    # Even light: shading across a dot weighs its centroid, which is the detector's concern and not the picture's.
    monkeypatch.setattr(solid_target, "irradiance", lambda points, *rest: np.ones(len(points)))
    places = np.stack([target.column_pitch_mm * (np.arange(140) % 20), target.row_pitch_mm * (np.arange(140) // 20)], 1)
    towards = camera.centre_world - target.points_target
    facing = (towards * target.body.normals_target).sum(axis=1) / np.linalg.norm(towards, axis=1)
    places = places[facing > 0.7]
    for aperture in (PINHOLE, Aperture(diameter_mm=4.0, focus_mm=460.0)):
        radiance = render_target(camera, Transform.identity(), target, _LIGHT, aperture=aperture)

        def to_image(unrolled):
            return camera.project(target.on_surface(unrolled[..., 0], unrolled[..., 1]))

        dots = measure_dots(radiance, to_image, places, shape="square", half_mm=2.5, pitch_mm=(10.0, 10.0))
        assert dots.ok.sum() >= 28
        error = (dots.uv - to_image(places))[dots.ok]
        assert np.abs(error.mean(axis=0)).max() < 0.02
        assert np.sqrt((error**2).mean()) < 0.05


@pytest.mark.slow
def test_unsharpness_leaves_the_silhouette_in_place():
    camera = make_rig("reference:front", 0.1, 3).cameras["front_left"]
    scene = light_scene(sphere(60.0, 2.0), Transform.identity(), np.array([[*camera.centre_world, 700.0**2]]))
    flat = SkinReflectance(contrast=0.0, colour_contrast=0.0, specular=0.0)
    truth = subject_coverage(scene, camera, 16)
    middle = camera.project(np.zeros((1, 3)))[0]
    row, column = np.mgrid[: truth.shape[0], : truth.shape[1]]
    moments = []
    for aperture in (PINHOLE, Aperture(diameter_mm=15.0, focus_mm=700.0)):
        image = render_subject(scene, camera, flat, seed=1, aperture=aperture)[..., 1].astype(float)
        moments.append(
            np.array([(image * (column - middle[0])).sum(), (image * (row - middle[1])).sum()]) / image.sum()
        )
        if aperture is not PINHOLE:
            assert 0 < image[(truth == 0)].max() < image.max()  # light beyond the sharp outline
    assert moments[1] == pytest.approx(moments[0], abs=0.02)


def test_vignetting_is_the_closed_form():
    photograph = develop(
        np.full((120, 160), 0.4, dtype=np.float32),
        Film(blur_px=0.0, vignetting=0.3, electrons=1e12, read_noise=0.0),
        name="x",
        seed=1,
    )
    row, column = np.mgrid[:120, :160]
    expected = 0.4 * (1 - 0.3 * ((row - 59.5) ** 2 + (column - 79.5) ** 2) / (60.0**2 + 80.0**2))
    assert photograph.linear()[..., 0] == pytest.approx(expected, abs=0.004)  # eight bits


@pytest.mark.parametrize("mean", [0.5, 4.0, 25.0])
def test_few_photons_come_by_poissons_law(mean):
    electrons = 100.0
    film = Film(blur_px=0.0, vignetting=0.0, electrons=electrons, read_noise=0.0)
    photograph = develop(np.full((200, 200), mean / electrons, dtype=np.float32), film, name="x", seed=2)
    # One photon is 1 % of full scale: every number of them up to 100 has its own grey.
    counts = np.round(photograph.linear().astype(float) * electrons).astype(int).ravel()
    n = len(counts)
    for number in range(int(mean + 4 * math.sqrt(mean)) + 1):
        share = float(poisson.pmf(number, mean))
        if share > 0.002:
            deviation = math.sqrt(share * (1 - share) / n)
            assert abs((counts == number).mean() - share) < 4.5 * deviation


def test_jpeg_quality_and_words():
    with pytest.raises(ValueError, match="f_number"):
        Film(f_number=0.0)
    camera = _camera()
    assert Film().aperture(camera) is PINHOLE
    wide = Film(f_number=2.0, focus_mm=500.0, sensor_width_mm=24.0).aperture(camera)
    assert wide.diameter_mm == pytest.approx(1700.0 * 24.0 / 480 / 2.0)
    assert wide.focus_mm == 500.0
    middle = camera.camera_from_world.apply(np.zeros((1, 3)))[0, 2]
    assert Film(f_number=2.0).aperture(camera).focus_mm == pytest.approx(middle)
