"""Boards at too flat an angle for their markers, found by what the photographs' neighbours show."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from board_walk import BOARD, FOCAL_PX, MIDDLE, SIZE_WH, printed_sheet

from mammometry.base.photograph import Photograph
from mammometry.geometry import Camera, Transform
from mammometry.walk.held_lens import with_held_lens
from mammometry.walk.stations import find_boards, stations_of
from mammometry.walk.tilted_boards import tilted_boards

pytestmark = pytest.mark.slow
ASIDE_DEG = 79.0
AZIMUTHS_DEG = (-40.0, -25.0, -10.0, 5.0, 20.0, 32.0, 44.0, 54.0, 63.0, 72.0, ASIDE_DEG)
PX_PER_MM, MARGIN_MM, FINE = 6, 32.0, 2  # of the printed sheet
CENTRE = np.array([*BOARD.extent_mm.mean(axis=0), 0.0])


def camera(name, azimuth_deg, elevation_deg=-12.0, distance_mm=620.0):
    a, e = np.radians([azimuth_deg, elevation_deg])
    away = np.array([np.sin(a) * np.cos(e), -np.sin(e), -np.cos(a) * np.cos(e)])
    right = np.cross([0.0, 1.0, 0.0], -away)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(-away, right), -away])
    return Camera(
        name=name,
        size_wh=SIZE_WH,
        matrix=np.array([[FOCAL_PX, 0, MIDDLE[0]], [0, FOCAL_PX, MIDDLE[1]], [0, 0, 1]]),
        distortion=np.zeros(5),
        camera_from_world=Transform(rotation=rotation, translation_mm=-rotation @ (CENTRE + distance_mm * away)),
    )


def seen(view, plane, origin, across, down):
    """A printed plane in a photograph. `origin` is its first pixel, `across` and `down` its directions."""
    pose = view.camera_from_world
    sides = np.column_stack([across / PX_PER_MM, down / PX_PER_MM, origin])
    from_plane = view.matrix @ (pose.rotation @ sides + np.outer(pose.translation_mm, [0, 0, 1]))
    fine = np.array([[FINE, 0, (FINE - 1) / 2], [0, FINE, (FINE - 1) / 2], [0, 0, 1]])
    size = (SIZE_WH[0] * FINE, SIZE_WH[1] * FINE)
    return cv2.warpPerspective(plane, fine @ from_plane, size, flags=cv2.INTER_LINEAR, borderValue=-1.0)


def shoot(view):
    """The board before a textured wall that faces the last photographs."""
    turn = np.radians(65.0)
    across, ahead = np.array([np.cos(turn), 0.0, np.sin(turn)]), np.array([-np.sin(turn), 0.0, np.cos(turn)])
    rng = np.random.default_rng(5)
    texture = sum(
        cv2.resize(rng.uniform(0.02, 0.1, (n, n)), (4200, 4200), interpolation=cv2.INTER_CUBIC) for n in (60, 150, 300)
    )
    wall = seen(
        view, texture, CENTRE + 300 * ahead - 350 * across - [0.0, 350.0, 0.0], across, np.array([0.0, 1.0, 0.0])
    )
    paper = np.asarray(printed_sheet(), float)
    board = seen(view, paper, np.array([-MARGIN_MM, -MARGIN_MM, 0.0]) + 0.5 / PX_PER_MM, np.eye(3)[0], np.eye(3)[1])
    image = cv2.GaussianBlur(np.where(board >= 0, board, wall), (0, 0), FINE * 0.6)
    small = image.reshape(SIZE_WH[1], FINE, SIZE_WH[0], FINE).mean(axis=(1, 3))
    encoded = 1.055 * np.clip(small, 0.0031308, 1) ** (1 / 2.4) - 0.055
    pixels = np.repeat(np.rint(255 * encoded).astype(np.uint8)[..., None], 3, axis=2)
    return Photograph(name=view.name, pixels=pixels)


@pytest.fixture(scope="module")
def walk():
    cameras = {
        f"{number:02d}": camera(f"{number:02d}", azimuth) for number, azimuth in enumerate(AZIMUTHS_DEG, start=1)
    }
    photographs = {name: shoot(view) for name, view in cameras.items()}
    observations = find_boards(photographs, BOARD)
    return cameras, photographs, observations


@pytest.mark.requirement("R-PHOTO-5")
def test_a_board_almost_edge_on_is_placed_without_a_pull_at_the_others(walk):
    cameras, photographs, observations = walk
    last = max(cameras)
    assert [miss.pose for miss in observations.missed] == sorted(cameras)[-2:]
    before = stations_of(observations)
    boards, starts = tilted_boards(observations, before, photographs)
    error = boards[last].uv - cameras[last].project(BOARD.points_target)[boards[last].ids]
    assert len(boards[last].ids) > 0.8 * len(BOARD.points_target)
    # OpenCV draws its boards 0.1 px aside here: so are the other photographs' corners.
    assert np.abs(error.mean(axis=0)).max() < 0.2
    assert error.std(axis=0).max() < 0.2
    after = with_held_lens(before, boards, starts)
    assert set(after.held) == set(sorted(cameras)[-2:])
    assert after.calibration is before.calibration
    assert all(after.rig.cameras[name] is camera for name, camera in before.rig.cameras.items())
    assert np.linalg.norm(after.rig.cameras[last].centre_world - cameras[last].centre_world) < 2.0
    names = after.expanded.covariance.names
    known = [names.index(name) for name in before.expanded.covariance.names]
    matrix = after.expanded.covariance.matrix
    assert np.allclose(matrix[np.ix_(known, known)], before.expanded.covariance.matrix)
    added = [index for index, name in enumerate(names) if name.startswith(f"{last}.centre")]
    assert np.all((np.sqrt(np.diag(matrix)[added]) > 0.01) & (np.sqrt(np.diag(matrix)[added]) < 3.0))


@pytest.mark.requirement("R-PHOTO-3")
def test_photographs_placed_with_the_lens_held_follow_the_size_of_the_print(walk):
    """As after a bank card: the board is 1 % larger, and so are all distances from it."""
    _, photographs, observations = walk
    before = stations_of(observations)
    placed = with_held_lens(before, *tilted_boards(observations, before, photographs))
    larger = stations_of(replace(observations, target=BOARD.scaled(1.01)))
    again = with_held_lens(larger, placed.held, placed.rig.cameras)
    assert again.held.keys() == placed.held.keys()
    for name, camera in placed.rig.cameras.items():
        assert np.linalg.norm(again.rig.cameras[name].centre_world - 1.01 * camera.centre_world) < 1e-3
        turn = again.rig.cameras[name].camera_from_world.rotation @ camera.camera_from_world.rotation.T
        assert np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)) < 1e-5


@pytest.mark.requirement("R-PHOTO-5")
def test_a_photograph_of_something_else_stays_without_a_board(walk):
    cameras, photographs, observations = walk
    last = max(cameras)
    other = np.random.default_rng(1).integers(0, 255, photographs[last].pixels.shape, dtype=np.uint8)
    changed = {**photographs, last: replace(photographs[last], pixels=other)}
    assert tilted_boards(observations, stations_of(observations), changed)[0].keys() == {sorted(cameras)[-2]}
