"""Vertical disparity that remains after rectification with an imperfect calibration.

With the right calibration it is zero, so it also shows errors of the calibration (paper 2.3). It is d_v(u, v) at the
*right* image's column u and the common row v, so that the right image can be resampled onto the left one's rows. Here
it is one quadratic polynomial, estimated from all pixels at once, since it varies slowly. `FreeVertical` has a free
value at each pixel, as in Eq. 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np
from scipy import ndimage

from mammometry.base.machine.cores import in_bands
from mammometry.base.normal import MAD
from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Shaped
from mammometry.matching.correlation_kernels import (
    LARGEST_GAIN,
    LEAST_DETERMINED,
    LEAST_GAIN,
    UNKNOWN_VARIANCE_PX2,
    calm_at,
    warp_rows,
)
from mammometry.matching.dense.least_squares_step import (
    FLAT_DEVIATION,
    LARGEST_STEP_PX,
    LEAST_MASS,
    Both,
    MatchEstimate,
    Side,
    smoothing_weights,
)
from mammometry.matching.dense.plane_smoothing import smooth
from mammometry.matching.filters import blur, gaussian_taps
from mammometry.matching.pyramid import Level, finer_shift

_HARMLESS_PX = 0.1  # pixels of a level; vertical errors of this size do not change d_h (docs/decisions/0011)
_STEEPEST = 0.25  # change of the shift per pixel; on steeper skin smoothing errors look vertical (docs/decisions/0011)
_FEWEST_PIXELS = 400  # fewest pixels: 30 for each of 13 unknowns
_ENOUGH_PIXELS = 20_000  # number of pixels used: 1,500 for each of 13 unknowns; limits time
_BAND_ROWS = 128  # limits memory
_CALM_PX = 1.0  # Gaussian σ over which images and slopes are averaged first
_LARGEST_SLOPE_RESIDUAL = 3.0  # largest residual of a pixel that is used, in median residuals
_USUAL_PX = 0.5  # prior standard deviation of each coefficient, pixels of a level: the remainder of earlier levels
_SHARED_PX2 = 25  # area with a common error, since neighbours share a matching window
_SMALL_STEP_PX = 0.3  # matches that still move by more are not used


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LevelState:
    """State of a level when the vertical disparity is refined on it."""

    level: int
    """Halvings of the rectified images."""
    sides: Both[Side]
    """The right image aligned by the vertical disparity known so far."""
    matches: Both[MatchEstimate]
    """Matches of the last step."""
    shifts: Both[Float32[Array, "h w"]]
    """Smoothed, pixels of the level."""
    smoothing_px: float
    """Gaussian σ of the plane fits between the steps."""


@runtime_checkable
class Vertical(Protocol):
    """A vertical disparity that matching refines. d_v = v_left − v_right over the right image."""

    refinements: ClassVar[int]
    """Number of a level's last steps that refine it."""

    def matters(self, level: int) -> bool:
        """Whether resampling a level's right image is worthwhile."""

    def at(self, u: Float32[Array, "h w"], level: int) -> Float32[Array, "h w"]:
        """d_v at columns u of the right image, on every row, pixels of the level."""

    def cut(self, window: tuple[slice, slice], level: int) -> Vertical:
        """Vertical disparity of a window of a level."""

    def refined(self, state: LevelState) -> Vertical:
        """Add the remainder found after the right image was aligned."""


def aligned(vertical: Vertical, right: Level, level: int) -> Level:
    """Resample the right image so that corresponding points are on one row."""
    if not vertical.matters(level):
        return right
    height, width = right.image.shape
    columns = np.broadcast_to(np.arange(width, dtype=np.float32), (height, width))
    shift = np.ascontiguousarray(-vertical.at(columns, level).T)
    upright = np.ascontiguousarray(right.image.T)
    coefficients = ndimage.spline_filter1d(upright, order=3, axis=1, mode="mirror", output=np.float32)
    image, _, seen = warp_rows(coefficients, np.ones(upright.shape, dtype=bool), shift)
    image = np.where(seen > 0, image, upright)
    return Level(image=np.ascontiguousarray(image.T), mask=right.mask)


