"""Foreground: sub-pixel coverage map of the subject in each photograph, for rectification and carving.

`segment` separates subject and background by brightness and colour, block by block. If a coarse stereo contradicts it,
`seeded` grows the subject from what is near. `silhouette` then locates the outline to a fraction of a pixel.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from mammometry.base.errors import ImageError, MatchingError
from mammometry.base.photograph import Photograph, linear_of
from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Bool, Float32
from mammometry.matching.foreground.block_segmentation import segment
from mammometry.matching.foreground.seeded_segmentation import DepthSeeds, agreed
from mammometry.matching.foreground.silhouette import block_means, sub_pixel_coverage

CONTOUR_LEVEL = 0.4
"""Coverage at the silhouette, 0…1. The border is turned away from the light and darker than the skin next to it: in
eight views of three subjects, 0.5 was 0.1 to 0.3 px inside the true border, and 0.4 within 0.1 px of it."""
_REFERENCE_DIAGONAL_PX = 1353.0  # 1126 × 750 pixels, a quarter of the paper's size, on which widths were measured
_BLOCK_PX = 2.0  # pixels per block at that size: shows a bar of 4 px, and takes about a second
_EVEN = 0.02  # largest difference of encoded values (sRGB), 5 of 255, by noise in the blocks of an empty image
_BLACK = 0.1  # encoded value (sRGB) that no block of a black photograph reaches: 1 % of the light
_BLUR_OF_A_DRAWN_MASK_PX = 1.0  # Gaussian σ that makes a drawn mask's edge smooth


@value(eq=False)
class Foreground:
    """Share of each pixel that the subject covers, in the distorted photograph."""

    camera: str
    coverage: Float32[Array, "h w"]
    """0 background … 1 subject. Smooth near the contour, so that its `contour_level` gives a sub-pixel silhouette."""
    contour_level: float
    """Coverage at the silhouette."""
    everything: bool
    """True: the silhouette is unknown and every pixel may be the subject. Must not be used for carving."""

    @property
    def mask(self) -> Bool[Array, "h w"]:
        """Pixels whose centre is inside the silhouette."""
        return self.coverage >= self.contour_level


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Blocks:
    """A photograph's means over blocks of pixels."""

    encoded: Float32[Array, "h w channels"]
    """sRGB-encoded values, 0…1; one channel or three."""
    step: int
    """Pixels per block."""
    unit: float
    """Pixels per pixel of the reference size."""


def blocks_of(photograph: Photograph) -> Blocks:
    """Means of a photograph over blocks, for finding its subject."""
    step, unit = block_of(photograph.size_wh)
    pixels = np.atleast_3d(photograph.pixels)
    levels = np.linspace(0, 1, np.iinfo(pixels.dtype).max + 1, dtype=np.float32)
    return Blocks(encoded=block_means(pixels, levels, step), step=step, unit=unit)


def block_of(size: tuple[int, int]) -> tuple[int, float]:
    """Pixels per block, and pixels per pixel of the reference size, for a photograph of this size."""
    unit = max(1.0, float(np.hypot(*size)) / _REFERENCE_DIAGONAL_PX)
    return round(_BLOCK_PX * unit), unit


def subject_blocks(name: str, blocks: Blocks, seeds: Sequence[DepthSeeds]) -> Bool[Array, "h w"] | None:
    """Blocks that show the subject. None if nothing separates it from the rest.

    Args:
        name: name of the photograph, for messages.
        blocks: means of the photograph.
        seeds: near and far blocks by coarse stereo, for each pair of the camera.

    Raises:
        MatchingError: the photograph is black or uniform.
    """
    bright = segment(blocks.encoded, blocks.unit / blocks.step)
    subject = agreed(blocks.encoded, bright, seeds, blocks.step, blocks.unit / blocks.step)
    if subject is None:
        _refuse_empty(name, blocks.encoded)
    return subject


def estimate_foreground(
    photograph: Photograph,
    camera_name: str,
    *,
    given: Bool[Array, "h w"] | None = None,
    subject: Bool[Array, "H W"] | None = None,
) -> Foreground:
    """Find the subject's outline in a photograph, or take the given mask.

    Args:
        photograph: the capture.
        camera_name: its camera.
        given: mask of the subject, drawn or segmented by another program; takes precedence.
        subject: blocks of the subject. None: the silhouette is unknown.

    Raises:
        ImageError: the given mask has another size than the photograph.
    """
    if given is not None:
        return _from_mask(photograph, camera_name, given)
    if subject is None:
        whole = np.ones(photograph.pixels.shape[:2], dtype=np.float32)
        return Foreground(camera=camera_name, coverage=whole, contour_level=CONTOUR_LEVEL, everything=True)
    step, unit = block_of(photograph.size_wh)
    pixels = np.atleast_3d(photograph.pixels)
    coverage = sub_pixel_coverage(pixels, linear_of(pixels.dtype), subject, step, unit, CONTOUR_LEVEL)
    return Foreground(camera=camera_name, coverage=coverage, contour_level=CONTOUR_LEVEL, everything=False)


def _refuse_empty(name: str, encoded: Float32[Array, "H W c"]) -> None:
    brightest, darkest = float(encoded.max()), float(encoded.min())
    if brightest < _BLACK:
        raise MatchingError(
            name,
            found=f"a black photograph: its brightest part has {100 * brightest:.0f} % of full brightness",
            expected=f"a lit subject, with at least {100 * _BLACK:.0f} %",
            remedy="Check that this camera's flash fires and its lens is uncovered, and take the capture again",
        )
    if brightest - darkest < _EVEN:
        raise MatchingError(
            name,
            found="a uniform photograph",
            expected="a subject",
            remedy="Check the photograph, and take the capture again",
        )


def _from_mask(photograph: Photograph, camera_name: str, given: Bool[Array, "h w"]) -> Foreground:
    if given.shape != photograph.pixels.shape[:2] or not given.any():
        raise ImageError(
            photograph.name,
            found=f"a mask of {given.shape[1]} × {given.shape[0]} pixels with {np.count_nonzero(given)} of them white",
            expected=f"{photograph.size_wh[0]} × {photograph.size_wh[1]} pixels, as the photograph, some of them white",
            remedy="Draw the mask on the photograph, at its full size",
        )
    coverage = ndimage.gaussian_filter(given.astype(np.float32), _BLUR_OF_A_DRAWN_MASK_PX, mode="nearest")
    return Foreground(camera=camera_name, coverage=coverage, contour_level=0.5, everything=False)
