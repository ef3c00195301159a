"""Chessboards against exact pictures and real photographs."""

import cv2
import numpy as np
import pytest
from printed import camera, centred, chessboard, photograph_of_board, read, turned

from mammometry.base.photograph import Photograph
from mammometry.calibration.detection.detect import detect_in
from mammometry.calibration.targets.kinds.chessboard import ChessboardTarget

BOARD = ChessboardTarget(squares=(10, 7), square_mm=20.0)
MIDDLE = centred(BOARD.points_target)


def shoot(view, target=BOARD, sigma_px=0.7):
    pattern, shift = chessboard(target), centred(target.points_target).translation_mm
    return photograph_of_board(view, lambda x, y: pattern(x - shift[0], y - shift[1]), sigma_px=sigma_px)


def find(photograph, target=BOARD, **how):
    return detect_in(photograph, target, camera="camera", pose="00", **how)


@pytest.mark.slow
def test_corners_are_where_they_are_projected_in_full_and_reduced_searches():
    view = camera(turn_deg=(25.0, -20.0, 13.0), distortion=(-0.1, 0.05, 0.0, 0.001, 0.0))
    photograph = shoot(view)
    for search_width_px in (1100, 300):
        found = find(photograph, search_width_px=search_width_px)
        assert len(found.ids) == 54
        error = found.uv - view.project(MIDDLE.apply(BOARD.points_target))
        assert np.abs(error.mean(axis=0)).max() < 0.005
        assert np.sqrt(np.square(error).mean()) < 0.02


@pytest.mark.slow
def test_half_a_turn_of_the_camera_keeps_the_ids_of_a_board_that_tells():
    view = camera(turn_deg=(15.0, 10.0, 5.0))
    photograph = shoot(view)
    upright, upside_down = find(photograph), find(turned(photograph, 2))
    back = np.array(view.size_wh) - 1 - upside_down.uv
    assert np.array_equal(upright.ids, upside_down.ids)
    assert np.abs(upright.uv - back).max() < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("squares", [(9, 7), (7, 7)])
def test_a_symmetric_board_is_read_with_x_to_the_right(squares):
    target = ChessboardTarget(squares=squares, square_mm=20.0)
    view = camera(turn_deg=(10.0, 10.0, 175.0))
    found = find(shoot(view, target), target)
    grid = found.uv.reshape(squares[1] - 1, squares[0] - 1, 2)
    assert (grid[:, -1, 0] > grid[:, 0, 0]).all()
    assert (grid[-1, :, 1] > grid[0, :, 1]).all()


@pytest.mark.slow
def test_no_board_is_none():
    assert find(Photograph(name="blank", pixels=np.full((200, 300), 90, np.uint8))) is None
    assert find(shoot(camera()), ChessboardTarget(squares=(11, 7), square_mm=20.0)) is None


@pytest.mark.slow
@pytest.mark.data
def test_real_photographs_calibrate_better_than_with_opencvs_corners(shared_data):
    """OpenCV's own samples, left camera: RMS 0.39 px with `cornerSubPix` corners, fx 535.9 (data/README.md)."""
    target = ChessboardTarget(squares=(10, 7), square_mm=25.0)
    points, pixels, size_wh = [], [], (0, 0)
    for path in sorted((shared_data / "opencv_samples").glob("left[01]*.jpg")):
        photograph = read(path)
        size_wh = photograph.size_wh
        found = find(photograph, target)
        assert len(found.ids) >= 45
        points.append(target.points_target[found.ids].astype(np.float32))
        pixels.append(found.uv.astype(np.float32))
    assert len(points) == 13
    rms_px, matrix, *_ = cv2.calibrateCamera(points, pixels, size_wh, None, None)
    assert rms_px < 0.25
    assert matrix[0, 0] == pytest.approx(535.9, abs=4.0)
