"""Compiled kernels for corner measurement.

The NumPy versions are in tests/unit/calibration/. They release the GIL, so that photographs are measured in parallel.
"""

import math

import numpy as np

from mammometry.base.machine.compiled import fast_kernel, kernel
from mammometry.geometry.arrays import Array, Float32, Float64, Int64, UInt8

EDGE_BAND_SIGMAS = 4.0
"""Distance to an edge below which all pixels are used. In flat parts one pixel in stride² is used."""
LEAST_STRIDE = 3
"""Smallest stride of the pixels used in flat parts."""
STRIDES = 20
"""Most strides in a window's half-width. Flat parts determine only the brightness and need few pixels."""
STEEPEST = 2.0
"""Largest change of a pixel's distance from an edge between neighbours, px: 1 at the corner. Pixels farther than this
from both edges are skipped."""
STEPS = 16
"""Most Gauss–Newton steps."""
CONVERGED_PX = 3e-4
"""Step that ends the fit: a thirtieth of the smallest standard deviation of a point."""
CONVERGED_STD = 0.05
"""Step that ends the fit, in standard deviations of the corner: smaller steps are within the noise."""
SIDE_PIXELS = 8
"""Fewest pixels on each of the four sides of a corner."""
RESULTS = 16
"""Columns of the kernel's result: shift (u, v), σ, six photometric terms, covariance of the shift (uu, uv, vv),
residual, 1 if converged, 1 if there were enough pixels, and the number of pixels."""

_TERMS = 9  # unknowns of the fit: shift (u, v), σ and six photometric terms
_BLOCK = 128  # pixels per block, so that their terms stay in the L1 cache
_FAINTEST = 2.0  # sixteenth of the exponent beyond which a Gaussian is zero: 1e-14
_MIN_SIGMA_PX, _MAX_SIGMA_PX = 0.25, 8.0  # plausible blur


@kernel
def weighted_levels(
    pixels: UInt8[Array, "h w 3"],
    red: Float32[Array, " 256"],
    green: Float32[Array, " 256"],
    blue: Float32[Array, " 256"],
) -> Float32[Array, "h w"]:
    """Sum of three look-ups, one per channel."""
    height, width, _ = pixels.shape
    out = np.empty((height, width), np.float32)
    for i in range(height):
        for j in range(width):
            out[i, j] = red[pixels[i, j, 0]] + green[pixels[i, j, 1]] + blue[pixels[i, j, 2]]
    return out


@kernel
def fit_windows(
    linear: Float32[Array, "h w"],
    centre: Int64[Array, "n 2"],
    radius: Int64[Array, " n"],
    board_from_offset: Float64[Array, "n 10 2"],
    mm_per_px: Float64[Array, "n 2"],
    window_mm: float,
    blank_centre_mm: float,
    blank_half_mm: Float64[Array, " n"],
    sigma_px: float,
) -> Float64[Array, "n 16"]:
    """Fit the corner model by Gauss–Newton, one corner after another. See `RESULTS` for the result.

    Args:
        linear: the photograph in linear light.
        centre: pixel at the centre of each window: column, row.
        radius: half-width of each window, pixels.
        board_from_offset: coefficients of a cubic of (offset / radius) that gives the offset on the board, mm.
        mm_per_px: mm on the board per pixel, across the edges u = 0 and v = 0.
        window_mm: pixels within ± this distance on the board are used.
        blank_centre_mm: |u| and |v| of the centre of an excluded area (a marker).
        blank_half_mm: its half-width at each corner, mm; 0 for none.
        sigma_px: initial blur.
    """
    count = len(centre)
    out = np.zeros((count, RESULTS))
    largest = 1
    for n in range(count):
        largest = max(largest, 2 * radius[n] + 1)
    pixels = np.empty((5, largest * largest))
    for n in range(count):
        used, enough = _select(
            linear, centre[n], radius[n], board_from_offset[n], mm_per_px[n], window_mm, blank_centre_mm,
            blank_half_mm[n], EDGE_BAND_SIGMAS * sigma_px, pixels,
        )  # fmt: skip
        out[n, 14], out[n, 15] = enough, used
        if enough:
            _fit(pixels, used, sigma_px, out[n])
    return out


