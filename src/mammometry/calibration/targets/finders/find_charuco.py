"""Find ChArUco boards by their markers and measure their corners. The model fit measures the corners."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from mammometry.base.photograph import Photograph
from mammometry.calibration.features.board_map import LENS_TOLERANCE, BoardMap, fit_board_map
from mammometry.calibration.features.corner_fit import MarkerArea
from mammometry.calibration.features.corners import CornerGrid, refine_corners
from mammometry.calibration.features.found_points import Cause, FoundPoints
from mammometry.calibration.features.mark_size import mark_size
from mammometry.calibration.features.pixels import enlarge, grey_bytes, linear_luma, reduced
from mammometry.calibration.targets.charuco_board import charuco_board
from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.calibration.targets.marker_layout import FITTING_SHARE, TOLERANCE_SQUARES
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, UInt8

DOUBLED_MARKERS = 4
"""Markers seen twice above which two boards are in view, so that neither can be chosen."""
_BLUR_MARGIN_PX = 2.5
"""Width of a marker's blurred rim, left out with it."""
_NEARLY_ALL = 0.95
"""Share of the markers inside the picture that one threshold must find. Chosen by eye."""
_FEWEST_MARKERS = 8
"""Fewest markers from which it is judged whether all were found. Chosen by eye."""
_RATIO_OFF = 0.05
"""Share by which markers may differ from their stated size: printers and rulers err by 2 % of a marker at most."""


def _one_threshold() -> cv2.aruco.DetectorParameters:
    """Search with the middle one of OpenCV's three windows."""
    parameters = cv2.aruco.DetectorParameters()
    middle = (parameters.adaptiveThreshWinSizeMin + parameters.adaptiveThreshWinSizeMax) // 2
    parameters.adaptiveThreshWinSizeMin = parameters.adaptiveThreshWinSizeMax = middle
    return parameters


_ONE_THRESHOLD = _one_threshold()


def find_charuco(
    photograph: Photograph,
    target: CharucoTarget,
    *,
    search_width_px: int,
    window_squares: float,
) -> FoundPoints | Cause | None:
    """Find the chess corners that can be trusted.

    None where no board is seen, the cause where it is another.

    Raises:
        SessionError: no dictionary of the target's name.
    """
    small, scale = reduced(grey_bytes(photograph), search_width_px)
    seen = _search(small, charuco_board(target))
    if seen is None:
        return None
    board_mm, corners, markers = seen
    uv = enlarge(corners, scale)
    tolerance_px = LENS_TOLERANCE * max(photograph.size_wh) + 2.0 * float(scale.max())
    found = fit_board_map(board_mm, uv, tolerance_px=tolerance_px)
    if found is None:
        return None
    board_map, used = found
    off_mm = np.linalg.norm(board_map.board(uv) - board_mm, axis=1)
    if (off_mm < TOLERANCE_SQUARES * target.square_mm).mean() < FITTING_SHARE:
        return None  # on a board of the other pattern every second row fits
    linear = linear_luma(photograph)
    markers_mm = board_mm[:markers].reshape(-1, 4, 2).mean(axis=1)
    if cause := _about_marker_size(linear, board_map, markers_mm, target):
        return cause
    return refine_corners(
        linear,
        board_map,
        board_mm[used],
        CornerGrid(
            corners_mm=target.points_target[:, :2],
            square_mm=target.square_mm,
            bright_first=_bright_before_corners(target),
        ),
        window_mm=window_squares * target.square_mm,
        blank=MarkerArea(square_mm=target.square_mm, marker_mm=target.marker_mm, rim_px=_BLUR_MARGIN_PX),
    )


