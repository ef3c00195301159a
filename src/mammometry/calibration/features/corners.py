"""Measure a board's corners by two passes of the model fit. Gates reject false corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mammometry.calibration.features.board_map import LENS_TOLERANCE, BoardMap, fit_board_map
from mammometry.calibration.features.corner_fit import CornerFits, MarkerArea, fit_corners
from mammometry.calibration.features.found_points import FoundPoints
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int64

_FIRST_WINDOW = 0.5
"""Half-width of the first, robust pass as a share of the final window."""
_REACH_SQUARES = 1.2
"""Distance from seen corners beyond which none is predicted, squares: extrapolation invents. Chosen by eye."""
_MIN_SQUARE_PX = 9.0
"""Smallest foreshortened square that is measured, px: below it, the edges' blurs overlap."""
_MIN_CONTRAST = 0.12
"""Least amplitude as a share of the mean brightness."""
_MAX_RESIDUAL = 0.25
"""Largest residual as a share of the amplitude."""
_MAX_RESIDUAL_SPREAD = 6.0
"""Largest residual as a multiple of the median one in the picture."""
_MAX_SHIFT_SQUARES = 0.12
_MAX_SHIFT_PX = 3.0
"""Largest distance of a corner from its expected place, px: the larger of the two counts."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CornerGrid:
    """A board's corners by id, in the board's plane."""

    corners_mm: Float64[Array, "n 2"]
    """Places, mm."""
    square_mm: float
    """Side of a square, mm."""
    bright_first: Bool[Array, " n"]
    """Whether the square before the corner in both directions is bright."""


def refine_corners(
    linear: Float32[Array, "h w"],
    board_map: BoardMap,
    seen_mm: Float64[Array, "m 2"],
    grid: CornerGrid,
    *,
    window_mm: float,
    blank: MarkerArea | None = None,
) -> FoundPoints | None:
    """Fit corners in two passes: narrow for the map, wide to measure.

    Args:
        linear: the photograph in linear light.
        board_map: where the corners are expected.
        seen_mm: points of the board that have been seen.
        grid: all corners.
        window_mm: half-width of the final window.
        blank: pixels to leave out.
    """
    corners_mm, square_mm = grid.corners_mm, grid.square_mm
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
        good = _trusted(fits, grid.bright_first[ids], _square_px(board_map, corners_mm[ids], square_mm))
        if share == 1.0 or good.sum() < 4:
            break
        sigma_px = float(np.median(fits.sigma_px[good]))
        refitted = fit_board_map(corners_mm[ids[good]], fits.uv[good], tolerance_px=LENS_TOLERANCE * max(linear.shape))
        if refitted is not None:
            board_map = refitted[0]
            ids = _predictable(board_map, corners_mm[ids[good]], corners_mm, square_mm, linear.shape)
    if good.sum() < 4:
        return None
    return FoundPoints(ids=ids[good], uv=fits.uv[good], covariance_px2=fits.covariance_px2[good])


def _predictable(
    board_map: BoardMap,
    seen_mm: Float64[Array, "m 2"],
    corners_mm: Float64[Array, "n 2"],
    square_mm: float,
    shape_hw: tuple[int, ...],
) -> Int64[Array, " k"]:
    """Ids of corners that are predictable and measurable.

    They are near what was seen, inside the frame, in squares large enough.
    """
    distance = np.linalg.norm(corners_mm[:, None] - seen_mm[None], axis=2).min(axis=1)
    uv = board_map.image(corners_mm)
    inside = ((uv > 2.0) & (uv < np.array(shape_hw[::-1]) - 3.0)).all(axis=1)
    large = _square_px(board_map, corners_mm, square_mm) > _MIN_SQUARE_PX
    return np.flatnonzero((distance < _REACH_SQUARES * square_mm) & inside & large)


def _square_px(board_map: BoardMap, corners_mm: Float64[Array, "n 2"], square_mm: float) -> Float64[Array, " n"]:
    """Smallest extent of a square at each corner, pixels."""
    smallest: Float64[Array, " n"] = np.linalg.svd(board_map.jacobian(corners_mm), compute_uv=False)[:, 1] * square_mm
    return smallest


def _trusted(fits: CornerFits, bright_first: Bool[Array, " n"], square_px: Float64[Array, " n"]) -> Bool[Array, " n"]:
    """Gates for measured corners.

    They converged, near the expected place, with right parity, contrast, and a residual like their neighbours'.
    """
    good = fits.ok & (fits.shift_px < np.maximum(_MAX_SHIFT_PX, _MAX_SHIFT_SQUARES * square_px))
    good &= np.where(bright_first, fits.amplitude, -fits.amplitude) > _MIN_CONTRAST * fits.background
    ratio = fits.residual / np.maximum(np.abs(fits.amplitude), 1e-9)
    good &= ratio < _MAX_RESIDUAL
    if good.sum() >= 8:
        middle = float(np.median(ratio[good]))
        good &= ratio < middle * _MAX_RESIDUAL_SPREAD
    return good
