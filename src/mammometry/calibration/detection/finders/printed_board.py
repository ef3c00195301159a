"""Measure the corners of a strongly tilted ChArUco board by comparison with its print.

`features.corners` excludes the markers and their blurred edges. On a board seen at a flat angle, nothing of the squares
is left then. Here the print, including the markers, is drawn as it should appear in the photograph, and the drawing is
shifted around each corner until it fits (Lucas and Kanade 1981).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mammometry.calibration.detection.finders.print_kernels import draw_print
from mammometry.calibration.features.board_map import LENS_TOLERANCE, BoardMap, fit_board_map
from mammometry.calibration.features.pixels import FoundPoints
from mammometry.calibration.targets.kinds.charuco import CharucoTarget, printed_cells
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int64

_BLURS_PX = (0.6, 0.9, 1.3, 1.9, 2.7)
_PASSES = ((1.0, (2.0,)), (0.75, _BLURS_PX), (0.5, _BLURS_PX), (0.5, _BLURS_PX))
"""Half-width of the window around a corner, squares, and blurs that are tried, px. The first blur is larger than the
errors of the expected positions. The last windows do not overlap, so that errors are independent."""
_MARGIN_PX = 8  # around the board, for the blur
_FEWEST_CORNERS = 4
_FEWEST_PIXELS = 30
_MIN_CONTRAST = 0.12
"""Smallest step from dark to bright as a share of the mean brightness, as in `features.corners`."""
_MAX_RESIDUAL = 0.25
"""Largest residual as a share of the step."""
_MAX_STD_PX = 0.3
"""Largest standard deviation of a corner along any direction, px. Good ones have 0.05."""
_STD_PX = 0.1
"""Standard deviation added to each corner's own, px, because ink, paper and blur differ from the drawing. Of 22 boards
at 60 to 86 degrees in virtual walks, the corners had errors of 0.05 to 0.2 px and own values of 0.03 to 0.1 px."""
_MAX_SHIFT_PX = 1.0
"""Largest distance from the expected position in the last pass, px. A correct map is good to 0.2."""


def fit_print(
    linear: Float32[Array, "h w"], board_map: BoardMap, target: CharucoTarget, ids: Int64[Array, " n"]
) -> FoundPoints | None:
    """Measure corners of a board. None if fewer than four fit.

    Args:
        linear: the photograph in linear light.
        board_map: expected positions, good to a few pixels.
        target: the board.
        ids: the corners to measure.
    """
    corners_mm = target.points_target[ids, :2]
    for window_squares, blurs_px in _PASSES:
        drawn = _drawn(board_map, target, corners_mm, linear)
        tried = [_fit(drawn, board_map, corners_mm, window_squares * target.square_mm, blur) for blur in blurs_px]
        fits = min(tried, key=lambda fits: float(np.median(fits.residual)))
        if fits.good.sum() < _FEWEST_CORNERS:
            return None
        tolerance_px = LENS_TOLERANCE * max(linear.shape)
        refitted = fit_board_map(corners_mm[fits.good], fits.uv[fits.good], tolerance_px=tolerance_px)
        board_map = board_map if refitted is None else refitted[0]
    good = fits.good & (fits.shift_px < _MAX_SHIFT_PX)
    if good.sum() < _FEWEST_CORNERS:
        return None
    covariance_px2 = fits.covariance_px2[good] + _STD_PX**2 * np.eye(2)
    return FoundPoints(ids=ids[good], uv=fits.uv[good], covariance_px2=covariance_px2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Drawn:
    """The print, not blurred, and the photograph in a box around the corners."""

    low: Int64[Array, " 2"]
    """First pixel of the box."""
    white: Float64[Array, "h w"]
    seen: Float64[Array, "h w"]
    board_mm: Float64[Array, "h w 2"]
    """NaN outside the squares, where the paper may end."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Fits:
    """Fits of the windows around corners."""

    uv: Float64[Array, "n 2"]
    covariance_px2: Float64[Array, "n 2 2"]
    residual: Float64[Array, " n"]
    """RMS, as a share of the step from dark to bright."""
    shift_px: Float64[Array, " n"]
    """Distance from the expected position."""
    good: Bool[Array, " n"]


