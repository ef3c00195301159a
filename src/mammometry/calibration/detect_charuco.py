"""ChArUco boards: markers say where the board is, the model fit says where its corners are."""

from __future__ import annotations

import cv2
import numpy as np

from mammometry.calibration.corner_fit import Blank, CornerFits, fit_corners
from mammometry.calibration.detect_board_map import BoardMap, fit_board_map
from mammometry.calibration.detect_pixels import enlarge, grey_bytes, linear_luma, reduced
from mammometry.calibration.found import FoundPoints
from mammometry.calibration.target import CharucoTarget
from mammometry.errors import SessionError
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int64, UInt8
from mammometry.photograph import Photograph

_LENS_TOLERANCE = 0.006
"""How far lens distortion may bend the board away from a homography, in picture widths."""
_FIRST_WINDOW = 0.5
"""Half-width of the first, robust pass as a share of the final window."""
_REACH_SQUARES = 1.2
"""Corners farther than this from every marker seen are not predicted: extrapolation invents."""
_BLUR_MARGIN_PX = 2.5
_MIN_SQUARE_PX = 9.0
_MIN_CONTRAST = 0.12
_MAX_RESIDUAL = 0.25
_MAX_SPREAD = 6.0
_MAX_SHIFT_PX = 3.0


def charuco_board(target: CharucoTarget) -> cv2.aruco.CharucoBoard:
    """OpenCV's board of that target.

    Raises:
        SessionError: no dictionary of that name.
    """
    number = getattr(cv2.aruco, target.dictionary, None) if target.dictionary.startswith("DICT_") else None
    markers = target.squares[0] * target.squares[1] // 2
    dictionary = None if number is None else cv2.aruco.getPredefinedDictionary(number)
    if dictionary is None or len(dictionary.bytesList) < markers:
        raise SessionError(
            "[target] dictionary",
            found=repr(target.dictionary),
            expected=f"an OpenCV dictionary of at least {markers} markers, such as 'DICT_5X5_250'",
            remedy="Write the name of the dictionary that the board was made with",
        )
    board = cv2.aruco.CharucoBoard(target.squares, target.square_mm, target.marker_mm, dictionary)
    board.setLegacyPattern(target.legacy_pattern)
    return board


def detect_charuco(
    photograph: Photograph,
    target: CharucoTarget,
    *,
    search_width_px: int,
    window_squares: float,
) -> FoundPoints | None:
    """Find the chess corners that can be trusted; None where no board is seen.

    Raises:
        SessionError: no dictionary of the target's name.
    """
    small, scale = reduced(grey_bytes(photograph), search_width_px)
    seen = _search(small, charuco_board(target))
    if seen is None:
        return None
    board_mm, uv = seen[0], enlarge(seen[1], scale)
    tolerance_px = _LENS_TOLERANCE * max(photograph.size_wh) + 2.0 * float(scale.max())
    found = fit_board_map(board_mm, uv, tolerance_px=tolerance_px)
    if found is None:
        return None
    board_map, used = found
    return refine_corners(
        linear_luma(photograph),
        board_map,
        board_mm[used],
        target.points_target[:, :2],
        square_mm=target.square_mm,
        bright_first=_bright_before_corners(target),
        window_mm=window_squares * target.square_mm,
        blank=_marker_areas(target),
    )


def refine_corners(
    linear: Float32[Array, "h w"],
    board_map: BoardMap,
    seen_mm: Float64[Array, "m 2"],
    corners_mm: Float64[Array, "n 2"],
    *,
    square_mm: float,
    bright_first: Bool[Array, " n"],
    window_mm: float,
    blank: Blank | None = None,
) -> FoundPoints | None:
    """Two passes of the model fit: a narrow one that corrects the map, a wide one that measures.

    Args:
        linear: the photograph in linear light.
        board_map: where the corners are expected.
        seen_mm: points of the board that have been seen.
        corners_mm: all corners, by id.
        square_mm: side of a square.
        bright_first: by id, whether the square before the corner in both directions is bright.
        window_mm: half-width of the final window.
        blank: pixels to leave out.
    """
    ids = _predictable(board_map, seen_mm, corners_mm, square_mm, linear.shape)
    sigma_px = 0.8
    for share in (_FIRST_WINDOW, 1.0):
        if len(ids) < 4:
            return None
        fits = fit_corners(
            linear,
            board_map.image(corners_mm[ids]),
            corners_mm[ids],
            board_map.board,
            window_mm=window_mm * share,
            blank=blank,
            sigma_px=sigma_px,
        )
        good = _trusted(fits, bright_first[ids])
        if share == 1.0 or good.sum() < 4:
            break
        sigma_px = float(np.median(fits.sigma_px[good]))
        refitted = fit_board_map(corners_mm[ids[good]], fits.uv[good], tolerance_px=_LENS_TOLERANCE * max(linear.shape))
        if refitted is not None:
            board_map = refitted[0]
            ids = _predictable(board_map, corners_mm[ids[good]], corners_mm, square_mm, linear.shape)
    if good.sum() < 4:
        return None
    return FoundPoints(ids=ids[good], uv=fits.uv[good], covariance_px2=fits.covariance_px2[good])


