"""Fit a picture of four blurred squares to the pixels around each chess corner.

The model, in linear light, with d_u and d_v the distances in pixels from the two edges that cross in the corner:
``I = (b + b_x x + b_y y) + (a + a_x x + a_y y) · erf(d_u / √2σ) · erf(d_v / √2σ)``.
Free per corner: the six photometric terms, the blur σ and the shift of the corner. Gauss–Newton, all corners at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import TypeAlias

import numpy as np
from scipy.special import erf

from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int64

_STEPS = 16
_CONVERGED_PX = 3e-4
_CONVERGED_STD = 0.05
"""A step this small, in standard deviations of the corner, says no more than noise does."""
_EDGE_BAND_SIGMAS = 4.0
_FLAT_STRIDE = 3
_GRID = np.linspace(-1.0, 1.0, 7)
_PIXELS_AT_ONCE = 2_000_000
_SIDE_PIXELS = 8
_SIGMA_RANGE_PX = (0.25, 8.0)

Blank: TypeAlias = Callable[[Float32[Array, "n p"], Float32[Array, "n p"], Float64[Array, " n"]], Bool[Array, "n p"]]
"""Which pixels to leave out: from their offsets u, v from each corner on the board, mm, and the mm per pixel there."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CornerFits:
    """What the fit found at each corner; rows of failed fits have `ok` False and carry no meaning."""

    uv: Float64[Array, "n 2"]
    """Corner, distorted pixels."""
    covariance_px2: Float64[Array, "n 2 2"]
    """From the residuals and the normal equations, px²."""
    amplitude: Float64[Array, " n"]
    """a: half the step from dark to bright, linear light; positive where the square before the corner in both
    directions (and the one after it) is the brighter."""
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
    blank: Blank | None = None,
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
    radius_px = _radii(expected_uv, board_from_uv, window_mm)
    order = np.argsort(radius_px)
    parts: list[CornerFits] = []
    start = 0
    while start < len(order):
        stop = start + 1
        while stop < len(order) and (stop + 1 - start) * (2 * radius_px[order[stop]] + 1) ** 2 <= _PIXELS_AT_ONCE:
            stop += 1
        rows = order[start:stop]
        windows = _cut(expected_uv[rows], board_mm[rows], board_from_uv, int(radius_px[rows].max()))
        parts.append(_fit(linear, windows, window_mm, blank, sigma_px))
        start = stop
    back = np.argsort(order)
    return CornerFits(
        **{
            field.name: np.concatenate([getattr(part, field.name) for part in parts])[back]
            for field in fields(CornerFits)
        }
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
    """Square windows of one size around corners, and the board's coordinates in each as a cubic of the pixel offset."""

    centre: Int64[Array, "n 2"]
    radius: int
    expected: Float64[Array, "n 2"]
    board_from_offset: Float64[Array, "n 10 2"]
    """Coefficients on the monomials of offset / radius; gives mm from the corner."""

    def board(self, offset: Float64[Array, "n 2"]) -> Float64[Array, "n 2"]:
        return np.einsum("nk,nkc->nc", monomials(offset / self.radius), self.board_from_offset)

    def jacobian(self, offset: Float64[Array, "n 2"]) -> Float64[Array, "n 2 2"]:
        """Return mm per pixel; rows are board axes."""
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
    radius: int,
) -> _Windows:
    centre = np.rint(expected_uv).astype(np.int64)
    samples = np.stack(np.meshgrid(_GRID, _GRID), axis=-1).reshape(-1, 2)
    mm = board_from_uv(centre[:, None, :] + samples * radius) - board_mm[:, None, :]
    coefficients = np.einsum("ks,nsc->nkc", np.linalg.pinv(monomials(samples)), mm)
    return _Windows(centre=centre, radius=radius, expected=expected_uv, board_from_offset=coefficients)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Pixels:
    """The pixels that are fitted, padded to the same number at every corner (weight 0)."""

    u: Float32[Array, "n k"]
    """Distance from the edge u = 0, pixels."""
    v: Float32[Array, "n k"]
    x: Float32[Array, "n k"]
    """Offset across the picture, in radii."""
    y: Float32[Array, "n k"]
    value: Float32[Array, "n k"]
    weight: Float32[Array, "n k"]
    count: Int64[Array, " n"]

    def take(self, rows: Int64[Array, " m"]) -> _Pixels:
        return _Pixels(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})


