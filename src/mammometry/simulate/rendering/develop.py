"""Convert radiance to a photograph: lens, sensor, and the camera's processing.

Blur, vignetting, noise, exposure, white balance, colour fringes, Bayer mosaic, sharpening, transfer curve.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal

import numpy as np
from scipy.ndimage import convolve, gaussian_filter, map_coordinates

from mammometry.base.photograph import LUMA, Photograph
from mammometry.geometry.arrays import Array, Float32, Float64, UInt16
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.kernels import develop as develop_kernel

_SHARPENED_PX = 1.0  # σ of the blur used for sharpening, px; made up
# Malvar, He and Cutler 2004: linear interpolation of the missing colours, corrected by the gradient of the known one.
_GREEN = np.array([[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1], [0, 0, 2, 0, 0], [0, 0, -1, 0, 0]]) / 8.0
_IN_ROW = (
    np.array([[0, 0, 0.5, 0, 0], [0, -1, 0, -1, 0], [-1, 4, 5, 4, -1], [0, -1, 0, -1, 0], [0, 0, 0.5, 0, 0]]) / 8.0
)
_IN_COLUMN = _IN_ROW.T
_ACROSS = (
    np.array([[0, 0, -1.5, 0, 0], [0, 2, 0, 2, 0], [-1.5, 0, 6, 0, -1.5], [0, 2, 0, 2, 0], [0, 0, -1.5, 0, 0]]) / 8.0
)


def arriving(radiance: Float32[Array, "h w c"], film: Film) -> Float32[Array, "h w c"]:
    """Light on the sensor after chromatic aberration and exposure, in three colours if they differ."""
    image = radiance
    if image.shape[2] == 1 and (any(film.aberration) or len(set(film.gain_rgb)) > 1):
        image = np.repeat(image, 3, axis=2)
    image = (image * np.array(film.gain_rgb[: image.shape[2]])).astype(np.float32)
    for channel, larger in ((0, film.aberration[0]), (2, film.aberration[1])):
        if larger:
            image[:, :, channel] = magnified(image[:, :, channel], larger)
    return np.ascontiguousarray(image)


def magnified(plane: Float32[Array, "h w"], larger: float) -> Float32[Array, "h w"]:
    """A picture magnified by 1 + `larger` about its centre, with cubic splines."""
    height, width = plane.shape
    row, column = (np.arange(size) - 0.5 * (size - 1) for size in (height, width))
    at = [
        np.broadcast_to((row / (1.0 + larger) + 0.5 * (height - 1))[:, None], plane.shape),
        np.broadcast_to((column / (1.0 + larger) + 0.5 * (width - 1))[None], plane.shape),
    ]
    found: Float32[Array, "h w"] = map_coordinates(plane, at, order=3, mode="nearest", output=np.float32)
    return found


def processed(counted: UInt16[Array, "h w 3"], film: Film, bits: Literal[8, 16]) -> Array:
    """The picture that the camera writes, from linear counts (full scale 65535)."""
    light = counted.astype(np.float64) / 65535.0
    if film.mosaic:
        light = demosaicked(mosaicked(light))
    encoded = srgb_encoded(np.clip(light, 0.0, 1.0))
    if film.sharpening:
        soft = np.stack([gaussian_filter(encoded[:, :, k], _SHARPENED_PX, mode="nearest") for k in range(3)], axis=2)
        encoded = encoded + film.sharpening * (encoded - soft)
    full = (1 << bits) - 1
    return np.round(np.clip(encoded, 0.0, 1.0) * full).astype(np.uint8 if bits == 8 else np.uint16)


def mosaicked(light: Float64[Array, "h w 3"]) -> Float64[Array, "h w"]:
    """One colour per pixel (RGGB): red in even rows and columns, blue in odd ones, green elsewhere."""
    raw = light[:, :, 1].copy()
    raw[0::2, 0::2] = light[0::2, 0::2, 0]
    raw[1::2, 1::2] = light[1::2, 1::2, 2]
    return raw


def demosaicked(raw: Float64[Array, "h w"]) -> Float64[Array, "h w 3"]:
    """All three colours at every pixel of an RGGB mosaic, by Malvar, He and Cutler's filters."""
    green, in_row, in_column, across = (
        convolve(raw, weights, mode="mirror") for weights in (_GREEN, _IN_ROW, _IN_COLUMN, _ACROSS)
    )
    light = np.repeat(raw[:, :, None], 3, axis=2)
    red, blue = (slice(0, None, 2), slice(0, None, 2)), (slice(1, None, 2), slice(1, None, 2))
    beside_red, beside_blue = (slice(0, None, 2), slice(1, None, 2)), (slice(1, None, 2), slice(0, None, 2))
    light[(*red, 1)], light[(*blue, 1)] = green[red], green[blue]
    light[(*red, 2)], light[(*blue, 0)] = across[red], across[blue]
    light[(*beside_red, 0)], light[(*beside_red, 2)] = in_row[beside_red], in_column[beside_red]
    light[(*beside_blue, 2)], light[(*beside_blue, 0)] = in_row[beside_blue], in_column[beside_blue]
    return light


