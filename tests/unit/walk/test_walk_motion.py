"""Motion of the body between a walk's photographs, on a ball that pairs see exactly."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from tests.unit.walk.test_pairs import MIDDLE, looking

from mammometry.base.errors import SurfaceError
from mammometry.geometry import Rig, Transform
from mammometry.surface.motion.moved_images import retriangulated
from mammometry.surface.ranges.range_image import RangeImage
from mammometry.walk.lens_freedom import pose_errors
from mammometry.walk.motion import before_still_body, find_motion, summary

RADIUS_MM = 120.0
ANGLES_DEG = (-30, -18, -6, 6, 18, 30)
PAIRS = {f"{i}-{i + 1}": (str(i), str(i + 1)) for i in range(len(ANGLES_DEG) - 1)}
SCALE = 0.12
BOARD_MM = MIDDLE[:2] + np.array([[-120.0, 170.0], [120.0, 290.0]])
"""The board is below the ball (y goes down)."""
ROOM = np.repeat([1e-3, 1.0], 3)  # scale of a pose's turns, rad, and shifts, mm


def ball_seen_by(name, camera):
    """Exact distances to a ball and a smaller one on it, which fixes its turns."""
    rows, columns = np.mgrid[: camera.size_wh[1], : camera.size_wh[0]]
    rays = camera.rays_world(np.stack([columns, rows], axis=-1).astype(float))
    best = np.full(rays.shape[:2], np.inf)
    for centre, radius in (
        (MIDDLE, RADIUS_MM),
        (MIDDLE + np.array([30.0, 40.0, -100.0]), 50.0),
        (MIDDLE + np.array([-40.0, 10.0, -95.0]), 45.0),
    ):
        to = camera.centre_world - centre
        along = rays @ to
        under = along**2 - (to @ to - radius**2)
        distance = np.where(under > 0, -along - np.sqrt(np.maximum(under, 0)), np.inf)
        best = np.minimum(best, distance)
    valid = np.isfinite(best)
    range_mm = np.where(valid, best, 0).astype(np.float32)
    return RangeImage(
        name=name,
        camera=camera,
        range_mm=range_mm,
        sigma_mm=np.where(valid, np.float32(0.05), np.float32(0)),
        confidence=np.where(valid, np.float32(0.99), np.float32(0)),
        valid=valid,
    )


def small(camera):
    """The camera at a small size."""
    matrix = camera.matrix * np.array([[SCALE], [SCALE], [1.0]])
    return replace(camera, matrix=matrix, size_wh=(int(2000 * SCALE), int(1500 * SCALE)))


@pytest.fixture(scope="module")
def walk():
    cameras = {str(i): small(looking(str(i), angle)) for i, angle in enumerate(ANGLES_DEG)}
    true = Rig(name="telephone", cameras=cameras, pair_names=PAIRS)
    return true, [ball_seen_by(name, cameras[left]) for name, (left, _) in PAIRS.items()]


def as_by_the_board(true, images, turn_rad, shift_mm):
    """What is measured where the body moved at each photograph: the board shows the cameras elsewhere."""
    # A camera that stood at T before a body held still is taken to stand where the body's own motion puts it back.
    cameras = {}
    for i, (name, camera) in enumerate(true.cameras.items()):
        found = before_still_body(camera, np.concatenate([turn_rad[i], shift_mm[i]]), MIDDLE)
        back = camera.camera_from_world @ found.camera_from_world.inverse() @ camera.camera_from_world
        cameras[name] = replace(camera, camera_from_world=back)
    board = replace(true, cameras=cameras)
    return board, [retriangulated(image, true.pair(image.name), board.pair(image.name)) for image in images]


def shape_errors(images):
    """Distance of the data from the bodies' surfaces, standard deviation after the best common shift, mm."""
    parts = []
    for image in images:
        points = image.valid_points_world()
        away = np.linalg.norm(points - MIDDLE, axis=1) - RADIUS_MM
        parts.append(np.median(away[np.abs(away) < 3]))
    return float(np.std(parts))


def test_a_still_body_is_left_as_it_is(walk):
    true, images = walk
    found = find_motion(true, images, {}, BOARD_MM)
    assert found.size_mm <= 0.03
    assert not found.moved
    assert "still" in summary(found)
    assert np.abs(found.shift_mm).max() < 0.05
    assert found.rest_mm < 0.05


@pytest.mark.slow
def test_a_still_body_that_pairs_match_with_small_errors_is_left_as_it_is(walk):
    """At flat angles matching errs by some tenths of a millimetre, alike in neighbouring places."""
    true, images = walk
    rng = np.random.default_rng(3)
    waved = []
    for image in images:
        row, column = np.mgrid[: image.valid.shape[0], : image.valid.shape[1]]
        wave = 0.2 * np.sin(row / 15 + rng.uniform(0, 6)) * np.sin(column / 20 + rng.uniform(0, 6))
        range_mm = np.where(image.valid, image.range_mm + wave, 0).astype(np.float32)
        waved.append(replace(image, range_mm=range_mm, sigma_mm=4 * image.sigma_mm))
    found = find_motion(true, waved, {}, BOARD_MM)
    assert found.before_mm > 0.05
    assert found.size_mm <= 0.01
    assert np.abs(found.shift_mm).max() < 0.08


