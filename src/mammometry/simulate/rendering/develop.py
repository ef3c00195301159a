"""From radiance to a photograph: blur, vignetting, noise, transfer curve."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal

import numpy as np

from mammometry.base.photograph import LUMA, Photograph
from mammometry.geometry.arrays import Array, Float32
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.in_camera import arriving, processed, srgb_encoded
from mammometry.simulate.rendering.kernels import develop as develop_kernel


def develop(
    radiance: Float32[Array, "h w *c"], film: Film, *, name: str, seed: int, bits: Literal[8, 16] = 8
) -> Photograph:
    """Expose and develop one picture.

    Args:
        radiance: linear, full scale 1; grey (h, w) or RGB (h, w, 3).
        film: the sensor.
        name: of the photograph.
        seed: of its noise.
        bits: of each channel.
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
    """Blur, vignetting, photons and read-out noise, then a transfer curve."""
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
    """Gaussian weights, cut at 4 σ."""
    radius = max(1, int(np.ceil(4.0 * sigma_px))) if sigma_px > 0 else 0
    offsets = np.arange(-radius, radius + 1)
    weights = np.exp(-0.5 * (offsets / max(sigma_px, 1e-6)) ** 2)
    return (weights / weights.sum()).astype(np.float32)


_LINEAR = np.arange(65536, dtype=np.uint16)
_ENCODED = srgb_encoded(np.arange(65536) / 65535.0)
_SRGB: Mapping[int, Array] = MappingProxyType(
    {8: np.round(_ENCODED * 255.0).astype(np.uint8), 16: np.round(_ENCODED * 65535.0).astype(np.uint16)}
)
"""Bits → encoded value of each of 65536 levels of light."""