def _search(
    small: UInt8[Array, "h w"], board: cv2.aruco.CharucoBoard
) -> tuple[Float64[Array, "n 2"], Float64[Array, "n 2"]] | None:
    """Points of the board (marker and chess corners), mm, and where they are in the reduced picture."""
    corners, ids, markers, marker_ids = cv2.aruco.CharucoDetector(board).detectBoard(small)
    if marker_ids is None or len(marker_ids) == 0:
        return None
    first_id = {int(number): place for place, number in enumerate(np.ravel(board.getIds()))}
    known = [k for k, number in enumerate(np.ravel(marker_ids)) if int(number) in first_id]
    if not known:
        return None
    object_points = np.asarray(board.getObjPoints(), np.float64)
    board_mm = [object_points[first_id[int(np.ravel(marker_ids)[k])], :, :2] for k in known]
    uv = [np.asarray(markers[k], np.float64).reshape(4, 2) for k in known]
    if ids is not None and len(ids):
        board_mm.append(np.asarray(board.getChessboardCorners(), np.float64)[np.ravel(ids), :2])
        uv.append(np.asarray(corners, np.float64).reshape(-1, 2))
    return np.concatenate(board_mm), np.concatenate(uv)


def _bright_before_corners(target: CharucoTarget) -> Bool[Array, " n"]:
    column, row = np.meshgrid(np.arange(target.squares[0] - 1), np.arange(target.squares[1] - 1))
    starts_bright = target.legacy_pattern and target.squares[1] % 2 == 0
    bright: Bool[Array, " n"] = (column + row).ravel() % 2 == (0 if starts_bright else 1)
    return bright


def _marker_areas(target: CharucoTarget) -> Blank:
    """Leave out the pixels of any square's middle, where the bright ones have their marker."""
    half_square, half_marker = target.square_mm / 2, target.marker_mm / 2

    def blank(
        u_mm: Float32[Array, "n p"], v_mm: Float32[Array, "n p"], mm_per_px: Float64[Array, " n"]
    ) -> Bool[Array, "n p"]:
        reach = (half_marker + _BLUR_MARGIN_PX * mm_per_px).astype(np.float32)[:, None]
        inside: Bool[Array, "n p"] = (np.abs(np.abs(u_mm) - np.float32(half_square)) < reach) & (
            np.abs(np.abs(v_mm) - np.float32(half_square)) < reach
        )
        return inside

    return blank


def _predictable(
    board_map: BoardMap,
    seen_mm: Float64[Array, "m 2"],
    corners_mm: Float64[Array, "n 2"],
    square_mm: float,
    shape_hw: tuple[int, ...],
) -> Int64[Array, " k"]:
    """Ids of the corners near what was seen, inside the frame, in squares large enough to be measured."""
    distance = np.linalg.norm(corners_mm[:, None] - seen_mm[None], axis=2).min(axis=1)
    uv = board_map.image(corners_mm)
    inside = ((uv > 2.0) & (uv < np.array(shape_hw[::-1]) - 3.0)).all(axis=1)
    smallest_px = np.linalg.svd(board_map.jacobian(corners_mm), compute_uv=False)[:, 1] * square_mm
    return np.flatnonzero((distance < _REACH_SQUARES * square_mm) & inside & (smallest_px > _MIN_SQUARE_PX))


def _trusted(fits: CornerFits, bright_first: Bool[Array, " n"]) -> Bool[Array, " n"]:
    """Gates: converged, near the expected place, the right parity, contrast, and a residual like its neighbours'."""
    good = fits.ok & (fits.shift_px < _MAX_SHIFT_PX)
    good &= np.where(bright_first, fits.amplitude, -fits.amplitude) > _MIN_CONTRAST * fits.background
    ratio = fits.residual / np.maximum(np.abs(fits.amplitude), 1e-9)
    good &= ratio < _MAX_RESIDUAL
    if good.sum() >= 8:
        middle = float(np.median(ratio[good]))
        good &= ratio < middle * _MAX_SPREAD
    return good
