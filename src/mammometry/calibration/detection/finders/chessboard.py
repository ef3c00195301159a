"""Find plain chessboards: OpenCV finds the grid in a reduced image, a model fit measures the corners."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from mammometry.base.photograph import Photograph
from mammometry.calibration.features.board_map import BoardMap, fit_board_map, search_tolerance_px
from mammometry.calibration.features.corners import CornerGrid, refine_corners
from mammometry.calibration.features.pixels import Cause, FoundPoints, enlarge, grey_bytes, linear_luma, reduced
from mammometry.calibration.targets.kinds.chessboard import ChessboardTarget
from mammometry.geometry.arrays import Array, Float32, Float64, Int64, UInt8

_LEAST_BEYOND = 3
"""Fewest squares of each colour beyond a side of the board that show that the board is larger."""
_GOES_ON = 0.4
"""Smallest contrast of such squares, relative to the board's. A plain border has none."""


def find_chessboard(
    target: ChessboardTarget, photograph: Photograph, search_width_px: int
) -> FoundPoints | Cause | None:
    """Find the inner corners of a board that is completely visible.

    None if it is not found, a cause if it is part of a larger one. The first corner is at a dark square. If the pattern
    is unchanged by a half turn, the first corner is the one for which the board's x axis points right in the image.
    """
    columns, rows = target.squares[0] - 1, target.squares[1] - 1
    small, scale = reduced(grey_bytes(photograph), search_width_px)
    grid = _search(small, columns, rows)
    if inverse := grid is None:  # measured without inverting, so that all photographs begin at a dark square
        grid = _search(255 - small, columns, rows)
    if grid is None:
        return None
    uv = enlarge(grid, scale)
    corners_mm = target.points_target[:, :2]
    linear = linear_luma(photograph)
    tolerance_px = search_tolerance_px(photograph.size_wh, scale)
    candidates: list[tuple[bool, float, BoardMap]] = []
    for turned in _orders(uv):
        found = fit_board_map(corners_mm, turned.reshape(-1, 2), tolerance_px=tolerance_px)
        if found is not None:
            rightward = float((turned[:, -1] - turned[:, 0])[:, 0].sum())
            candidates.append((_starts_dark(linear, found[0], target), rightward, found[0]))
    if not candidates:
        return None
    starts_dark, _, board_map = max(candidates, key=lambda candidate: candidate[:2])
    if _goes_on(linear, board_map, target):
        return Cause(
            found=f"a chessboard of more than {target.squares[0]} × {target.squares[1]} squares",
            remedy="Count its squares, not the corners between them, and correct [target] squares",
        )
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    measured = refine_corners(
        linear,
        board_map,
        corners_mm,
        CornerGrid(
            corners_mm=corners_mm,
            square_mm=target.square_mm,
            bright_first=((column + row).ravel() % 2 == 1) == starts_dark,
        ),
    )
    return None if measured is None else replace(measured, inverse=inverse)


def explain_missed_chessboard(target: ChessboardTarget, small: UInt8[Array, "h w"]) -> Cause | None:
    """Report squares in a reduced grey image that does not show the whole board."""
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER
    found, *_ = cv2.findChessboardCornersSBWithMeta(small, (3, 3), flags)
    if not found:
        return None
    columns, rows = target.squares
    return Cause(
        found=f"squares of a chessboard, but not a complete one of {columns} × {rows} squares",
        remedy="If this is so in all photographs, correct [target] squares. Else show the whole board with its border",
    )


def _search(small: UInt8[Array, "h w"], columns: int, rows: int) -> Float64[Array, "r c 2"] | None:
    found, corners = cv2.findChessboardCornersSB(small, (columns, rows), flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not found:
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
        found, corners = cv2.findChessboardCorners(small, (columns, rows), flags=flags)
    return np.asarray(corners, np.float64).reshape(rows, columns, 2) if found else None


def _orders(grid: Float64[Array, "r c 2"]) -> list[Float64[Array, "r c 2"]]:
    """All numberings of the grid whose axes have the board's orientation, seen from its front."""
    across, down = grid[:, -1].mean(axis=0) - grid[:, 0].mean(axis=0), grid[-1].mean(axis=0) - grid[0].mean(axis=0)
    if across[0] * down[1] - across[1] * down[0] < 0:
        grid = grid[:, ::-1]
    orders = [grid, grid[::-1, ::-1]]
    if grid.shape[0] == grid.shape[1]:
        quarter = grid.transpose(1, 0, 2)[::-1]
        orders += [quarter, quarter[::-1, ::-1]]
    return orders


def _goes_on(linear: Float32[Array, "h w"], board_map: BoardMap, target: ChessboardTarget) -> bool:
    """Whether dark and bright squares continue beyond the board, where its border should be."""
    columns, rows = target.squares
    inside = _light_in(linear, board_map, target, *np.meshgrid(np.arange(1, columns - 1), np.arange(1, rows - 1)))
    contrast = float(np.ptp(np.nanpercentile(inside, (20, 80))))
    across, down = np.arange(columns), np.arange(rows)
    for column, row in ((across, -1), (across, rows), (-1, down), (columns, down)):
        beyond = _light_in(linear, board_map, target, *np.broadcast_arrays(column, row))
        even, odd = beyond[::2], beyond[1::2]
        if min(np.isfinite(even).sum(), np.isfinite(odd).sum()) < _LEAST_BEYOND:
            continue
        # Objects behind a narrow border may be dark or bright, but rarely alternate like squares.
        (even_low, even_high), (odd_low, odd_high) = (np.nanpercentile(half, (25, 75)) for half in (even, odd))
        if max(even_low - odd_high, odd_low - even_high) > _GOES_ON * contrast:
            return True
    return False


def _light_in(
    linear: Float32[Array, "h w"],
    board_map: BoardMap,
    target: ChessboardTarget,
    column: Int64[Array, "*n"],
    row: Int64[Array, "*n"],
) -> Float64[Array, "*n"]:
    """Linear light at the centres of squares. NaN outside the image."""
    uv = np.rint(board_map.image((np.stack([column, row], axis=-1) + 0.5) * target.square_mm)).astype(np.int64)
    height, width = linear.shape
    inside = np.all((uv >= 0) & (uv < (width, height)), axis=-1)
    u, v = np.where(inside, uv[..., 0], 0), np.where(inside, uv[..., 1], 0)
    return np.where(inside, linear[v, u].astype(np.float64), np.nan)


def _starts_dark(linear: Float32[Array, "h w"], board_map: BoardMap, target: ChessboardTarget) -> bool:
    """Whether the square before the first corner is dark, judged by the centres of the squares."""
    column, row = np.meshgrid(np.arange(1, target.squares[0] - 1), np.arange(1, target.squares[1] - 1))
    light = _light_in(linear, board_map, target, column, row)
    even = (column + row) % 2 == 0
    return bool(np.nanmean(light[even]) < np.nanmean(light[~even]))
