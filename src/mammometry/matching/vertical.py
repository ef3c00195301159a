"""The vertical disparity that an imperfect calibration leaves after rectification, as a smooth field.

With the right calibration it is zero; what remains is the calibration's own alarm (METHOD 3). It varies slowly over the
picture, so that a quadratic polynomial estimated from all pixels at once holds it: d_v(u, v) at the *right* image's
position u and the common row v, so that the right image can be brought onto the left one's rows by resampling.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from mammometry.geometry.arrays import Array, Bool, Float32, Float64, read_only
from mammometry.matching.correlate import warp_rows
from mammometry.matching.pyramid import Level

_NEGLIGIBLE_PX = 0.02
_FEWEST_PIXELS = 400
_LARGEST_SLOPE_RESIDUAL = 3.0  # times the median residual: beyond, a pixel tells nothing


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VerticalField:
    """d_v = v_left − v_right over the right image, a quadratic polynomial."""

    coefficients_px: Float64[Array, " 6"]
    """Of 1, x, y, x², xy, y² with x and y running from −1 to 1 over the image; pixels of level 0."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients_px", read_only(self.coefficients_px))

    @classmethod
    def zero(cls) -> "VerticalField":
        """A perfect calibration."""
        return cls(coefficients_px=np.zeros(6))

    def at(self, u: Float32[Array, "h w"], level: int) -> Float32[Array, "h w"]:
        """d_v at columns u of the right image, on every row; pixels of the level."""
        values = sum(c * term for c, term in zip(self.coefficients_px, _terms(u), strict=True))
        return np.asarray(values / 2**level, dtype=np.float32)

    def aligned(self, right: Level, level: int) -> Level:
        """The right image resampled so that corresponding points lie on one row."""
        if np.abs(self.coefficients_px).sum() < _NEGLIGIBLE_PX:
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
    field: VerticalField,
    left: Float32[Array, "h w"],
    right_coefficients: Float32[Array, "h w"],
    right_mask: Float32[Array, "h w"],
    shift: Float32[Array, "h w"],
    trusted: Bool[Array, "h w"],
    level: int,
) -> VerticalField:
    """Add what is left of the vertical disparity after the right image was aligned with `field`.

    Linear least squares of left ≈ gain·right + vertical slope·δ(x, y) + horizontal slope·ε(x, y) over the trusted
    pixels, δ and ε quadratic: ε keeps errors of the horizontal shift out of the vertical one.
    """
    if np.count_nonzero(trusted) < _FEWEST_PIXELS:
        return field
    value, slope, _ = warp_rows(right_coefficients, right_mask, shift)
    calm = [ndimage.gaussian_filter(image, 1.0, mode="nearest") for image in (left, value, slope)]
    # The warped image changes along a column by the right image's vertical slope and by the change of the shift.
    vertical = np.gradient(calm[1], axis=0) - calm[2] * np.gradient(shift, axis=0)
    columns = np.arange(left.shape[1], dtype=np.float32) + shift
    terms = [np.broadcast_to(term, left.shape)[trusted].astype(np.float64) for term in _terms(columns)]
    design = np.stack(
        [calm[1][trusted], *(vertical[trusted] * term for term in terms), *(calm[2][trusted] * term for term in terms)],
        axis=1,
    )
    target = calm[0][trusted].astype(np.float64)
    solution = np.linalg.lstsq(design, target, rcond=1e-6)[0]
    residual = np.abs(target - design @ solution)
    keep = residual < _LARGEST_SLOPE_RESIDUAL * np.median(residual)
    solution = np.linalg.lstsq(design[keep], target[keep], rcond=1e-6)[0]
    if solution[0] <= 0:
        return field
    return VerticalField(coefficients_px=field.coefficients_px - 2**level * solution[1:7] / solution[0])


def _terms(u: Float32[Array, "h w"]) -> list[Float32[Array, "h w"]]:
    height, width = u.shape
    x = (2 * u + 1) / width - 1
    y = np.broadcast_to(((2 * np.arange(height, dtype=np.float32) + 1) / height - 1)[:, None], u.shape)
    return [np.ones_like(x), x, y, x * x, x * y, y * y]