def _select(
    linear: Float32[Array, "h w"],
    windows: _Windows,
    mm_per_px: Float64[Array, "n 2"],
    window_mm: float,
    blank: Blank | None,
    sigma_px: float,
) -> tuple[_Pixels, Bool[Array, " n"]]:
    """Choose the pixels near the edges, and every third in each direction of the flat parts."""
    height, width = linear.shape
    radius = windows.radius
    offsets = np.arange(-radius, radius + 1)
    dy, dx = (grid.ravel() for grid in np.meshgrid(offsets, offsets, indexing="ij"))
    basis = monomials(np.stack([dx, dy], axis=1) / radius).astype(np.float32)
    mm = windows.board_from_offset.astype(np.float32)
    u_mm, v_mm = mm[:, :, 0] @ basis.T, mm[:, :, 1] @ basis.T
    band_mm = (_EDGE_BAND_SIGMAS * sigma_px * mm_per_px).astype(np.float32)
    near = (np.abs(u_mm) < band_mm[:, :1]) | (np.abs(v_mm) < band_mm[:, 1:])
    near |= (dx % _FLAT_STRIDE == 0) & (dy % _FLAT_STRIDE == 0)
    near &= (np.abs(u_mm) < window_mm) & (np.abs(v_mm) < window_mm)
    if blank is not None:
        near &= ~blank(u_mm, v_mm, mm_per_px.max(axis=1))
    corner, pixel = np.nonzero(near)
    column, row = windows.centre[corner, 0] + dx[pixel], windows.centre[corner, 1] + dy[pixel]
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    corner, pixel, column, row = corner[inside], pixel[inside], column[inside], row[inside]
    count = np.bincount(corner, minlength=len(windows.centre))
    slot = np.arange(len(corner)) - np.repeat(np.cumsum(count) - count, count)
    shape = (len(count), max(int(count.max(initial=0)), 1))

    def padded(values: Float32[Array, " m"]) -> Float32[Array, "n k"]:
        out = np.zeros(shape, np.float32)
        out[corner, slot] = values
        return out

    u, v = u_mm[corner, pixel], v_mm[corner, pixel]
    sides = np.bincount(corner * 4 + (u > 0) * 2 + (v > 0), minlength=4 * len(count)).reshape(-1, 4)
    pixels = _Pixels(
        u=padded(u / mm_per_px[corner, 0].astype(np.float32)),
        v=padded(v / mm_per_px[corner, 1].astype(np.float32)),
        x=padded((dx[pixel] / radius).astype(np.float32)),
        y=padded((dy[pixel] / radius).astype(np.float32)),
        value=padded(linear[row, column]),
        weight=padded(np.ones(len(corner), np.float32)),
        count=count,
    )
    return pixels, sides.min(axis=1) >= _SIDE_PIXELS