@value(eq=False)
class VerticalField:
    """The vertical disparity v_left − v_right over the right image, as one quadratic polynomial."""

    refinements: ClassVar[int] = 2
    """Number of refining steps; in earlier ones the shifts still move by more than the remaining d_v."""
    size_wh: tuple[int, int]
    """Size of the rectified image at level 0, pixels."""
    origin_uv: tuple[int, int] = (0, 0)
    """First column and row of the part in use, level 0."""
    coefficients_px: Float64[Array, " 6"] = field(default_factory=lambda: np.zeros(6))
    """Coefficients of 1, x, y, x², xy, y², with x and y from −1 to 1 over the image, pixels of level 0."""
    limits_px: tuple[float, float] = (0.0, 0.0)
    """Smallest and largest value supported by matches; the polynomial is clamped to them."""
    typical_px: float = 0.0
    """Median magnitude where matches support it. Its extremes, in the corners, are the least certain."""

    def matters(self, level: int) -> bool:
        """Whether resampling a level's right image improves it more than the estimate's noise degrades it."""
        return self.typical_px > _HARMLESS_PX * 2**level

    def at(self, u: Float32[Array, "h w"], level: int) -> Float32[Array, "h w"]:
        """d_v at columns u of the right image, on every row, pixels of the level."""
        out = np.empty(u.shape, dtype=np.float32)
        for top in range(0, u.shape[0], _BAND_ROWS):  # monomials of the whole image would need six times its memory
            band = u[top : top + _BAND_ROWS]
            rows = np.arange(top, top + len(band), dtype=np.float32)[:, None]
            out[top : top + len(band)] = self._polynomial(self.terms_at(band, rows, level))
        np.clip(out, *self.limits_px, out=out)
        out /= np.float32(2**level)
        return out

    def terms_at(self, u: Shaped[Array, "*n"], v: Shaped[Array, "*m"], level: int) -> list[Shaped[Array, "*n"]]:
        """The six monomials at columns u and rows v of a level's right image."""
        x = 2 * ((u + 0.5) * 2**level + self.origin_uv[0]) / self.size_wh[0] - 1
        y = np.broadcast_to(2 * ((v + 0.5) * 2**level + self.origin_uv[1]) / self.size_wh[1] - 1, u.shape)
        return [np.ones_like(x), x, y, x * x, x * y, y * y]

    def cut(self, window: tuple[slice, slice], level: int) -> VerticalField:
        """The polynomial in the pixels of a part of the image."""
        return replace(self, origin_uv=(window[1].start << level, window[0].start << level))

    def refined(self, state: LevelState) -> VerticalField:
        """Add the remaining vertical disparity, estimated by `refine` from converged left matches."""
        (left, right), found = state.sides, state.matches[0]
        settled = found.plausible & (np.abs(found.step) < _SMALL_STEP_PX)
        return refine(self, left.image, right.coefficients, state.shifts[0], settled, state.level)

    def changed(self, coefficients_px: Float64[Array, " 6"], terms: Sequence[Float64[Array, " n"]]) -> VerticalField:
        """Vertical disparity with other coefficients, supported at points with the given monomials."""
        moved = replace(self, coefficients_px=coefficients_px)
        values = moved._polynomial(terms)
        return replace(
            moved, limits_px=(float(values.min()), float(values.max())), typical_px=float(np.median(np.abs(values)))
        )

    def _polynomial(self, terms: Sequence[Array]) -> Array:
        return np.asarray(sum(float(c) * term for c, term in zip(self.coefficients_px, terms, strict=True)))