def _drawn(
    board_map: BoardMap, target: CharucoTarget, corners_mm: Float64[Array, "n 2"], linear: Float32[Array, "h w"]
) -> _Drawn:
    sides_mm = target.square_mm * np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
    around_uv = board_map.image((corners_mm[:, None] + sides_mm).reshape(-1, 2))
    shape_wh = np.array(linear.shape[::-1])
    low = np.clip(np.floor(around_uv.min(axis=0)).astype(np.int64) - _MARGIN_PX, 0, shape_wh)
    high = np.clip(np.ceil(around_uv.max(axis=0)).astype(np.int64) + _MARGIN_PX, low, shape_wh)
    white, board_mm = draw_print(
        low,
        high - low,
        np.linalg.inv(board_map.ideal_from_board),
        board_map.to_ideal,
        board_map.centre_px,
        board_map.scale_px,
        printed_cells(target),
        target.square_mm,
        target.marker_mm,
    )
    size_mm = target.square_mm * np.array(target.squares)
    board_mm[((board_mm < 0) | (board_mm > size_mm)).any(axis=2)] = np.nan
    seen = linear[low[1] : high[1], low[0] : high[0]].astype(np.float64)
    return _Drawn(low=low, white=white, seen=seen, board_mm=board_mm)


def _fit(
    drawn: _Drawn, board_map: BoardMap, corners_mm: Float64[Array, "n 2"], window_mm: float, blur_px: float
) -> _Fits:
    """Fit the brightness and shift of the blurred print in the window around each corner."""
    expected = cv2.GaussianBlur(drawn.white, (0, 0), blur_px)
    rise_v, rise_u = np.gradient(expected)
    count = len(corners_mm)
    uv, covariance = board_map.image(corners_mm), np.full((count, 2, 2), np.inf)
    residual, shift_px, good = np.full(count, np.inf), np.full(count, np.inf), np.zeros(count, dtype=bool)
    reach_px = np.abs(board_map.jacobian(corners_mm)).sum(axis=2) * window_mm + 1
    first = np.maximum(np.floor(uv - reach_px).astype(int) - drawn.low, 0)
    last = np.maximum(np.ceil(uv + reach_px).astype(int) + 1 - drawn.low, 0)
    for k, corner_mm in enumerate(corners_mm):
        box = slice(first[k, 1], last[k, 1]), slice(first[k, 0], last[k, 0])
        inside = (np.abs(drawn.board_mm[box] - corner_mm) < window_mm).all(axis=2)
        pixels = int(inside.sum())
        if pixels < _FEWEST_PIXELS:
            continue
        terms = [part[box][inside] for part in (expected, -rise_u, -rise_v)]
        design, seen = np.stack([np.ones(pixels), *terms], axis=1), drawn.seen[box][inside]
        (dark, step, *moved), _, rank, _ = np.linalg.lstsq(design, seen, rcond=1e-6)
        if rank < design.shape[1] or step <= _MIN_CONTRAST * (dark + step / 2):
            continue
        left = seen - design @ (dark, step, *moved)
        variance = float(left @ left) / (pixels - design.shape[1]) / step**2
        covariance[k] = np.linalg.inv(design.T @ design)[2:, 2:] * variance
        uv[k] += np.array(moved) / step
        residual[k], shift_px[k] = np.sqrt(variance), np.linalg.norm(moved) / step
        good[k] = residual[k] < _MAX_RESIDUAL and np.linalg.eigvalsh(covariance[k])[-1] < _MAX_STD_PX**2
    return _Fits(uv=uv, covariance_px2=covariance, residual=residual, shift_px=shift_px, good=good)
