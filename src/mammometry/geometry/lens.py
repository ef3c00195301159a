"""Brown's lens model. No other module repeats its formula.

A lens maps the ideal point (x, y) = (X/Z, Y/Z) to a distorted one. The five coefficients are in OpenCV's order: k1, k2,
k3 are radial, p1 and p2 tangential. All values are dimensionless.

`distorted` and `jacobian` are plain arithmetic on numbers or arrays. Compiled code uses the same two functions
(`lens_kernels`), so rendering, undistortion and calibration share one formula with one order of operations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from mammometry.geometry.arrays import Array, Float64

COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3")
"""Names of the five coefficients, in order."""

Value: TypeAlias = Any
"""A number or an array: `distorted` and `jacobian` only add and multiply."""

NEWTON_STEPS = 20
"""Most Newton steps. Each doubles the number of correct digits. Beyond the fold radius there is no solution."""
_NEWTON_TOLERANCE = 1e-13  # 1e-9 px at a focal length of 10,000 px: rounding, for coordinates of about 1
_NO_TERM = 1e-12  # a smaller coefficient has no effect, and the roots would overflow
_REAL = 1e-9  # relative imaginary part of a real root: rounding of `np.roots`


def distorted(x: Value, y: Value, coefficients: Value) -> tuple[Value, Value]:
    """Distorted x and y of an ideal point."""
    k1, k2, p1, p2, k3 = coefficients[0], coefficients[1], coefficients[2], coefficients[3], coefficients[4]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return (
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    )


def jacobian(x: Value, y: Value, coefficients: Value) -> tuple[Value, Value, Value]:
    """Derivatives xx, xy, yy of the distorted point by the ideal one. The matrix is symmetric."""
    k1, k2, p1, p2, k3 = coefficients[0], coefficients[1], coefficients[2], coefficients[3], coefficients[4]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)  # d radial / d r²
    return (
        radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
        2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y,
        radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Linearised:
    """Distorted points and their derivatives with respect to the coefficients."""

    x: Float64[Array, " n"]
    y: Float64[Array, " n"]
    x_by_coefficient: tuple[Float64[Array, " n"], ...]
    """In the order of `COEFFICIENTS`."""
    y_by_coefficient: tuple[Float64[Array, " n"], ...]


def linearised(x: Float64[Array, " n"], y: Float64[Array, " n"], coefficients: Float64[Array, "5 n"]) -> Linearised:
    """Distort each point with its own lens, and differentiate with respect to the coefficients.

    The model is linear in the coefficients. Points may differ from `distorted` in the last bit, because p1 and p2
    multiply the product xy here. Calibrations depend on that bit, so both orders of operations are kept.
    """
    k1, k2, p1, p2, k3 = coefficients
    xx, yy, xy = x * x, y * y, x * y
    r2 = xx + yy
    r4 = r2 * r2
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    decentred_x, decentred_y, both = r2 + 2.0 * xx, r2 + 2.0 * yy, 2.0 * xy
    return Linearised(
        x=x * radial + p1 * both + p2 * decentred_x,
        y=y * radial + p1 * decentred_y + p2 * both,
        x_by_coefficient=(x * r2, x * r4, both, decentred_x, x * r4 * r2),
        y_by_coefficient=(y * r2, y * r4, decentred_y, both, y * r4 * r2),
    )


def distort(xy: Float64[Array, "*n 2"], coefficients: Float64[Array, 5]) -> Float64[Array, "*n 2"]:
    """Distort ideal points."""
    return np.stack(distorted(xy[..., 0], xy[..., 1], coefficients), axis=-1)


def undistort(xy_distorted: Float64[Array, "*n 2"], coefficients: Float64[Array, 5]) -> Float64[Array, "*n 2"]:
    """Find the ideal points of distorted ones by Newton's method."""
    if not np.any(coefficients):
        return xy_distorted.copy()
    xy = xy_distorted.copy()
    for _ in range(NEWTON_STEPS):
        error = distort(xy, coefficients) - xy_distorted
        by_xx, by_xy, by_yy = jacobian(xy[..., 0], xy[..., 1], coefficients)
        step = np.stack(
            [by_yy * error[..., 0] - by_xy * error[..., 1], by_xx * error[..., 1] - by_xy * error[..., 0]], axis=-1
        )
        step /= (by_xx * by_yy - by_xy * by_xy)[..., None]
        xy -= step
        if np.nanmax(np.abs(step), initial=0.0) < _NEWTON_TOLERANCE:
            break
    return xy


def fold_radius(coefficients: Float64[Array, 5]) -> float:
    """Ideal radius beyond which the distorted radius decreases, so that two directions share a pixel.

    Infinite if there is no such radius. Only the radial terms are used, because the tangential ones are a hundred times
    smaller.
    """
    k1, k2, _, _, k3 = np.where(np.abs(coefficients) > _NO_TERM, coefficients, 0.0)
    roots = np.roots([7 * k3, 5 * k2, 3 * k1, 1.0])  # of d (distorted radius) / d radius, in radius²
    folds = roots.real[(np.abs(roots.imag) < _REAL * np.abs(roots)) & (roots.real > 0)]
    return float(np.sqrt(folds.min())) if len(folds) else np.inf


def fold_xy(coefficients: Float64[Array, 5]) -> float:
    """Distorted radius at the fold (`fold_radius`).

    Pixels farther out show no point. Infinite if there is no fold.
    """
    radius, (k1, k2, _, _, k3) = fold_radius(coefficients), coefficients
    return float(distorted(radius, 0.0, (k1, k2, 0.0, 0.0, k3))[0]) if np.isfinite(radius) else np.inf
