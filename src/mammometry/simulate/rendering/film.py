"""From radiance to a photograph: blur, vignetting, noise, transfer curve."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np

from mammometry.base.photograph import Photograph
from mammometry.geometry.arrays import Array, Float32, Float64
from mammometry.geometry.camera import Camera
from mammometry.simulate.rendering.kernels import develop as develop_kernel
from mammometry.simulate.rendering.sampling import PINHOLE, Aperture


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
    f_number: float | None = None
    """Focal length over the opening's diameter; None for all depths sharp."""
    focus_mm: float | None = None
    """Depth of the plane that is sharp, where there is an f-number; None for each camera's own depth of the middle of
    the rig, where the subject stands."""
    sensor_width_mm: float = 22.3
    """Width of the sensor (APS-C), from which the focal length in mm follows."""
    jpeg_quality: int = 95
    """Of the files, 1…100, without chroma subsampling."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("blur_px", 0.0, 50.0),
            ("vignetting", 0.0, 1.0),
            ("electrons", 1.0, math.inf),
            ("read_noise", 0.0, math.inf),
            ("f_number", 0.5, 1000.0),
            ("focus_mm", 1.0, math.inf),
            ("sensor_width_mm", 0.1, 1000.0),
            ("jpeg_quality", 1, 100),
        ):
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise ValueError(f"{name} must lie between {low:g} and {high:g}, found {value}")

    def aperture(self, camera: Camera) -> Aperture:
        """The lens's opening on this camera: its focal length in mm over the f-number, and what it is focused at."""
        if self.f_number is None:
            return PINHOLE
        focal_mm = float(camera.matrix[0, 0]) * self.sensor_width_mm / camera.size_wh[0]
        return Aperture(diameter_mm=focal_mm / self.f_number, focus_mm=self.focused_mm(camera))

    def focused_mm(self, camera: Camera) -> float:
        """Depth of the plane that is sharp on this camera, mm from its centre; the camera is in the rig's frame."""
        return float(camera.camera_from_world.translation_mm[2]) if self.focus_mm is None else self.focus_mm


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
    pixels = np.empty((*image.shape[:2], 3), dtype=_SRGB[bits].dtype)
    develop_kernel(
        image,
        _taps(film.blur_px),
        film.vignetting,
        film.electrons,
        film.read_noise,
        np.random.default_rng(seed).integers(1 << 63, dtype=np.uint64),
        _SRGB[bits],
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


_ENCODED = srgb_encoded(np.arange(65536) / 65535.0)
_SRGB: Mapping[int, Array] = MappingProxyType(
    {8: np.round(_ENCODED * 255.0).astype(np.uint8), 16: np.round(_ENCODED * 65535.0).astype(np.uint16)}
)
"""Bits → encoded value of each of 65536 levels of light."""