def refine(
    before: VerticalField,
    left: Float32[Array, "h w"],
    right_coefficients: Float32[Array, "h w"],
    shift: Float32[Array, "h w"],
    trusted: Bool[Array, "h w"],
    level: int,
) -> VerticalField:
    """Add the remaining vertical disparity, after the right image was aligned with `before`.

    Linear least squares of left ≈ gain·right + vertical slope·δ(x, y) + horizontal slope·ε(x, y) over trusted pixels on
    a grid, δ and ε quadratic: ε separates errors of the horizontal shift from the vertical one. Coefficients have the
    prior 0 ± half a pixel, because a narrow strip of skin does not determine the quadratic outside it.
    """
    height, width = shift.shape
    every = max(1, int(np.sqrt(np.count_nonzero(trusted) / _ENOUGH_PIXELS)))
    taps = gaussian_taps(_CALM_PX)
    reach = len(taps) // 2 + 1  # a window, and one row more for its slope
    rows, columns = (every * index for index in np.nonzero(trusted[::every, ::every]))
    inside = (rows >= reach) & (rows < height - reach) & (columns >= reach) & (columns < width - reach)
    rows, columns = rows[inside], columns[inside]
    along = (shift[rows, columns + 1] - shift[rows, columns - 1]) / 2
    across = (shift[rows + 1, columns] - shift[rows - 1, columns]) / 2
    gentle = np.hypot(along, across) < _STEEPEST
    rows, columns, across = rows[gentle], columns[gentle], across[gentle]
    if len(rows) < _FEWEST_PIXELS:
        return before

    def calm(part: slice) -> Float32[Array, "4 _"]:
        return calm_at((rows[part], columns[part]), left, right_coefficients, shift, taps)

    target, value, slope, upright = np.concatenate(in_bands(calm, len(rows)), axis=1).astype(np.float64)
    # The warped image changes along a column with the right image's vertical slope and the change of the shift.
    vertical = upright - slope * across
    terms = [term.astype(np.float64) for term in before.terms_at(columns + shift[rows, columns], rows, level)]
    design = np.stack([value, *(vertical * term for term in terms), *(slope * term for term in terms)], axis=1)
    solution = np.linalg.lstsq(design, target, rcond=1e-6)[0]
    residual = np.abs(target - design @ solution)
    typical = np.median(residual)
    keep = residual < _LARGEST_SLOPE_RESIDUAL * typical
    alike = max(1.0, _SHARED_PX2 / every**2)  # pixels of the grid
    usual = np.sqrt(alike) * MAD * typical / _USUAL_PX * np.eye(13)[1:]
    solution = np.linalg.lstsq(
        np.concatenate([design[keep], usual]), np.append(target[keep], np.zeros(12)), rcond=None
    )[0]
    if solution[0] <= 0:
        return before
    aligned_by = before.coefficients_px if before.matters(level) else np.zeros(6)
    return before.changed(aligned_by - 2**level * solution[1:7] / solution[0], [term[keep] for term in terms])


