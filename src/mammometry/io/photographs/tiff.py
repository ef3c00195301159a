"""TIFF photographs: size and pixels as the camera meant them, by tifffile and imagecodecs."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mammometry.geometry.arrays import Array

if TYPE_CHECKING:
    from tifffile import TiffPage

SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""First bytes of a TIFF or BigTIFF."""
_ORIENTATION = 274
_MOST_SAMPLES = 8  # a channel count that no photograph has: refused before memory is allocated
_COLOUR_SAMPLES = {"MINISWHITE": 1, "MINISBLACK": 1, "PALETTE": 1, "RGB": 3, "SEPARATED": 4, "YCBCR": 3}
"""How a picture codes colour → samples of a pixel. What a file has beyond these is transparency, which is dropped."""
_PLANES = 2  # PlanarConfiguration: a plane for each channel
_JPEG_IN_TIFF = (6, 7, 34892)  # compressions that decode YCbCr to RGB


class UnusualTiffError(ValueError):
    """A TIFF that is whole, and codes something else than a photograph. Its text names what."""


def tiff_header(path: Path) -> tuple[tuple[int, int], int, int]:
    """Stored width and height in pixels, EXIF orientation or 1, bits a channel, of the first picture.

    Raises:
        UnusualTiffError: it holds something else than one picture.
        Exception: it is damaged; tifffile raises anything.
    """
    with _first_page(path) as page:
        tag = page.tags.get(_ORIENTATION)
        orientation = tag.value if tag is not None and isinstance(tag.value, int) else 1
        bits = page.bitspersample
        if not isinstance(bits, int):
            raise UnusualTiffError("channels of different depths")
        return (page.imagewidth, page.imagelength), orientation, bits


def tiff_is_truncated(path: Path) -> bool:
    """Whether the file ends before its pixels do.

    Raises:
        Exception: it is damaged; tifffile raises anything.
    """
    with _first_page(path) as page:
        if len(page.dataoffsets) != len(page.databytecounts):
            raise ValueError("another number of offsets than of lengths")
        ends = [start + length for start, length in zip(page.dataoffsets, page.databytecounts, strict=True)]
        return max(ends, default=0) > path.stat().st_size


def tiff_pixels(path: Path) -> Array:
    """Decode the first picture as stored: (h, w) grey or (h, w, 3) RGB, 8 or 16 bit.

    Planes, tiles, compressions, palettes, inverted grey and inks (CMYK) become grey or RGB; transparency is dropped.

    Raises:
        UnusualTiffError: it is coded in a way that is none of these.
        Exception: it is damaged; tifffile raises anything.
    """
    with _first_page(path) as page:
        coding = getattr(page.photometric, "name", "")
        samples = _COLOUR_SAMPLES.get(coding)
        if samples is None or (coding == "YCBCR" and page.compression not in _JPEG_IN_TIFF):
            raise UnusualTiffError(f"colours coded as {coding or page.photometric}")
        if page.dtype is None or page.dtype.kind != "u":
            raise UnusualTiffError("pixels that are not whole numbers from 0 up")
        pixels = page.asarray()
        if page.planarconfig == _PLANES and page.samplesperpixel > 1:
            pixels = np.moveaxis(pixels, 0, -1)
        pixels = pixels.reshape(page.imagelength, page.imagewidth, -1)[..., :samples]
        if coding == "PALETTE":
            assert page.colormap is not None
            return np.asarray((page.colormap >> 8).astype(np.uint8).T[pixels[..., 0]])
    white = np.iinfo(pixels.dtype).max
    if coding == "MINISWHITE":
        return np.asarray(white - pixels[..., 0])
    if coding == "SEPARATED":
        light = (white - pixels).astype(np.float64)
        return np.rint(light[..., :3] * light[..., 3:] / white).astype(pixels.dtype)
    return np.asarray(pixels[..., 0] if samples == 1 else pixels)


@contextmanager
def _first_page(path: Path) -> Iterator[TiffPage]:
    import tifffile

    logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # a damaged file is refused by us, in one sentence
    with path.open("rb") as file, tifffile.TiffFile(file) as tiff:
        page = tiff.pages.first
        if page.samplesperpixel > _MOST_SAMPLES or page.imagedepth != 1:
            raise UnusualTiffError(f"{page.samplesperpixel} channels in {page.imagedepth} layers")
        yield page
