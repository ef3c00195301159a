"""Measure a board's corners by fitting a model of four blurred squares. Tests reject false corners."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mammometry.calibration.features.board_map import LENS_TOLERANCE, BoardMap, fit_board_map, monomials
from mammometry.calibration.features.corner_kernels import fit_windows
from mammometry.calibration.features.pixels import FoundPoints
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int64

_GRID = np.linspace(-1.0, 1.0, 7)


@dataclass(frozen=True, slots=True, kw_only=True)
class MarkerArea:
    """Centres of the squares around a corner, excluded because the bright ones contain markers."""

    square_mm: float
    marker_mm: float
    rim_px: float
    """Width of a marker's blurred edge, excluded with it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CornerFits:
    """Results of the fit at each corner. Rows with `ok` False are meaningless."""

    uv: Float64[Array, "n 2"]
    """Corner, distorted pixels."""
    covariance_px2: Float64[Array, "n 2 2"]
    """From the residuals and the normal equations, px²."""
    amplitude: Float64[Array, " n"]
    """a: half the step from dark to bright, linear light. Positive if the bright squares are those before and after the
    corner in both directions."""
    background: Float64[Array, " n"]
    """b: mean of dark and bright, linear light."""
    residual: Float64[Array, " n"]
    """RMS residual, linear light."""
    sigma_px: Float64[Array, " n"]
    """Blur."""
    shift_px: Float64[Array, " n"]
    """Distance of the corner from its expected position."""
    ok: Bool[Array, " n"]
    """Whether the fit converged on enough pixels on all four sides."""


def fit_corners(
    linear: Float32[Array, "h w"],
    expected_uv: Float64[Array, "n 2"],
    board_mm: Float64[Array, "n 2"],
    board_from_uv: Callable[[Float64[Array, "*n 2"]], Float64[Array, "*n 2"]],
    *,
    window_mm: float,
    blank: MarkerArea | None = None,
    sigma_px: float = 0.8,
) -> CornerFits:
    """Measure chess corners to hundredths of a pixel.

    Args:
        linear: the photograph in linear light.
        expected_uv: expected positions of the corners, good to about a third of the window.
        board_mm: positions of the corners on the board.
        board_from_uv: smooth map from distorted pixels to the board, mm; only its shape around each corner matters.
        window_mm: pixels within ± this distance on the board, in both directions, are used.
        blank: pixels to exclude (markers).
        sigma_px: initial blur.
    """
    windows = _cut(expected_uv, board_mm, board_from_uv, _radii(expected_uv, board_from_uv, window_mm))
    jacobian = windows.jacobian(expected_uv - windows.centre)
    mm_per_px = np.linalg.norm(jacobian, axis=2)
    blank_half_mm = np.zeros(len(expected_uv))
    if blank is not None:
        blank_half_mm = blank.marker_mm / 2 + blank.rim_px * mm_per_px.max(axis=1)
    fitted = fit_windows(
        linear,
        windows.centre,
        windows.radius,
        windows.board_from_offset,
        mm_per_px,
        window_mm,
        0.0 if blank is None else blank.square_mm / 2,
        blank_half_mm,
        sigma_px,
    )
    converged, enough = fitted[:, 13] > 0, fitted[:, 14] > 0
    uv = windows.uv(fitted[:, :2] * mm_per_px)
    uv_from_shift = np.linalg.inv(jacobian) * mm_per_px[:, None, :]
    covariance = fitted[:, [9, 10, 10, 11]].reshape(-1, 2, 2)
    return CornerFits(
        uv=uv,
        covariance_px2=uv_from_shift @ covariance @ uv_from_shift.transpose(0, 2, 1),
        amplitude=fitted[:, 6],
        background=fitted[:, 3],
        residual=fitted[:, 12],
        sigma_px=fitted[:, 2],
        shift_px=np.linalg.norm(uv - expected_uv, axis=1),
        ok=enough & converged & np.isfinite(uv).all(axis=1),
    )


