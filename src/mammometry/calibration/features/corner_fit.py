"""Fit a picture of four blurred squares around each chess corner.

The model, in linear light, with d_u and d_v the distances in pixels from the two edges that cross in the corner:
``I = (b + b_x x + b_y y) + (a + a_x x + a_y y) · erf(d_u / √2σ) · erf(d_v / √2σ)``.
Free per corner: the six photometric terms, the blur σ and the shift of the corner. Gauss–Newton, in `corner_kernels`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mammometry.calibration.features.corner_kernels import fit_windows
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int64

_GRID = np.linspace(-1.0, 1.0, 7)


@dataclass(frozen=True, slots=True, kw_only=True)
class MarkerArea:
    """Middles of the squares that meet in a corner.

    The bright ones hold markers there, so they are left out.
    """

    square_mm: float
    marker_mm: float
    rim_px: float
    """Width of a marker's blurred rim, left out with it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CornerFits:
    """What the fit found at each corner. Rows of failed fits have `ok` False and carry no meaning."""

    uv: Float64[Array, "n 2"]
    """Corner, distorted pixels."""
    covariance_px2: Float64[Array, "n 2 2"]
    """From the residuals and the normal equations, px²."""
    amplitude: Float64[Array, " n"]
    """a: half the step from dark to bright, linear light. Positive if the square before the corner in both directions
    (and the one after it) is the brighter.
    """
    background: Float64[Array, " n"]
    """b: mean of dark and bright, linear light."""
    residual: Float64[Array, " n"]
    """RMS residual, linear light."""
    sigma_px: Float64[Array, " n"]
    """Blur."""
    shift_px: Float64[Array, " n"]
    """How far the corner lies from where it was expected."""
    ok: Bool[Array, " n"]
    """The fit converged on enough pixels on all four sides."""


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
        expected_uv: where the corners are expected, good to about a third of the window.
        board_mm: the corners on the board.
        board_from_uv: smooth map from distorted pixels to the board, mm; only its shape around each corner matters.
        window_mm: pixels within ± this on the board, in both directions, are used.
        blank: which pixels to leave out (markers).
        sigma_px: blur to start from.
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
    """Half-width in pixels of a square that holds each corner's window."""
    steps = np.eye(2)
    columns = [(board_from_uv(expected_uv + step) - board_from_uv(expected_uv - step)) / 2 for step in steps]
    uv_from_board = np.linalg.inv(np.stack(columns, axis=-1))
    return np.ceil(np.abs(uv_from_board).sum(axis=2).max(axis=1) * window_mm).astype(np.int64) + 2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Windows:
    """Square windows around corners, with the board's coordinates.

    In each, they are a cubic of the pixel offset.
    """

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


def monomials(xy: Float64[Array, "*n 2"]) -> Float64[Array, "*n 10"]:
    """1, x, y, x², xy, y², x³, x²y, xy², y³."""
    x, y = xy[..., 0], xy[..., 1]
    one = np.ones_like(x)
    return np.stack([one, x, y, x * x, x * y, y * y, x * x * x, x * x * y, x * y * y, y * y * y], axis=-1)
