"""The vertical disparity that an imperfect calibration leaves after rectification, as a smooth field.

With the right calibration it is zero; what remains is the calibration's own alarm (METHOD 3). It varies slowly over the
picture, so that a quadratic polynomial estimated from all pixels at once holds it: d_v(u, v) at the *right* image's
position u and the common row v, so that the right image can be brought onto the left one's rows by resampling.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import ndimage

from mammometry.geometry.arrays import Array, Bool, Float32, Float64, read_only
from mammometry.matching.correlate import warp_rows
from mammometry.matching.pyramid import Level

_HARMLESS_PX = 0.1  # of a level's pixels; measured: a vertical error of that size leaves the disparity as it is
_STEEPEST = 0.25  # change of the shift a pixel: on steeper skin its errors, from smoothing, look like vertical ones
_FEWEST_PIXELS = 400
_ENOUGH_PIXELS = 40_000  # for thirteen unknowns
_LARGEST_SLOPE_RESIDUAL = 3.0  # times the median residual: beyond, a pixel tells nothing


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VerticalField:
    """d_v = v_left − v_right over the right image, a quadratic polynomial held within what was seen."""

    size_wh: tuple[int, int]
    """Of the rectified image at level 0, pixels."""
    origin_uv: tuple[int, int] = (0, 0)
    """First column and row, level 0, of the part that is worked on."""
    coefficients_px: Float64[Array, " 6"] = field(default_factory=lambda: np.zeros(6))
    """Of 1, x, y, x², xy, y² with x and y running from −1 to 1 over the image; pixels of level 0."""
    limits_px: tuple[float, float] = (0.0, 0.0)
    """Smallest and largest value where matches support it; the polynomial is not let beyond."""
    typical_px: float = 0.0
    """Median size where matches support it: its extremes, in the corners, are the least certain."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients_px", read_only(self.coefficients_px))

    def matters(self, level: int) -> bool:
        """Whether a level's right image is better resampled: below, the estimate's own noise would do more harm."""
        return self.typical_px > _HARMLESS_PX * 2**level

    def at(self, u: Float32[Array, "h w"], level: int) -> Float32[Array, "h w"]:
        """d_v at columns u of the right image, on every row; pixels of the level."""
        values = self._polynomial(self.terms(u, level))
        return np.asarray(np.clip(values, *self.limits_px) / 2**level, dtype=np.float32)

    def terms(self, u: Float32[Array, "h w"], level: int) -> list[Float32[Array, "h w"]]:
        """The six monomials at columns u of every row of a level."""
        rows = np.arange(u.shape[0], dtype=np.float32)[:, None]
        x = 2 * ((u + 0.5) * 2**level + self.origin_uv[0]) / self.size_wh[0] - 1
        y = np.broadcast_to(2 * ((rows + 0.5) * 2**level + self.origin_uv[1]) / self.size_wh[1] - 1, u.shape)
        return [np.ones_like(x), x, y, x * x, x * y, y * y]

    def changed(self, coefficients_px: Float64[Array, " 6"], terms: Sequence[Float64[Array, " n"]]) -> "VerticalField":
        """The same with other coefficients, supported at points whose monomials are given."""
        moved = replace(self, coefficients_px=coefficients_px)
        values = moved._polynomial(terms)
        return replace(
            moved,
            limits_px=(float(values.min()), float(values.max())),
            typical_px=float(np.median(np.abs(values))),
        )

    def _polynomial(self, terms: Sequence[Array]) -> Array:
        return np.asarray(sum(float(c) * term for c, term in zip(self.coefficients_px, terms, strict=True)))

    def aligned(self, right: Level, level: int) -> Level:
        """The right image resampled so that corresponding points lie on one row."""
        if not self.matters(level):
            return right
        height, width = right.image.shape
        columns = np.broadcast_to(np.arange(width, dtype=np.float32), (height, width))
        shift = np.ascontiguousarray(-self.at(columns, level).T)
        upright = np.ascontiguousarray(right.image.T)
        coefficients = ndimage.spline_filter1d(upright, order=3, axis=1, mode="mirror", output=np.float32)
        image, _, seen = warp_rows(coefficients, np.ones_like(upright), shift)
        image = np.where(seen > 0, image, upright)
        return Level(image=np.ascontiguousarray(image.T), mask=right.mask)


def refine(
    before: VerticalField,
    left: Float32[Array, "h w"],
    right_coefficients: Float32[Array, "h w"],
    right_mask: Float32[Array, "h w"],
    shift: Float32[Array, "h w"],
    trusted: Bool[Array, "h w"],
    level: int,
) -> VerticalField:
    """Add what is left of the vertical disparity after the right image was aligned with `before`.

    Linear least squares of left ≈ gain·right + vertical slope·δ(x, y) + horizontal slope·ε(x, y) over the trusted
    pixels, δ and ε quadratic: ε keeps errors of the horizontal shift out of the vertical one.
    """
    chosen = np.nonzero(trusted & (np.hypot(*np.gradient(shift)) < _STEEPEST))
    if len(chosen[0]) < _FEWEST_PIXELS:
        return before
    every = max(1, len(chosen[0]) // _ENOUGH_PIXELS)
    chosen = (chosen[0][::every], chosen[1][::every])
    value, slope, _ = warp_rows(right_coefficients, right_mask, shift)
    calm = [ndimage.gaussian_filter(image, 1.0, mode="nearest") for image in (left, value, slope)]
    # The warped image changes along a column by the right image's vertical slope and by the change of the shift.
    vertical = np.gradient(calm[1], axis=0) - calm[2] * np.gradient(shift, axis=0)
    columns = np.arange(left.shape[1], dtype=np.float32) + shift
    terms = [term[chosen].astype(np.float64) for term in before.terms(columns, level)]
    design = np.stack(
        [calm[1][chosen], *(vertical[chosen] * term for term in terms), *(calm[2][chosen] * term for term in terms)],
        axis=1,
    )
    target = calm[0][chosen].astype(np.float64)
    solution = np.linalg.lstsq(design, target, rcond=1e-6)[0]
    residual = np.abs(target - design @ solution)
    keep = residual < _LARGEST_SLOPE_RESIDUAL * np.median(residual)
    solution = np.linalg.lstsq(design[keep], target[keep], rcond=1e-6)[0]
    if solution[0] <= 0:
        return before
    aligned_by = before.coefficients_px if before.matters(level) else np.zeros(6)
    return before.changed(aligned_by - 2**level * solution[1:7] / solution[0], terms)