def _fit(
    linear: Float32[Array, "h w"],
    windows: _Windows,
    window_mm: float,
    blank: Blank | None,
    sigma_px: float,
) -> CornerFits:
    jacobian = windows.jacobian(windows.expected - windows.centre)
    mm_per_px = np.linalg.norm(jacobian, axis=2)
    pixels, enough = _select(linear, windows, mm_per_px, window_mm, blank, sigma_px)
    count = len(windows.centre)
    shift, sigma = np.zeros((count, 2)), np.full(count, sigma_px)
    photometric = np.zeros((count, 6))
    covariance, residual = np.zeros((count, 2, 2)), np.zeros(count)
    active = enough.copy()
    for step in range(_STEPS):
        rows = np.flatnonzero(active)
        if not len(rows):
            break
        part = pixels if len(rows) == count else pixels.take(rows)
        first = step == 0
        solution, inverse, sum_squares = _solve(part, shift[rows], sigma[rows], None if first else photometric[rows])
        photometric[rows] = solution[:, :6]
        if first:
            continue
        variance = sum_squares / np.maximum(part.count - 9, 1)
        residual[rows] = np.sqrt(variance)
        covariance[rows] = inverse[:, 6:8, 6:8] * variance[:, None, None]
        move = solution[:, 6:8]
        length = np.linalg.norm(move, axis=1)
        shift[rows] += move * np.minimum(1.0, 1.0 / np.maximum(length, 1e-12))[:, None]
        sigma[rows] = np.clip(sigma[rows] + np.clip(solution[:, 8], -0.3, 0.3), *_SIGMA_RANGE_PX)
        enough_px = np.maximum(
            _CONVERGED_PX, _CONVERGED_STD * np.sqrt(inverse[:, 6, 6] + inverse[:, 7, 7]) * residual[rows]
        )
        active[rows] = ~((length < enough_px) & (np.abs(solution[:, 8]) < 30 * enough_px))
    shift_mm = shift * mm_per_px
    uv_from_shift = np.linalg.inv(jacobian) * mm_per_px[:, None, :]
    uv = windows.uv(np.where(enough[:, None], shift_mm, 0.0))
    return CornerFits(
        uv=uv,
        covariance_px2=uv_from_shift @ covariance @ uv_from_shift.transpose(0, 2, 1),
        amplitude=photometric[:, 3],
        background=photometric[:, 0],
        residual=residual,
        sigma_px=sigma,
        shift_px=np.linalg.norm(uv - windows.expected, axis=1),
        ok=enough & ~active & np.isfinite(uv).all(axis=1),
    )


def _solve(
    pixels: _Pixels,
    shift_px: Float64[Array, "n 2"],
    sigma_px: Float64[Array, " n"],
    photometric: Float64[Array, "n 6"] | None,
) -> tuple[Float64[Array, "n m"], Float64[Array, "n m m"], Float64[Array, " n"]]:
    """One Gauss–Newton step: photometric terms anew, then steps of shift (u, v) and σ; only the former at the start."""
    scale = (1.0 / (np.sqrt(2.0) * sigma_px)).astype(np.float32)[:, None]
    s = (pixels.u - shift_px[:, :1].astype(np.float32)) * scale
    t = (pixels.v - shift_px[:, 1:].astype(np.float32)) * scale
    erf_s, erf_t = erf(s), erf(t)
    product = erf_s * erf_t
    terms = [np.ones_like(s), pixels.x, pixels.y, product, product * pixels.x, product * pixels.y]
    if photometric is not None:
        a, a_x, a_y = (photometric[:, [k]].astype(np.float32) for k in (3, 4, 5))
        slope = (a + a_x * pixels.x + a_y * pixels.y) * np.float32(2.0 / np.sqrt(np.pi))
        along_s = slope * np.exp(-s * s) * erf_t
        along_t = slope * np.exp(-t * t) * erf_s
        terms += [-along_s * scale, -along_t * scale, -(along_s * s + along_t * t) * (np.sqrt(np.float32(2.0)) * scale)]
    design = np.stack(terms, axis=1) * pixels.weight[:, None, :]
    normal = np.matmul(design, design.transpose(0, 2, 1)).astype(np.float64)
    right = np.matmul(design, pixels.value[:, :, None])[:, :, 0].astype(np.float64)
    size = normal.shape[1]
    ridge = 1e-7 * np.einsum("nkk->n", normal)[:, None, None] / size
    inverse = np.linalg.inv(normal + (ridge + 1e-12) * np.eye(size))
    solution = np.einsum("nij,nj->ni", inverse, right)
    model = np.einsum("nk,nkp->np", solution.astype(np.float32), design)
    error = (pixels.value - model) * pixels.weight
    return solution, inverse, np.einsum("np,np->n", error, error).astype(np.float64)


def monomials(xy: Float64[Array, "*n 2"]) -> Float64[Array, "*n 10"]:
    """1, x, y, x², xy, y², x³, x²y, xy², y³."""
    x, y = xy[..., 0], xy[..., 1]
    one = np.ones_like(x)
    return np.stack([one, x, y, x * x, x * y, y * y, x * x * x, x * x * y, x * y * y, y * y * y], axis=-1)
