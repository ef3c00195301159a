"""Every kernel against a plain NumPy twin."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import convolve1d

from mammometry.calibration.targets.board import BORDER_MM
from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.calibration.targets.kinds.chessboard import ChessboardTarget
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform
from mammometry.simulate.rendering import kernels, shading
from mammometry.simulate.rendering.develop import develop, srgb_encoded
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.sampling import lens_parameters, net_offsets
from mammometry.simulate.rendering.solid_target import render_target

_BOARD = CharucoTarget(squares=(5, 4), square_mm=25.0, marker_mm=18.0, dictionary="DICT_5X5_250")


@pytest.fixture
def camera() -> Camera:
    pose = Transform.from_rotation_vector(np.array([0.3, -0.2, 0.4]), np.array([-40.0, -50.0, 500.0]))
    return Camera(
        name="c",
        size_wh=(160, 120),
        matrix=np.array([[420.0, 0.0, 78.3], [0.0, 421.0, 60.9], [0.0, 0.0, 1.0]]),
        distortion=np.array([-0.25, 0.3, 1e-3, -2e-3, 0.05]),
        camera_from_world=pose,
    )


@pytest.fixture
def one_light() -> np.ndarray:
    return np.array([[60.0, 40.0, -800.0, 800.0**2]])


def test_rays_are_the_cameras(camera):
    uv = np.random.default_rng(0).uniform([-5, -5], [165, 125], (500, 2))
    directions = np.empty((500, 3), dtype=np.float32)
    kernels.rays(uv, lens_parameters(camera), camera.camera_from_world.rotation.copy(), directions)
    assert directions == pytest.approx(camera.rays_world(uv), abs=1e-7)  # a float32's resolution
    # And they are exact: a point far along each falls back on its pixel.
    points = camera.centre_world + 700.0 * camera.rays_world(uv)
    assert camera.project(points) == pytest.approx(uv, abs=1e-9)


def test_net_has_one_sample_in_each_row_and_column():
    for count in (1, 4, 16, 32):
        offsets = net_offsets(count)
        for axis in range(2):
            assert np.sort(np.floor((offsets[:, axis] + 0.5) * count)) == pytest.approx(np.arange(count))
    with pytest.raises(ValueError, match="power"):
        net_offsets(6)


def _board_twin(camera, target, light, background, fine=12):
    """The board's picture by brute force: OpenCV's own drawing of the board looked up at 12 × 12 places a pixel."""
    pixels_per_mm = 70
    size = [int(side * target.square_mm * pixels_per_mm) for side in target.squares]
    from mammometry.calibration.targets.kinds.charuco import charuco_board

    drawn = charuco_board(target).generateImage(size, marginSize=0)
    width, height = camera.size_wh
    steps = (np.arange(fine) + 0.5) / fine - 0.5
    u, v = np.meshgrid((np.arange(width)[:, None] + steps).ravel(), (np.arange(height)[:, None] + steps).ravel())
    rays = camera.rays_world(np.stack([u, v], axis=-1))
    points = camera.centre_world - camera.centre_world[2] / rays[..., 2:] * rays
    x, y = points[..., 0], points[..., 1]
    w, h = np.array(target.squares) * target.square_mm
    paper = (x >= -BORDER_MM) & (y >= -BORDER_MM) & (x <= w + BORDER_MM) & (y <= h + BORDER_MM)
    inside = (x >= 0) & (y >= 0) & (x < w) & (y < h)
    column = np.clip((x * pixels_per_mm).astype(int), 0, size[0] - 1)
    row = np.clip((y * pixels_per_mm).astype(int), 0, size[1] - 1)
    white = np.where(inside, drawn[row, column] > 127, True)
    towards = light[0, :3] - points
    irradiance = light[0, 3] * -towards[..., 2] / np.linalg.norm(towards, axis=-1) ** 3
    radiance = np.where(paper, irradiance * np.where(white, 0.72, 0.032), background)
    return radiance.reshape(height, fine, width, fine).mean(axis=(1, 3))


@pytest.mark.slow
@pytest.mark.parametrize(("samples", "spread"), [(16, 0.015), (256, 0.0025)])
def test_board_is_opencvs_drawing_seen_through_the_lens(camera, one_light, monkeypatch, samples, spread):
    monkeypatch.setattr("mammometry.simulate.rendering.solid_target._EDGE_SAMPLES", samples)
    image = render_target(camera, Transform.identity(), _BOARD, one_light, background=0.01)
    twin = _board_twin(camera, _BOARD, one_light, 0.01)
    assert twin.max() > 0.5  # it is in view
    difference = image - twin
    # What is left is the sampling of edges: it falls with the number of samples, and its mean is nothing.
    assert abs(difference.mean()) < 1e-4
    assert np.sqrt((difference**2).mean()) < spread


def test_board_from_behind_is_dark(camera, one_light):
    over = Transform.from_rotation_vector(np.array([np.pi, 0.0, 0.0]), np.zeros(3))
    image = render_target(camera, over, _BOARD, one_light, background=0.01)
    assert np.all(image == np.float32(0.01))


def test_chessboard_has_no_markers():
    cells = ChessboardTarget(squares=(4, 3), square_mm=10.0).pattern.cells
    assert cells.shape == (3, 4, 1, 1)
    assert cells[0, 0, 0, 0] == 0
    assert (cells.sum(), cells.max()) == (6, 1)


def _mixed_twin(state):
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        state = ((state ^ (state >> shift)) * factor) % (1 << 64)
    return state ^ (state >> 31)


def _noise_twin(point, seed):
    cell, part = np.floor(point).astype(int), point - np.floor(point)
    fade = part**3 * (part * (part * 6 - 15) + 10)
    total = 0.0
    for corner in np.ndindex(2, 2, 2):
        a, b, c = (int(value) for value in cell + corner)
        hashed = (a * 0x8DA6B343) % (1 << 64) ^ (b * 0xD8163841) % (1 << 64) ^ (c * 0xCB1AB31F) % (1 << 64) ^ seed
        bits = _mixed_twin(hashed)
        gradient = np.array([bits & 0xFFFF, (bits >> 16) & 0xFFFF, (bits >> 32) & 0xFFFF]) - 32767.5
        weight = np.prod(np.where(np.array(corner) == 1, fade, 1 - fade))
        total += weight * (gradient @ (part - corner))
    return total * 3.9 / 32767.5


def test_mottling_is_its_twin():
    weights = np.linspace(0.2, 1.0, shading.OCTAVES)
    seed = 123456789
    rotation = np.array([[0.8, 0.6, 0.0], [-0.48, 0.64, 0.6], [0.36, -0.48, 0.8]])
    for start in np.random.default_rng(1).uniform(-90, 90, (5, 3)):
        point, total, wavelength = start, 0.0, shading.COARSEST_MM
        for k in range(shading.OCTAVES):
            fade = (wavelength / 0.4 - 0.8) / 0.8
            if fade <= 0:
                break
            point = rotation @ point
            octave_seed = _mixed_twin((seed + (k + 1) * 0x9E3779B97F4A7C15) % (1 << 64))
            place = point / wavelength + np.array([0.37 * k, 0.0, 0.0])
            total += weights[k] * min(fade, 1.0) * _noise_twin(place, octave_seed)
            wavelength /= 2
        assert shading.mottling(*start, 0.4, 0, shading.OCTAVES, weights, np.uint64(seed)) == pytest.approx(
            total, abs=1e-9
        )


def test_one_octave_has_unit_spread_and_its_wavelength():
    weights = np.zeros(shading.OCTAVES)
    weights[0] = 1.0
    line = [shading.mottling(x, 3.0, 5.0, 0.1, 0, 1, weights, np.uint64(9)) for x in np.arange(0.0, 20000.0, 4.0)]
    values = np.array(line)
    assert values.std() == pytest.approx(1.0, abs=0.25)
    power = np.abs(np.fft.rfft(values)) ** 2
    frequency = np.fft.rfftfreq(len(values), 4.0)
    assert 1 / shading.COARSEST_MM * 0.3 < (power * frequency).sum() / power.sum() < 2.0 / shading.COARSEST_MM


def test_shading_of_one_face_is_lamberts():
    vertices = np.array([[-50.0, -50.0, 0.0], [50.0, -50.0, 0.0], [0.0, 50.0, 0.0]], dtype=np.float32)
    attributes = np.zeros((3, 9), dtype=np.float32)
    attributes[:, 2] = 1.0  # normal z
    attributes[:, 4] = 0.5  # half of the surroundings
    attributes[:, 8] = [1.0, 0.0, 0.0]  # the light reaches the first corner only
    lights = np.array([[30.0, 0.0, 400.0, 400.0**2]])
    colours = np.array([[0.6, 0.4, 0.3], [0.3, 0.1, 0.1], [0.02, 0.02, 0.02]])
    image = np.zeros((1, 3), dtype=np.float32)
    second, third = np.array([0.25, 0.25], dtype=np.float32), np.array([0.25, 0.25], dtype=np.float32)
    shading.shade(
        2,
        1,
        np.array([0, -1], dtype=np.int32),
        second,
        third,
        np.array([[0, 1, 2]], dtype=np.int32),
        vertices,
        vertices,
        attributes,
        np.zeros(1, dtype=np.uint8),
        np.array([0.0, 0.0, 700.0]),
        2000.0,
        lights,
        colours,
        np.zeros((2, shading.OCTAVES)),
        np.array([0.0, 20.0, 0.0, 0.0]),
        np.zeros(3),
        0.0,
        0.1,
        0.2,
        np.uint64(5),
        0.004,
        image,
    )
    point = 0.5 * vertices[0] + 0.25 * vertices[1] + 0.25 * vertices[2]
    towards = lights[0, :3] - point
    r = np.linalg.norm(towards)
    irradiance = 0.5 * lights[0, 3] * towards[2] / r**3 + 0.1 * 0.5
    assert image[0] == pytest.approx(0.5 * colours[0] * irradiance + 0.004, rel=1e-5)  # half of the pixel is background


def test_sheen_is_strongest_in_the_mirror_direction():
    vertices = np.array([[-50.0, -50.0, 0.0], [50.0, -50.0, 0.0], [0.0, 50.0, 0.0]], dtype=np.float32)
    attributes = np.zeros((3, 9), dtype=np.float32)
    attributes[:, 2] = attributes[:, 8] = 1.0
    values = []
    for x in (-300.0, 0.0, 300.0):
        image = np.zeros((1, 3), dtype=np.float32)
        shading.shade(
            1,
            1,
            np.zeros(1, dtype=np.int32),
            np.full(1, 0.25, dtype=np.float32),
            np.full(1, 0.5, dtype=np.float32),
            np.array([[0, 1, 2]], dtype=np.int32),
            vertices,
            vertices,
            attributes,
            np.zeros(1, dtype=np.uint8),
            np.array([x, 0.0, 700.0]),
            2000.0,
            np.array([[300.0, 0.0, 700.0, 760.0**2]]),
            np.zeros((3, 3)),
            np.zeros((2, shading.OCTAVES)),
            np.array([0.1, 20.0, 0.0, 0.0]),
            np.zeros(3),
            0.0,
            0.0,
            0.0,
            np.uint64(5),
            0.0,
            image,
        )
        values.append(image[0, 0])
    assert values[0] > values[1] > values[2] > 0.0


def test_development_without_noise_is_blur_vignetting_and_srgb():
    radiance = np.random.default_rng(2).uniform(0.0, 1.0, (40, 50, 3)).astype(np.float32)
    film = Film(blur_px=0.7, vignetting=0.2, electrons=1e12, read_noise=0.0)
    taps = np.exp(-0.5 * (np.arange(-3, 4) / 0.7) ** 2)
    taps /= taps.sum()
    blurred = convolve1d(
        convolve1d(radiance.astype(np.float64), taps, axis=0, mode="nearest"), taps, axis=1, mode="nearest"
    )
    row, column = np.mgrid[:40, :50]
    blurred *= (1 - 0.2 * ((row - 19.5) ** 2 + (column - 24.5) ** 2) / (20.0**2 + 25.0**2))[..., None]
    photograph = develop(radiance, film, name="x", seed=1)
    assert np.abs(photograph.pixels - np.round(srgb_encoded(blurred) * 255)).max() <= 1
    grey = develop(radiance[:, :, 0], film, name="x", seed=1)
    assert np.array_equal(grey.pixels[..., 0], photograph.pixels[..., 0])
    assert np.array_equal(grey.pixels[..., 2], photograph.pixels[..., 0])


def test_noise_has_the_photons_and_the_readers_variance():
    film = Film(blur_px=0.0, vignetting=0.0, electrons=2000.0, read_noise=15.0)
    for level in (0.2, 0.6):
        photograph = develop(np.full((200, 200), level, dtype=np.float32), film, name="x", seed=4)
        linear = photograph.linear().astype(np.float64)
        expected = np.sqrt(level * 2000.0 + 15.0**2) / 2000.0
        # 120 000 samples: 0.2 % standard error; the quantisation adds 1 % at most.
        assert linear.std() == pytest.approx(expected, rel=0.03)
        assert linear.mean() == pytest.approx(level, abs=3e-4)
        assert abs(np.corrcoef(linear[..., 0].ravel(), linear[..., 1].ravel())[0, 1]) < 0.02
        assert abs(np.corrcoef(linear[:, :-1, 0].ravel(), linear[:, 1:, 0].ravel())[0, 1]) < 0.02


def test_seed_decides_the_noise():
    radiance = np.full((20, 20), 0.3, dtype=np.float32)
    first, again, other = (develop(radiance, Film(), name="x", seed=seed).pixels for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_srgb_is_the_photographs_inverse():
    assert develop(
        np.full((8, 8), 0.5, np.float32), Film(electrons=1e12, read_noise=0.0, vignetting=0.0), name="x", seed=1
    ).linear() == pytest.approx(0.5, abs=3e-3)


def test_opencv_reads_the_board_and_its_corners_are_unbiased(camera, one_light):
    # An independent estimator: OpenCV's markers and cornerSubPix, on a picture large enough for its window.
    big = Camera(
        name="c",
        size_wh=(640, 480),
        matrix=np.array([[1680.0, 0.0, 315.0], [0.0, 1684.0, 245.0], [0.0, 0.0, 1.0]]),
        distortion=camera.distortion,
        camera_from_world=camera.camera_from_world,
    )
    from mammometry.calibration.targets.kinds.charuco import charuco_board

    image = render_target(big, Transform.identity(), _BOARD, one_light)
    photograph = develop(image, Film(electrons=1e9, read_noise=0.0), name="x", seed=1)
    grey = np.ascontiguousarray(photograph.pixels[..., 0])
    corners, ids, _, _ = cv2.aruco.CharucoDetector(charuco_board(_BOARD)).detectBoard(grey)
    ids, corners = np.ravel(ids), np.asarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    assert len(ids) >= 8
    linear = np.ascontiguousarray(photograph.linear()[..., 0])
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-4)
    refined = cv2.cornerSubPix(linear, corners, (6, 6), (-1, -1), criteria).reshape(-1, 2)
    error = refined - big.project(_BOARD.points_target)[ids]
    # cornerSubPix itself scatters by some hundredths of a pixel; its mean shows a bias of the picture.
    assert np.abs(error.mean(axis=0)).max() < 0.02
    assert np.abs(error).max() < 0.12
