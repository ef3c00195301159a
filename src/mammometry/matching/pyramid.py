"""Image pyramids of the subject, and fields resampled between their levels.

Pixel centres are at integers on every level: a point at u on one level is at ``(u + 0.5) / 2 − 0.5`` on the next
coarser one (`coarser`), so decimation filters have an even number of taps and are centred between two pixels.
"""

from dataclasses import dataclass

import numpy as np

from mammometry.geometry import Array, Bool, Camera, Float32, Float64, read_only
from mammometry.matching.filters import continue_outside, double, gaussian_taps, halve

_JUMP_PX = 0.5  # change from a pixel's centre to its quarter: a slope of 2, which skin does not have
FAR_WEIGHT = 1e-3  # weight of the subject's mean far from the subject; any small number
_FILL_PX = 3.0  # Gaussian σ of the normalised blur that extends the subject beyond its outline


def coarser(position_px: Float64[Array, "*n"]) -> Float64[Array, "*n"]:
    """Pixel position on the next coarser level."""
    return (position_px + 0.5) / 2 - 0.5


def coarser_camera(camera: Camera) -> Camera:
    """The ideal camera at the resolution of the next coarser level."""
    matrix = camera.matrix.copy()
    matrix[:2, :2] /= 2
    matrix[:2, 2] = coarser(matrix[:2, 2])
    return Camera(
        name=camera.name,
        size_wh=((camera.size_wh[0] + 1) // 2, (camera.size_wh[1] + 1) // 2),
        matrix=matrix,
        distortion=camera.distortion,
        camera_from_world=camera.camera_from_world,
    )


def _half_band_taps() -> Float32[Array, " 14"]:
    """Low-pass at a quarter cycle per pixel, centred between two pixels. Windowed sinc, 14 taps, sum 1."""
    offset = np.arange(-7, 7) + 0.5
    taps = np.sinc(offset / 2) * np.cos(np.pi * offset / 15) ** 2
    return (taps / taps.sum()).astype(np.float32)


HALF_BAND = _half_band_taps()
"""Filter of the finest step: keeps frequencies below a quarter cycle per pixel (plain smoothing loses precision)."""
BINOMIAL = np.array([1, 5, 10, 10, 5, 1], dtype=np.float32) / 32
"""Filter of the coarser steps: smoother, without ringing."""


def decimation(level: int) -> Float32[Array, " taps"]:
    """Filter from the next finer level to this one."""
    return HALF_BAND if level <= 2 else BINOMIAL


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Level:
    """One image of a pair at one resolution."""

    image: Float32[Array, "h w"]
    """Luma, extended smoothly beyond the subject."""
    mask: Bool[Array, "h w"]
    """The subject's pixels."""


def build(image: Float32[Array, "h w"], mask: Bool[Array, "h w"], finest: int, coarsest: int) -> list[Level]:
    """Levels `finest` … `coarsest`, where 0 is the given image.

    Before each decimation the background is replaced by the subject's own blur.
    """
    level = Level(image=continued(image, mask), mask=mask)
    levels = [level] if finest == 0 else []
    for index in range(1, coarsest + 1):
        half = halve(level.image, decimation(index))
        rows, columns = level.mask.shape
        padded = np.pad(level.mask, ((0, rows % 2), (0, columns % 2)), mode="edge")
        count = padded[::2, ::2].astype(np.uint8) + padded[1::2, ::2] + padded[::2, 1::2] + padded[1::2, 1::2]
        level = Level(image=continued(half, count >= 2), mask=count >= 2)
        if index >= finest:
            levels.append(level)
    return levels


def continued(image: Float32[Array, "h w"], mask: Bool[Array, "h w"]) -> Float32[Array, "h w"]:
    """The image inside the mask, its normalised blur outside, so that filters see no background."""
    if mask.all() or not mask.any():
        return image
    # Read-only, like the photograph, so that the kernel is compiled for one type only.
    return continue_outside(
        read_only(image), mask, gaussian_taps(_FILL_PX), float(np.mean(image, where=mask)), FAR_WEIGHT
    )


def finer_field(field: Float32[Array, "h w"], shape_hw: tuple[int, int]) -> Float32[Array, "H W"]:
    """A field on the next finer level, linearly interpolated, with unscaled values."""
    return double(np.ascontiguousarray(field, dtype=np.float32), shape_hw[0], shape_hw[1], np.inf)


def finer_shift(shift: Float32[Array, "h w"], shape_hw: tuple[int, int]) -> Float32[Array, "H W"]:
    """Shifts in the next finer level's pixels: doubled, interpolated linearly, but not across jumps."""
    return double(2 * shift, shape_hw[0], shape_hw[1], 2 * _JUMP_PX)


def finer_mask(mask: Array, shape_hw: tuple[int, int]) -> Array:
    """A mask on the next finer level: each pixel becomes four."""
    return np.repeat(np.repeat(mask, 2, axis=0), 2, axis=1)[: shape_hw[0], : shape_hw[1]]
