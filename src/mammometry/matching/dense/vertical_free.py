"""The vertical disparity, free at each pixel (Eq. 1 as printed).

Setting `matching.vertical = "free"`. After each step of the horizontal shifts both unknowns are solved together in the
same Gaussian windows, seen from the right image: right ≈ offset + gain · (left + slope_u · dx + slope_v · dy). Of the
solution dy is kept, smoothed as the horizontal shifts are between their steps, and added. Windows do not tell layers of
depth apart here. On levels that only the left image refines, the field of the level before is interpolated.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from scipy import ndimage

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Bool, Float32
from mammometry.matching.correlation_kernels import warp_rows
from mammometry.matching.dense.consistency_kernels import smoothing_weights
from mammometry.matching.dense.least_squares_step import FLAT_DEVIATION, LEAST_MASS, Side
from mammometry.matching.dense.plane_smoothing import smooth
from mammometry.matching.dense.vertical_disparity import LevelState
from mammometry.matching.filters import blur, gaussian_taps
from mammometry.matching.pyramid import finer_shift

_LARGEST_STEP_PX = 1.0  # as of the horizontal step
_LEAST_DETERMINED = np.float32(1e-3)  # of a slope², left by the other unknowns: as in `correlate.shift_of_sums`
_GAINS = (0.1, 10.0)  # least and largest between the pictures: as there
_UNKNOWN_VARIANCE_PX2 = np.float32(1e4)


@value(eq=False)
class FreeVertical:
    """The vertical disparity at each pixel, on the level last solved.

    d_v = v_left − v_right over the right image.
    """

    refinements: ClassVar[int] = 100
    """All of a level's steps: two unknowns each step."""
    d_v_px: Float32[Array, "h w"]
    """Pixels of the level, on the left image's rows."""
    level: int
    """Halvings of the rectified pictures."""
    window_sigma_px: float
    """Of the Gaussian window, pixels of each level."""

    def matters(self, level: int) -> bool:
        """Whether anything was found yet."""
        return bool(self.d_v_px.any())

    def at(self, u: Float32[Array, "h w"], level: int) -> Float32[Array, "h w"]:
        """d_v at columns u of the right image, on every row.

        Linear; pixels of a level that is not coarser than the field's.
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
        determined &= state.matches[1].plausible & (np.abs(change) < _LARGEST_STEP_PX)
        moved = before + np.clip(change, -_LARGEST_STEP_PX, _LARGEST_STEP_PX)
        weights = smoothing_weights(variance, determined, right.mask)
        field = smooth(moved, weights, state.smoothing_px, before)
        return FreeVertical(d_v_px=field, level=state.level, window_sigma_px=self.window_sigma_px)


def nothing_yet(shape_hw: tuple[int, int], level: int, window_sigma_px: float) -> FreeVertical:
    """No vertical disparity, before the first step on the coarsest level."""
    return FreeVertical(d_v_px=np.zeros(shape_hw, dtype=np.float32), level=level, window_sigma_px=window_sigma_px)


def vertical_step(
    here: Side, there: Side, shift: Float32[Array, "h w"], window_sigma_px: float
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"], Bool[Array, "h w"]]:
    """Rows by which each window lies lower in the other image.

    Returns v_there − v_here, its variance, and whether the window determines it. Least squares in offset, gain,
    horizontal and vertical shift; `correlate.least_squares` has all but the last one.
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
    # What gain and offset explain is taken out first, then what the horizontal shift does.
    left_x, left_y = lx - lr * rx / rr, ly - lr * ry / rr
    steep_x, slant, steep_y = xx - rx * rx / rr, xy - rx * ry / rr, yy - ry * ry / rr
    determined &= (steep_x > _LEAST_DETERMINED * xx) & (steep_x > 0)
    steep_x = np.where(determined, steep_x, np.float32(1))
    alone = steep_y - slant * slant / steep_x
    determined &= (alone > _LEAST_DETERMINED * yy) & (alone > 0)
    alone = np.where(determined, alone, np.float32(1))
    gained_y = (left_y - left_x * slant / steep_x) / alone
    gained_x = (left_x - gained_y * slant) / steep_x
    gain = (lr - gained_x * rx - gained_y * ry) / rr
    determined &= (gain >= _GAINS[0]) & (gain <= _GAINS[1])
    gain = np.where(determined, gain, np.float32(1))
    left_over = np.maximum(ll - gain * lr - gained_x * lx - gained_y * ly, np.float32(1e-3) * ll)
    concentration = np.float32(np.sum(taps.astype(np.float64) ** 2) ** 2)  # Σw² of the window, whose Σw is 1
    variance = np.where(determined, left_over * concentration / (scale * gain * gain * alone), _UNKNOWN_VARIANCE_PX2)
    return np.where(determined, gained_y / gain, np.float32(0)), variance.astype(np.float32), determined
