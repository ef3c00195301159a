"""TIFF photographs: select the page, decode it, find damage. Uses tifffile and imagecodecs."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from mammometry.geometry.arrays import Array
from mammometry.io.photographs.jpeg_stream import Layout, check_jpeg
from mammometry.io.photographs.seams import has_seam

if TYPE_CHECKING:
    from tifffile import TiffPage

SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""First bytes of a TIFF or BigTIFF."""
_ORIENTATION = 274
_MOST_SAMPLES = 8  # more channels are refused before memory is allocated
_MOST_PAGES = 64  # a photograph has a thumbnail, previews and masks; only image stacks have more
_REDUCED, _MASK = 1, 4  # NewSubfileType (TIFF 6.0, section 8): a smaller copy of another page; a transparency mask
_COLOUR_SAMPLES = {"MINISWHITE": 1, "MINISBLACK": 1, "PALETTE": 1, "RGB": 3, "SEPARATED": 4, "YCBCR": 3}
"""Photometric interpretation → samples per pixel. Further samples are transparency, which is dropped."""
_RAW = ("CFA", "LINEAR_RAW")  # raw sensor data in DNG and in manufacturers' formats based on TIFF
_PLANES = 2  # PlanarConfiguration: a separate plane for each channel
_JPEG = (6, 7, 34892)  # compressions that decode YCbCr to RGB
_PLAIN, _LZW, _PACKBITS = 1, 5, 32773  # compressions without a checksum


class UnusualTiffError(ValueError):
    """A valid TIFF that is not an ordinary photograph. The message states what it is."""


class DamagedTiffError(ValueError):
    """A TIFF with damaged pixel data."""


def tiff_header(file: BinaryIO) -> tuple[tuple[int, int], int, int]:
    """Stored width and height in pixels, EXIF orientation (1 if missing), and bits per channel.

    Raises:
        UnusualTiffError: it contains something other than one photograph.
        Exception: it is damaged; tifffile may raise any exception.
    """
    with _photograph(file) as page:
        tag = page.tags.get(_ORIENTATION) or page.parent.pages.first.tags.get(_ORIENTATION)
        orientation = tag.value if tag is not None and isinstance(tag.value, int) else 1
        bits = page.bitspersample
        if not isinstance(bits, int):
            raise UnusualTiffError("channels of different depths")
        return (page.imagewidth, page.imagelength), orientation, bits


def tiff_is_truncated(file: BinaryIO) -> bool:
    """Whether the file ends before its pixels end.

    Raises:
        Exception: it is damaged; tifffile may raise any exception.
    """
    with _photograph(file) as page:
        if len(page.dataoffsets) != len(page.databytecounts):
            raise ValueError("different numbers of offsets and lengths")
        ends = [start + length for start, length in zip(page.dataoffsets, page.databytecounts, strict=True)]
        return max(ends, default=0) > page.parent.filehandle.size


def tiff_pixels(file: BinaryIO) -> Array:
    """Decode the photograph as stored: (h, w) grey or (h, w, 3) RGB, 8 or 16 bit.

    Planes, tiles, compressions, palettes, inverted grey and inks (CMYK) become grey or RGB; transparency is dropped.

    Raises:
        UnusualTiffError: it has another coding.
        DamagedTiffError, DamagedJpegError: its pixels are damaged.
        Exception: it is damaged in another way; tifffile may raise any exception.
    """
    with _photograph(file) as page:
        coding = getattr(page.photometric, "name", "")
        samples = _COLOUR_SAMPLES.get(coding)
        if samples is None or (coding == "YCBCR" and page.compression not in _JPEG):
            raise UnusualTiffError(f"colours coded as {coding or page.photometric}")
        if page.dtype is None or page.dtype.kind != "u":
            raise UnusualTiffError("pixels that are not unsigned integers")
        layouts = _check_parts(page)
        pixels = page.asarray()
        if page.planarconfig == _PLANES and page.samplesperpixel > 1:
            pixels = np.moveaxis(pixels, 0, -1)
        pixels = pixels.reshape(page.imagelength, page.imagewidth, -1)[..., :samples]
        if page.compression == _PLAIN and _has_hole(pixels):
            raise DamagedTiffError("a part of its pixels is blank")
        for index, layout in enumerate(layouts if not page.is_tiled and page.planarconfig != _PLANES else ()):
            if has_seam(pixels[index * page.rowsperstrip : (index + 1) * page.rowsperstrip].squeeze(), layout):
                raise DamagedTiffError("its brightness jumps between rows of blocks")
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
def _photograph(file: BinaryIO) -> Iterator[TiffPage]:
    """The page of the photograph at full size."""
    import tifffile

    logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # a damaged file is reported by our own error
    with tifffile.TiffFile(file) as tiff:
        page = _full_page([*_pages(tiff.pages)])
        if getattr(page.photometric, "name", "") in _RAW:
            raise UnusualTiffError("a camera's raw image, such as DNG or NEF")
        if page.samplesperpixel > _MOST_SAMPLES or page.imagedepth != 1:
            raise UnusualTiffError(f"{page.samplesperpixel} channels in {page.imagedepth} layers")
        yield page