@pytest.mark.slow
def test_a_body_that_swayed_is_put_right(walk):
    true, images = walk
    shift_mm = np.random.default_rng(5).normal(size=(len(ANGLES_DEG), 3)) * 0.3
    board, seen = as_by_the_board(true, images, np.zeros((len(ANGLES_DEG), 3)), shift_mm)
    found = find_motion(board, seen, {}, BOARD_MM)
    assert found.before_mm > 4 * found.rest_mm
    assert found.moved
    assert "corrected" in summary(found)
    corrected = [found.apply_motion(image, board) for image in seen]
    assert shape_errors(corrected) < 0.4 * shape_errors(seen)


@pytest.mark.slow
def test_a_body_that_moved_otherwise_is_refused(walk):
    true, images = walk
    rng = np.random.default_rng(6)
    bent = []
    for image in images:
        wave = rng.normal() * 6 * np.sin(np.mgrid[: image.valid.shape[0], : image.valid.shape[1]][1] / 5)
        bent.append(replace(image, range_mm=np.where(image.valid, image.range_mm + wave, 0).astype(np.float32)))
    with pytest.raises(SurfaceError):
        find_motion(true, bent, {}, BOARD_MM)


@pytest.mark.slow
@pytest.mark.parametrize(("moved_mm", "refused"), [(6.0, False), (16.0, True)])
def test_a_body_that_is_elsewhere_in_half_of_the_photographs_is_refused(walk, moved_mm, refused):
    """The board slipped, or it is another patient: more than the pairs are compared over."""
    true, images = walk
    shift_mm = np.zeros((len(ANGLES_DEG), 3))
    shift_mm[len(ANGLES_DEG) // 2 :, 2] = moved_mm
    board, seen = as_by_the_board(true, images, np.zeros((len(ANGLES_DEG), 3)), shift_mm)
    if not refused:
        assert 4.0 < find_motion(board, seen, {}, BOARD_MM).distance_mm.max() < 8.0
        return
    with pytest.raises(SurfaceError):
        find_motion(board, seen, {}, BOARD_MM)


def posed(camera, change):
    """The camera with another pose: a turn, rad, and a shift of its centre, mm."""
    turned = Transform.from_rotation_vector(change[:3], np.zeros(3)).rotation @ camera.camera_from_world.rotation
    centre = camera.centre_world + change[3:]
    return replace(camera, camera_from_world=Transform(rotation=turned, translation_mm=-turned @ centre))


def pose_on(board, uv, camera):
    """Change of the camera's pose with which the board's points are seen at uv."""
    return (
        least_squares(lambda scaled: (posed(camera, scaled * ROOM).project(board) - uv).ravel(), np.zeros(6)).x * ROOM
    )


def board_points(board_mm):
    x, y = np.linspace(*board_mm, 7).T
    return np.stack([*np.meshgrid(x, y), np.zeros((7, 7))], axis=-1).reshape(-1, 3)


@pytest.mark.parametrize("change", [(0.5, 0.0, 0.0), (0.0, 0.7, 0.0), (0.0, 0.0, -0.6)])
def test_a_lens_that_changed_is_undone_on_the_skin(walk, change):
    """A pose fitted to the board with the wrong lens, then corrected, shows the skin where the photograph shows it."""
    true, images = walk
    camera = next(iter(true.cameras.values()))
    skin = images[0].valid_points_world()[::50]
    matrix = camera.matrix.copy()
    matrix[[0, 1], [0, 1]] *= 1 + change[0] / (camera.size_wh[0] / 2)
    matrix[[0, 1], 2] += change[1:]
    other = replace(camera, matrix=matrix)

    board = board_points(BOARD_MM)
    fitted = pose_on(board, other.project(board), camera)
    corrected = posed(camera, fitted + pose_errors(camera, BOARD_MM, skin) @ np.array(change))
    before, after = (
        np.sqrt(np.mean((seen.project(skin) - other.project(skin)) ** 2)) for seen in (posed(camera, fitted), corrected)
    )
    assert after < 0.2 * before


def test_a_lens_that_changed_is_told_from_a_body_that_moved(walk):
    true, images = walk
    rng = np.random.default_rng(8)
    skin = np.concatenate([image.valid_points_world()[::50] for image in images])
    cameras = {
        name: posed(camera, pose_errors(camera, BOARD_MM, skin) @ rng.normal(0.0, 0.5, 3))
        for name, camera in true.cameras.items()
    }
    board = replace(true, cameras=cameras)
    seen = [retriangulated(image, true.pair(image.name), board.pair(image.name)) for image in images]
    found = find_motion(board, seen, {}, BOARD_MM)
    assert found.lens_px > 0
    assert found.size_mm <= 0.03
    corrected = [found.apply_motion(image, board) for image in seen]
    assert shape_errors(corrected) < 0.4 * shape_errors(seen)
