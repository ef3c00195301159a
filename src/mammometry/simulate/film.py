"""From radiance to a photograph: blur, vignetting, noise, transfer curve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mammometry.geometry.arrays import Array, Float32, Float64, UInt8
from mammometry.photograph import Photograph
from mammometry.simulate.kernels import develop as develop_kernel


@dataclass(frozen=True, slots=True, kw_only=True)
class Film:
    """The sensor and its lens, at the size rendered."""

    blur_px: float = 0.5
    """Standard deviation of the point spread function beyond the pixel's own square, px; 0 for none."""
    vignetting: float = 0.08
    """Loss of light in the corners, 0…1."""
    electrons: float = 18000.0
    """At full scale: photon noise is its square root."""
    read_noise: float = 12.0
    """Electrons."""
    stray_light: float = 0.004
    """Radiance of the dark room and the lens's flare, added everywhere, of full scale."""


def develop(radiance: Float32[Array, "h w *c"], film: Film, *, name: str, seed: int) -> Photograph:
    """Expose and develop one picture.

    Args:
        radiance: linear, full scale 1; grey (h, w) or RGB (h, w, 3).
        film: the sensor.
        name: of the photograph.
        seed: of its noise.
    """
    image = radiance if radiance.ndim == 3 else radiance[:, :, None]
    pixels = np.empty((*image.shape[:2], 3), dtype=np.uint8)
    develop_kernel(
        image,
        _taps(film.blur_px),
        film.vignetting,
        film.electrons,
        film.read_noise,
        np.random.default_rng(seed).integers(1 << 63, dtype=np.uint64),
        _SRGB,
        pixels,
    )
    return Photograph(name=name, pixels=pixels)


def srgb_encoded(linear: Float64[Array, "*n"]) -> Float64[Array, "*n"]:
    """Encode linear light, 0…1, by the sRGB transfer function (IEC 61966-2-1)."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def _taps(sigma_px: float) -> Float32[Array, " t"]:
    """Gaussian weights, cut at 4 σ."""
    radius = max(1, int(np.ceil(4.0 * sigma_px))) if sigma_px > 0 else 0
    offsets = np.arange(-radius, radius + 1)
    weights = np.exp(-0.5 * (offsets / max(sigma_px, 1e-6)) ** 2)
    return (weights / weights.sum()).astype(np.float32)


_SRGB: UInt8[Array, " 65536"] = np.round(srgb_encoded(np.arange(65536) / 65535.0) * 255.0).astype(np.uint8)