@kernel
def _select(  # type: ignore[no-untyped-def]  # compiled: types are those of `fit_windows`
    linear, centre, radius, c, mm_per_px, window_mm, blank_centre_mm, blank_half_mm, band_px, pixels
):
    """Fill `pixels`, and return their number and whether it is enough.

    Rows are u, v in pixels from the edges, x, y in radii, and the value.
    """
    height, width = linear.shape
    stride = max(LEAST_STRIDE, radius // STRIDES)
    per_radius, px_per_u, px_per_v = 1.0 / radius, 1.0 / mm_per_px[0], 1.0 / mm_per_px[1]
    used = 0
    sides = np.zeros(4, np.int64)
    for dy in range(-min(radius, centre[1]), min(radius, height - 1 - centre[1]) + 1):
        y = dy / radius
        # The cubic of `board_map.monomials`, gathered into one of x for this row.
        u0, v0 = (
            c[0, 0] + y * (c[2, 0] + y * (c[5, 0] + y * c[9, 0])),
            c[0, 1] + y * (c[2, 1] + y * (c[5, 1] + y * c[9, 1])),
        )
        u1, v1 = c[1, 0] + y * (c[4, 0] + y * c[8, 0]), c[1, 1] + y * (c[4, 1] + y * c[8, 1])
        u2, v2 = c[3, 0] + y * c[7, 0], c[3, 1] + y * c[7, 1]
        u3, v3 = c[6, 0], c[6, 1]
        dx, last = -min(radius, centre[0]), min(radius, width - 1 - centre[0])
        strided = last + 1  # next column that is used in flat parts
        if dy % stride == 0:
            strided = -(-dx // stride) * stride
        while dx <= last:
            here, x = dx, dx * per_radius
            u_mm = u0 + x * (u1 + x * (u2 + x * u3))
            v_mm = v0 + x * (v1 + x * (v2 + x * v3))
            far_u, far_v = abs(u_mm), abs(v_mm)
            u, v = u_mm * px_per_u, v_mm * px_per_v
            flat_px = min(abs(u), abs(v)) - band_px
            outside_px = max((far_u - window_mm) * px_per_u, (far_v - window_mm) * px_per_v)
            on_stride = here == strided
            if on_stride:
                strided += stride
            dx = min(here + max(1, int(max(flat_px, outside_px) / STEEPEST)), max(strided, here + 1))
            if outside_px >= 0 or (flat_px >= 0 and not on_stride):
                continue
            if abs(far_u - blank_centre_mm) < blank_half_mm and abs(far_v - blank_centre_mm) < blank_half_mm:
                continue
            pixels[0, used], pixels[1, used], pixels[2, used], pixels[3, used] = u, v, x, y
            pixels[4, used] = linear[centre[1] + dy, centre[0] + here]
            sides[(2 if u > 0 else 0) + (1 if v > 0 else 0)] += 1
            used += 1
    return used, min(min(sides[0], sides[1]), min(sides[2], sides[3])) >= SIDE_PIXELS


@kernel
def _fit(pixels, used, sigma_px, out):  # type: ignore[no-untyped-def]
    """Fit the photometric terms first with the shape held, then all nine until the step is small."""
    shift_u, shift_v, sigma = 0.0, 0.0, sigma_px
    solution = np.zeros(_TERMS)
    normal, inverse, right = np.empty((_TERMS, _TERMS)), np.empty((_TERMS, _TERMS)), np.empty(_TERMS)
    terms = np.empty((_TERMS + 1) * _BLOCK)
    for step in range(STEPS):
        squares = _normal_equations(pixels, used, (shift_u, shift_v, sigma), solution, terms, normal, right)
        ridge = 1e-12
        for i in range(_TERMS):
            ridge += 1e-7 * normal[i, i] / _TERMS
        _invert(normal, ridge, inverse)
        remaining = squares
        for i in range(_TERMS):
            solution[i] = 0.0
            for j in range(_TERMS):
                solution[i] += inverse[i, j] * right[j]
        if step == 0:
            continue
        for i in range(_TERMS):
            remaining -= 2.0 * solution[i] * right[i]
            for j in range(_TERMS):
                remaining += solution[i] * normal[i, j] * solution[j]
        variance = max(remaining, 0.0) / max(used - _TERMS, 1)
        length = math.hypot(solution[6], solution[7])
        share = min(1.0, 1.0 / max(length, 1e-12))
        shift_u += solution[6] * share
        shift_v += solution[7] * share
        sigma = min(max(sigma + min(max(solution[8], -0.3), 0.3), _MIN_SIGMA_PX), _MAX_SIGMA_PX)
        out[0], out[1], out[2] = shift_u, shift_v, sigma
        for i in range(6):
            out[3 + i] = solution[i]
        out[9], out[10], out[11] = inverse[6, 6] * variance, inverse[6, 7] * variance, inverse[7, 7] * variance
        out[12] = math.sqrt(variance)
        enough_px = max(CONVERGED_PX, CONVERGED_STD * math.sqrt((inverse[6, 6] + inverse[7, 7]) * variance))
        if length < enough_px and abs(solution[8]) < 30.0 * enough_px:
            out[13] = 1.0
            break


@kernel
def _invert(matrix, ridge, inverse):  # type: ignore[no-untyped-def]
    """Inverse of a positive definite matrix plus `ridge` on its diagonal, by pivoting."""
    for i in range(_TERMS):
        for j in range(_TERMS):
            inverse[i, j] = matrix[i, j]
        inverse[i, i] += ridge
    for k in range(_TERMS):
        pivot = 1.0 / inverse[k, k]
        inverse[k, k] = 1.0
        for j in range(_TERMS):
            inverse[k, j] *= pivot
        for i in range(_TERMS):
            if i != k:
                factor = inverse[i, k]
                inverse[i, k] = 0.0
                for j in range(_TERMS):
                    inverse[i, j] -= factor * inverse[k, j]


@fast_kernel
def _fill_terms(pixels, first, count, shape, last, terms):  # type: ignore[no-untyped-def]
    """Derivatives of the model by its nine terms at some pixels. The last row contains the pixels' values.

    Written without calls and with fixed strides, so that the compiler vectorises it. exp(−z) is the sixteenth power of
    1 / e^(z / 16) by its series, accurate to 1e-8. The error function follows from it (Abramowitz and Stegun 7.1.26,
    accurate to 1.5e-7).
    """
    shift_u, shift_v, sigma = shape
    a, a_x, a_y = last[3], last[4], last[5]
    scale = 1.0 / (math.sqrt(2.0) * sigma)
    slope = 2.0 / math.sqrt(math.pi)
    widening = math.sqrt(2.0) * scale
    for p in range(count):
        x, y = pixels[2, first + p], pixels[3, first + p]
        s, t = (pixels[0, first + p] - shift_u) * scale, (pixels[1, first + p] - shift_v) * scale
        z, w = s * s * 0.0625, t * t * 0.0625
        z, w = z if z < _FAINTEST else _FAINTEST, w if w < _FAINTEST else _FAINTEST
        z = 1.0 / (1.0 + z * (1.0 + z / 2 * (1.0 + z / 3 * (1.0 + z / 4 * (1.0 + z / 5 * (1.0 + z / 6 * (
            1.0 + z / 7 * (1.0 + z / 8 * (1.0 + z / 9)))))))))  # fmt: skip
        w = 1.0 / (1.0 + w * (1.0 + w / 2 * (1.0 + w / 3 * (1.0 + w / 4 * (1.0 + w / 5 * (1.0 + w / 6 * (
            1.0 + w / 7 * (1.0 + w / 8 * (1.0 + w / 9)))))))))  # fmt: skip
        z *= z
        z *= z
        z *= z
        gauss_s = z * z
        w *= w
        w *= w
        w *= w
        gauss_t = w * w
        q, r = 1.0 / (1.0 + 0.3275911 * abs(s)), 1.0 / (1.0 + 0.3275911 * abs(t))
        tail_s = q * (0.254829592 + q * (-0.284496736 + q * (1.421413741 + q * (-1.453152027 + q * 1.061405429))))
        tail_t = r * (0.254829592 + r * (-0.284496736 + r * (1.421413741 + r * (-1.453152027 + r * 1.061405429))))
        erf_s = math.copysign(1.0 - tail_s * gauss_s, s)
        erf_t = math.copysign(1.0 - tail_t * gauss_t, t)
        product = erf_s * erf_t
        strength = (a + a_x * x + a_y * y) * slope
        along_s, along_t = strength * gauss_s * erf_t, strength * gauss_t * erf_s
        terms[p] = 1.0
        terms[_BLOCK + p] = x
        terms[2 * _BLOCK + p] = y
        terms[3 * _BLOCK + p] = product
        terms[4 * _BLOCK + p] = product * x
        terms[5 * _BLOCK + p] = product * y
        terms[6 * _BLOCK + p] = -along_s * scale
        terms[7 * _BLOCK + p] = -along_t * scale
        terms[8 * _BLOCK + p] = -(along_s * s + along_t * t) * widening
        terms[9 * _BLOCK + p] = pixels[4, first + p]


@fast_kernel
def _normal_equations(pixels, used, shape, last, terms, normal, right):  # type: ignore[no-untyped-def]
    """designᵀ design and designᵀ value, given the last step's photometric terms.

    Returns the sum of squared values.
    """
    normal[:] = 0.0
    right[:] = 0.0
    squares = 0.0
    for first in range(0, used, _BLOCK):
        count = min(_BLOCK, used - first)
        _fill_terms(pixels, first, count, shape, last, terms)
        for i in range(_TERMS + 1):
            for j in range(i + 1):
                total = 0.0
                for p in range(count):
                    total += terms[i * _BLOCK + p] * terms[j * _BLOCK + p]
                if i < _TERMS:
                    normal[i, j] += total
                elif j < _TERMS:
                    right[j] += total
                else:
                    squares += total
    for i in range(_TERMS):
        for j in range(i):
            normal[j, i] = normal[i, j]
    return squares