def _search(
    small: UInt8[Array, "h w"], board: cv2.aruco.CharucoBoard
) -> tuple[Float64[Array, "n 2"], Float64[Array, "n 2"], int] | None:
    """Points of the board, mm, reduced pixels, and number of marker corners.

    Marker corners come first. One threshold finds nearly all markers of an even picture in half the time; where some
    that should be in the picture are missing, the others are tried as well.
    """
    corners, ids, markers, marker_ids = _detected(small, board, _ONE_THRESHOLD)
    if not _is_complete(markers, marker_ids, board, small.shape):
        corners, ids, markers, marker_ids = _detected(small, board, cv2.aruco.DetectorParameters())
    if marker_ids is None or len(marker_ids) == 0:
        return None
    first_id = {int(number): place for place, number in enumerate(np.ravel(board.getIds()))}
    numbers = np.ravel(marker_ids)
    if len(numbers) - len(np.unique(numbers)) >= DOUBLED_MARKERS:
        return None
    known = [k for k, number in enumerate(numbers) if int(number) in first_id]
    if not known:
        return None
    object_points = np.asarray(board.getObjPoints(), np.float64)
    board_mm = [object_points[first_id[int(numbers[k])], :, :2] for k in known]
    uv = [np.asarray(markers[k], np.float64).reshape(4, 2) for k in known]
    if ids is not None and len(ids):
        board_mm.append(np.asarray(board.getChessboardCorners(), np.float64)[np.ravel(ids), :2])
        uv.append(np.asarray(corners, np.float64).reshape(-1, 2))
    return np.concatenate(board_mm), np.concatenate(uv), 4 * len(known)


def _detected(
    small: UInt8[Array, "h w"], board: cv2.aruco.CharucoBoard, parameters: cv2.aruco.DetectorParameters
) -> Any:
    """Chess corners and their ids, markers and theirs."""
    return cv2.aruco.CharucoDetector(board, detectorParams=parameters).detectBoard(small)


def _is_complete(
    markers: Sequence[Array], marker_ids: Array | None, board: cv2.aruco.CharucoBoard, shape_hw: tuple[int, ...]
) -> bool:
    """Whether nearly all of the board's markers that lie within the picture were found."""
    places = {int(number): place for place, number in enumerate(np.ravel(board.getIds()))}
    numbers = [] if marker_ids is None else [int(number) for number in np.ravel(marker_ids)]
    known = [k for k, number in enumerate(numbers) if number in places]
    if len(known) < _FEWEST_MARKERS:
        return False
    centres_mm = np.asarray(board.getObjPoints(), np.float64).mean(axis=1)[:, :2]
    seen_px = np.array([np.asarray(markers[k], np.float64).reshape(4, 2).mean(axis=0) for k in known])
    picture_from_board, _ = cv2.findHomography(centres_mm[[places[numbers[k]] for k in known]], seen_px, cv2.LMEDS)
    if picture_from_board is None:  # OpenCV says so of points in a line, its types do not
        return False  # type: ignore[unreachable]
    expected = cv2.perspectiveTransform(centres_mm.reshape(-1, 1, 2), picture_from_board).reshape(-1, 2)
    inside = ((expected > 0) & (expected < np.array(shape_hw[::-1]))).all(axis=1)
    return len(known) >= _NEARLY_ALL * int(inside.sum())


def _about_marker_size(
    linear: Float32[Array, "h w"], board_map: BoardMap, markers_mm: Float64[Array, "m 2"], target: CharucoTarget
) -> Cause | None:
    """Report markers whose size does not fit the squares."""
    size = mark_size(linear, board_map.image, markers_mm, shape="square", reach_mm=target.square_mm / 2)
    if size is None or not size.contradicts(target.marker_mm / 2, _RATIO_OFF):
        return None
    return size.cause(("marker_mm", target.marker_mm), ("square_mm", target.square_mm))


def _bright_before_corners(target: CharucoTarget) -> Bool[Array, " n"]:
    column, row = np.meshgrid(np.arange(target.squares[0] - 1), np.arange(target.squares[1] - 1))
    starts_bright = target.legacy_pattern and target.squares[1] % 2 == 0
    bright: Bool[Array, " n"] = (column + row).ravel() % 2 == (0 if starts_bright else 1)
    return bright