def _pages(series: object) -> Iterator[TiffPage]:
    """All pages, each followed by its sub-pages: some programs store the photograph as a sub-page of a thumbnail."""
    for page in islice(series, _MOST_PAGES + 1):  # type: ignore[call-overload]
        yield page
        if page.subifds:
            yield from _pages(page.pages)


def _full_page(pages: list[TiffPage]) -> TiffPage:
    """The largest page that is neither a reduced copy nor a mask.

    Raises:
        UnusualTiffError: there are several of that size.
    """
    if len(pages) > _MOST_PAGES:
        raise UnusualTiffError(f"more than {_MOST_PAGES} pages")
    if len(pages) == 1:
        return pages[0]
    full = [page for page in pages if not page.subfiletype & (_REDUCED | _MASK)]
    sizes = [page.imagewidth * page.imagelength for page in full]
    largest = [page for page, size in zip(full, sizes, strict=True) if size == max(sizes)]
    if len(largest) != 1:
        raise UnusualTiffError(f"{len(largest)} pages of the same size" if largest else "only reduced copies")
    return largest[0]


def _check_parts(page: TiffPage) -> list[Layout]:
    """Require strips or tiles to have the right length, if the compression has no checksum.

    Returns:
        Layout of each strip or tile that is a JPEG.

    Raises:
        DamagedTiffError, DamagedJpegError: a strip or tile is damaged.
    """
    if page.compression not in (*_JPEG, _LZW, _PACKBITS):
        return []
    from imagecodecs import lzw_decode, packbits_decode

    decode = {_LZW: lzw_decode, _PACKBITS: packbits_decode}.get(int(page.compression))
    if decode is None:
        return [check_jpeg(part, page.jpegtables) for part in _parts(page)]
    for index, part in enumerate(_parts(page)):
        if len(decode(part)) not in _part_bytes(page, index):
            raise DamagedTiffError(f"part {index + 1} is damaged")
    return []


def _parts(page: TiffPage) -> Iterator[bytes]:
    handle = page.parent.filehandle
    for start, length in zip(page.dataoffsets, page.databytecounts, strict=True):
        handle.seek(start)
        yield handle.read(length)


def _part_bytes(page: TiffPage, index: int) -> tuple[int, ...]:
    """Possible lengths of a decoded strip or tile, bytes. The last strip may be padded."""
    assert page.dtype is not None
    samples = 1 if page.planarconfig == _PLANES else page.samplesperpixel
    if page.is_tiled:
        return (page.tilewidth * page.tilelength * samples * page.dtype.itemsize,)
    strips = -(-page.imagelength // page.rowsperstrip)
    rows = min(page.rowsperstrip, page.imagelength - index % strips * page.rowsperstrip)
    return tuple(count * page.imagewidth * samples * page.dtype.itemsize for count in (rows, page.rowsperstrip))


_HOLE_BYTES = 512  # shortest hole that is found: one disk sector
_FEW = 0.05  # largest share of zeros around a hole
_LEAST_STEP = 16  # smallest difference between a hole and its surroundings, of 255 grey levels


def _has_hole(pixels: Array) -> bool:
    """Whether part of an uncompressed image was overwritten by zeros.

    A hole starts or ends within a row and is dark, while the rows directly above and below are not. No scene looks like
    this.

    Args:
        pixels: (h, w, c), as stored.
    """
    stride = pixels[0].size
    flat = pixels.reshape(-1)
    blank = np.concatenate([[False], flat == 0, [False]])
    edges = np.flatnonzero(blank[1:] != blank[:-1])
    starts, ends = edges[::2], edges[1::2]
    long = ends - starts >= max(1, _HOLE_BYTES // pixels.itemsize)
    step = _LEAST_STEP * np.iinfo(pixels.dtype).max // 255
    for start, end in zip(starts[long].tolist(), ends[long].tolist(), strict=True):
        above = flat[max(start - stride, 0) : max(min(end - stride, start), 0)]
        below = flat[max(start + stride, end) : end + stride]
        sides = [side for side in (above, below) if len(side) >= _HOLE_BYTES // (2 * pixels.itemsize)]
        bright = [bool(np.median(side) >= step and np.mean(side == 0) < _FEW) for side in sides]
        if (start % stride or end % stride) and len(bright) == 2 and all(bright):
            return True
    return False