@value(eq=False)
class FreeVertical:
    """The vertical disparity v_left − v_right at each pixel of the right image, on the last solved level."""

    refinements: ClassVar[int] = 100
    """All steps of a level: each solves both unknowns."""
    d_v_px: Float32[Array, "h w"]
    """Pixels of the level, on the left image's rows."""
    level: int
    """Halvings of the rectified images."""
    window_sigma_px: float
    """σ of the Gaussian window, pixels of each level."""

    def matters(self, level: int) -> bool:
        """Whether anything has been found yet."""
        return bool(self.d_v_px.any())

    def at(self, u: Float32[Array, "h w"], level: int) -> Float32[Array, "h w"]:
        """d_v at columns u of the right image, on every row, by linear interpolation.

        Pixels of a level that is not coarser than the field's.
        """
        d_v = self.d_v_px
        for finer in range(self.level - 1, level - 1, -1):
            halvings = finer - level
            d_v = finer_shift(d_v, (-(-u.shape[0] // 2**halvings), -(-u.shape[1] // 2**halvings)))
        rows = np.broadcast_to(np.arange(u.shape[0], dtype=np.float32)[:, None], u.shape)
        sampled: Float32[Array, "h w"] = ndimage.map_coordinates(
            d_v, [rows, u], output=np.float32, order=1, mode="nearest"
        )
        return sampled

    def cut(self, window: tuple[slice, slice], level: int) -> FreeVertical:
        """The field within a window of its own level."""
        part = np.ascontiguousarray(self.d_v_px[window])
        return FreeVertical(d_v_px=part, level=level, window_sigma_px=self.window_sigma_px)

    def refined(self, state: LevelState) -> FreeVertical:
        """Add one step of least squares in both unknowns, smoothed."""
        left, right = state.sides
        height, width = right.image.shape
        columns = np.broadcast_to(np.arange(width, dtype=np.float32), (height, width))
        before = self.at(columns, state.level)
        change, variance, determined = vertical_step(right, left, state.shifts[1], self.window_sigma_px)
        determined &= state.matches[1].plausible & (np.abs(change) < LARGEST_STEP_PX)
        moved = before + np.clip(change, -LARGEST_STEP_PX, LARGEST_STEP_PX)
        weights = smoothing_weights(variance, determined, right.mask)
        field = smooth(moved, weights, state.smoothing_px, before)
        return FreeVertical(d_v_px=field, level=state.level, window_sigma_px=self.window_sigma_px)


def nothing_yet(shape_hw: tuple[int, int], level: int, window_sigma_px: float) -> FreeVertical:
    """No vertical disparity, before the first step on the coarsest level."""
    return FreeVertical(d_v_px=np.zeros(shape_hw, dtype=np.float32), level=level, window_sigma_px=window_sigma_px)


def vertical_step(
    here: Side, there: Side, shift: Float32[Array, "h w"], window_sigma_px: float
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"], Bool[Array, "h w"]]:
    """Rows by which each window is lower in the other image.

    Returns v_there − v_here, its variance, and whether the window determines it. Least squares in offset, gain,
    horizontal and vertical shift; `correlate.least_squares` has the first three.
    """
    value, slope_u, seen = warp_rows(there.coefficients, there.mask, shift)
    upright = ndimage.correlate1d(there.image, np.array([-0.5, 0.0, 0.5]), axis=0, output=np.float32, mode="nearest")
    upright = ndimage.spline_filter1d(upright, order=3, axis=1, mode="mirror", output=np.float32)
    slope_v, _, _ = warp_rows(upright, there.mask, shift)
    inside = here.mask & (seen > 0.5)
    seen = seen * here.mask
    taps = gaussian_taps(window_sigma_px)
    mass = blur(seen, taps)
    filled = mass > LEAST_MASS
    scale = np.where(filled, mass, np.float32(1))
    images = (here.image, value, slope_u, slope_v)
    means = [blur(seen * image, taps) / scale for image in images]

    def covariance(a: int, b: int) -> Float32[Array, "h w"]:
        return np.asarray(blur(seen * images[a] * images[b], taps) / scale - means[a] * means[b])

    ll, lr, lx, ly = (covariance(0, k) for k in range(4))
    rr, rx, ry = (covariance(1, k) for k in range(1, 4))
    xx, xy, yy = covariance(2, 2), covariance(2, 3), covariance(3, 3)
    flat = np.float32(FLAT_DEVIATION**2)
    determined = inside & filled & (rr >= flat) & (ll >= flat) & (lr > 0)
    rr = np.where(determined, rr, np.float32(1))
    # The part explained by gain and offset is subtracted first, then that of the horizontal shift.
    left_x, left_y = lx - lr * rx / rr, ly - lr * ry / rr
    steep_x, slant, steep_y = xx - rx * rx / rr, xy - rx * ry / rr, yy - ry * ry / rr
    determined &= (steep_x > LEAST_DETERMINED * xx) & (steep_x > 0)
    steep_x = np.where(determined, steep_x, np.float32(1))
    alone = steep_y - slant * slant / steep_x
    determined &= (alone > LEAST_DETERMINED * yy) & (alone > 0)
    alone = np.where(determined, alone, np.float32(1))
    gained_y = (left_y - left_x * slant / steep_x) / alone
    gained_x = (left_x - gained_y * slant) / steep_x
    gain = (lr - gained_x * rx - gained_y * ry) / rr
    determined &= (gain >= LEAST_GAIN) & (gain <= LARGEST_GAIN)
    gain = np.where(determined, gain, np.float32(1))
    left_over = np.maximum(ll - gain * lr - gained_x * lx - gained_y * ly, np.float32(1e-3) * ll)
    concentration = np.float32(np.sum(taps.astype(np.float64) ** 2) ** 2)  # Σw² of the window, whose Σw is 1
    variance = np.where(determined, left_over * concentration / (scale * gain * gain * alone), UNKNOWN_VARIANCE_PX2)
    return np.where(determined, gained_y / gain, np.float32(0)), variance.astype(np.float32), determined
