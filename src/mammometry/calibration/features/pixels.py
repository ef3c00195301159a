"""Reduced grey images for searching, linear light for measuring, and the points that are found."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mammometry.base.photograph import Photograph, linear_of
from mammometry.calibration.features.corner_kernels import weighted_levels
from mammometry.geometry.arrays import Array, Float32, Float64, Int64, UInt8

MIN_POINTS = 8
"""Fewest points by which a target is recognised. Fewer may match by chance."""
_BRIGHTEST, _SPARSE = 99.5, 4
"""Percentile of the levels that becomes black in the inverse, and step of the rows and columns used for it."""
_REC709 = np.array([[0.2126, 0.7152, 0.0722]], dtype=np.float32)


def grey_bytes(photograph: Photograph) -> UInt8[Array, "h w"]:
    """Grey levels of 8 bits for detectors, from the encoded values."""
    pixels = photograph.pixels
    if pixels.dtype == np.uint16:
        pixels = (pixels >> 8).astype(np.uint8)
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY) if pixels.ndim == 3 else pixels, dtype=np.uint8)


def reduced(grey: UInt8[Array, "h w"], width_px: int) -> tuple[UInt8[Array, "p q"], Float64[Array, 2]]:
    """Area-averaged image of about `width_px`, and its scale.

    The scale is original pixels per reduced pixel, x and y. Large images are reduced by an integer, which is three
    times as fast, and may be up to half as wide again.
    """
    height, width = grey.shape
    if width <= 1.25 * width_px:
        return grey, np.ones(2)
    if (step := width // width_px) >= 2:
        whole = grey[: height // step * step, : width // step * step]
        small = cv2.resize(whole, None, fx=1 / step, fy=1 / step, interpolation=cv2.INTER_AREA)
        return np.asarray(small, dtype=np.uint8), np.full(2, float(step))
    size_wh = (width_px, max(1, round(height * width_px / width)))
    small = cv2.resize(grey, size_wh, interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8), np.array([width / size_wh[0], height / size_wh[1]])


def enlarge(uv: Float64[Array, "*n 2"], scale: Float64[Array, 2]) -> Float64[Array, "*n 2"]:
    """Original pixels of reduced pixels: ``(x + ½) · s − ½``. Integers are at pixel centres."""
    return (uv + 0.5) * scale - 0.5


def linear_luma(photograph: Photograph) -> Float32[Array, "h w"]:
    """Rec. 709 luminance in linear light, 0…1, in which a blurred edge is symmetric."""
    if photograph.pixels.dtype == np.uint8:
        # The same values as Photograph.linear(), by look-up: ten times as fast, without an intermediate image.
        levels = Photograph(name=photograph.name, pixels=np.arange(256, dtype=np.uint8)[None]).linear()[0]
        if photograph.pixels.ndim == 2:
            return levels[photograph.pixels]
        return weighted_levels(photograph.pixels, *(levels * _REC709.T))
    linear = photograph.linear()
    return np.asarray(cv2.transform(linear, _REC709) if linear.ndim == 3 else linear, dtype=np.float32)


def inverse_of(photograph: Photograph) -> Photograph:
    """The inverted photograph, 16 bit.

    Linear light is subtracted from that of the brightest parts, so that blurred edges keep their positions.
    """
    light = linear_of(photograph.pixels.dtype)
    top = light[int(np.percentile(photograph.pixels[::_SPARSE, ::_SPARSE], _BRIGHTEST))]
    linear = np.clip(top - light, 0.0, 1.0).astype(np.float64)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    levels = np.rint(np.iinfo(np.uint16).max * encoded).astype(np.uint16)
    return Photograph(name=photograph.name, pixels=levels[photograph.pixels])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FoundPoints:
    """Points of the target in one photograph."""

    ids: Int64[Array, " n"]
    """Indices into ``target.points_target``, ascending."""
    uv: Float64[Array, "n 2"]
    """Distorted pixels of the original photograph."""
    covariance_px2: Float64[Array, "n 2 2"]
    """Covariance of each point's `uv` by the fit alone, px²."""
    inverse: bool = False
    """Whether they were found in the inverted photograph: the target is printed white on black."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """Reason why a photograph's target cannot be used."""

    found: str
    """What the photograph shows."""
    remedy: str
    """What to do. Empty if nothing is wrong: not every camera sees the target in every pose."""
    code: str = "no-target"
    """Kind of the reason, for programs. It never changes."""