def srgb_encoded(linear: Float64[Array, "*n"]) -> Float64[Array, "*n"]:
    """Linear light, 0…1, encoded by the sRGB transfer function (IEC 61966-2-1)."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def develop(
    radiance: Float32[Array, "h w *c"], film: Film, *, name: str, seed: int, bits: Literal[8, 16] = 8
) -> Photograph:
    """Make a photograph from radiance.

    Args:
        radiance: linear, full scale 1; grey (h, w) or RGB (h, w, 3).
        film: the sensor.
        name: name of the photograph.
        seed: seed of its noise.
        bits: bits per channel.
    """
    image = radiance if radiance.ndim == 3 else radiance[:, :, None]
    if film.grey and image.shape[2] > 1:
        image = (image @ LUMA)[:, :, None]
    if film.is_processed:
        counted = np.empty((*image.shape[:2], 3), dtype=np.uint16)
        _count(arriving(image, film), film, seed, _LINEAR, counted)
        pixels = processed(counted, film, bits)
    else:
        pixels = np.empty((*image.shape[:2], 3), dtype=_SRGB[bits].dtype)
        _count(image, film, seed, _SRGB[bits], pixels)
    return Photograph(name=name, pixels=np.ascontiguousarray(pixels[:, :, 0]) if film.grey else pixels)


def _count(image: Float32[Array, "h w c"], film: Film, seed: int, table: Array, pixels: Array) -> None:
    """Apply blur, vignetting, photon noise, read-out noise, and a transfer curve."""
    develop_kernel(
        np.ascontiguousarray(image),
        _taps(film.blur_px),
        film.vignetting,
        film.electrons,
        film.read_noise,
        np.random.default_rng(seed).integers(1 << 63, dtype=np.uint64),
        table,
        pixels,
    )


def _taps(sigma_px: float) -> Float32[Array, " t"]:
    """Gaussian weights, truncated at 4 σ."""
    radius = max(1, int(np.ceil(4.0 * sigma_px))) if sigma_px > 0 else 0
    offsets = np.arange(-radius, radius + 1)
    weights = np.exp(-0.5 * (offsets / max(sigma_px, 1e-6)) ** 2)
    return (weights / weights.sum()).astype(np.float32)


_LINEAR = np.arange(65536, dtype=np.uint16)
_ENCODED = srgb_encoded(np.arange(65536) / 65535.0)
_SRGB: Mapping[int, Array] = MappingProxyType(
    {8: np.round(_ENCODED * 255.0).astype(np.uint8), 16: np.round(_ENCODED * 65535.0).astype(np.uint16)}
)
"""Bits → encoded value for each of 65536 levels of light."""