def _radii(
    expected_uv: Float64[Array, "n 2"],
    board_from_uv: Callable[[Float64[Array, "*n 2"]], Float64[Array, "*n 2"]],
    window_mm: float,
) -> Int64[Array, " n"]:
    """Half-width in pixels of a square that contains each corner's window."""
    steps = np.eye(2)
    columns = [(board_from_uv(expected_uv + step) - board_from_uv(expected_uv - step)) / 2 for step in steps]
    uv_from_board = np.linalg.inv(np.stack(columns, axis=-1))
    return np.ceil(np.abs(uv_from_board).sum(axis=2).max(axis=1) * window_mm).astype(np.int64) + 2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Windows:
    """Square windows around corners, with the board's coordinates as a cubic of the pixel offset."""

    centre: Int64[Array, "n 2"]
    radius: Int64[Array, " n"]
    expected: Float64[Array, "n 2"]
    board_from_offset: Float64[Array, "n 10 2"]
    """Coefficients on the monomials of offset / radius. Gives mm from the corner."""

    def board(self, offset: Float64[Array, "n 2"]) -> Float64[Array, "n 2"]:
        return np.einsum("nk,nkc->nc", monomials(offset / self.radius[:, None]), self.board_from_offset)

    def jacobian(self, offset: Float64[Array, "n 2"]) -> Float64[Array, "n 2 2"]:
        """Return mm per pixel. Rows are board axes."""
        columns = [(self.board(offset + step) - self.board(offset - step)) / 2 for step in np.eye(2)]
        return np.stack(columns, axis=-1)

    def uv(self, shift_mm: Float64[Array, "n 2"]) -> Float64[Array, "n 2"]:
        """Pixels of the points at `shift_mm` from the corners."""
        offset = self.expected - self.centre
        for _ in range(3):
            error = shift_mm - self.board(offset)
            offset = offset + np.linalg.solve(self.jacobian(offset), error[..., None])[..., 0]
        return offset + self.centre


def _cut(
    expected_uv: Float64[Array, "n 2"],
    board_mm: Float64[Array, "n 2"],
    board_from_uv: Callable[[Float64[Array, "*n 2"]], Float64[Array, "*n 2"]],
    radius: Int64[Array, " n"],
) -> _Windows:
    centre = np.rint(expected_uv).astype(np.int64)
    samples = np.stack(np.meshgrid(_GRID, _GRID), axis=-1).reshape(-1, 2)
    mm = board_from_uv(centre[:, None, :] + samples * radius[:, None, None]) - board_mm[:, None, :]
    coefficients = np.einsum("ks,nsc->nkc", np.linalg.pinv(monomials(samples)), mm)
    return _Windows(centre=centre, radius=radius, expected=expected_uv, board_from_offset=coefficients)


_WINDOW_SQUARES = 0.48
"""Half-width of the fitted window around a corner, in squares: nearly all of the four adjacent squares, without the
neighbouring corners' blurred edges."""
_FIRST_WINDOW = 0.5
"""Half-width of the first, robust pass as a share of the final window."""
_REACH_SQUARES = 1.2
"""Largest distance of predicted corners from the nearest seen point, squares: extrapolation is unreliable."""
_MIN_SQUARE_PX = 9.0
"""Smallest foreshortened square that is measured, px: below it the blurred edges overlap."""
_MIN_CONTRAST = 0.12
"""Smallest amplitude as a share of the mean brightness."""
_MAX_RESIDUAL = 0.25
"""Largest residual as a share of the amplitude."""
_MAX_RESIDUAL_SPREAD = 6.0
"""Largest residual as a multiple of the image's median one."""
_MAX_SHIFT_SQUARES = 0.12
_MAX_SHIFT_PX = 3.0
"""Largest distance of a corner from its expected position, px: the larger of the two applies."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CornerGrid:
    """A board's corners by id, in the board's plane."""

    corners_mm: Float64[Array, "n 2"]
    """Positions, mm."""
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
    blank: MarkerArea | None = None,
) -> FoundPoints | None:
    """Fit corners in two passes: a narrow one for the map, a wide one to measure.

    Args:
        linear: the photograph in linear light.
        board_map: expected positions of the corners.
        seen_mm: points of the board that have been seen.
        grid: all corners.
        blank: pixels to exclude.
    """
    corners_mm, square_mm = grid.corners_mm, grid.square_mm
    ids = _predictable(board_map, seen_mm, corners_mm, square_mm, linear.shape)
    sigma_px, window_mm = 0.8, _WINDOW_SQUARES * square_mm
    for share in (_FIRST_WINDOW, 1.0):
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
    """Ids of corners near seen ones, inside the image, in squares that are large enough."""
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
    """Tests for measured corners: converged near the expected position, right parity, contrast, usual residual."""
    good = fits.ok & (fits.shift_px < np.maximum(_MAX_SHIFT_PX, _MAX_SHIFT_SQUARES * square_px))
    good &= np.where(bright_first, fits.amplitude, -fits.amplitude) > _MIN_CONTRAST * fits.background
    ratio = fits.residual / np.maximum(np.abs(fits.amplitude), 1e-9)
    good &= ratio < _MAX_RESIDUAL
    if good.sum() >= 8:
        middle = float(np.median(ratio[good]))
        good &= ratio < middle * _MAX_RESIDUAL_SPREAD
    return good
