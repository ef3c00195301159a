"""Photographs and masks: JPEG, PNG, TIFF, 8 or 16 bit. The content decides the format, not the name.

TIFF is read by tifffile and imagecodecs, size and pixels as the camera meant them.
"""

from __future__ import annotations

import logging
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image, UnidentifiedImageError

from mammometry.base.errors import ImageError, MammometryError
from mammometry.base.listing import visible
from mammometry.base.parse import LimitSettings, require_file
from mammometry.base.photograph import Photograph
from mammometry.geometry.arrays import Array, Bool, UInt8

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


EXTENSIONS = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
"""File name endings that are taken for photographs. In any case."""

FORMATS = ("JPEG", "PNG", "TIFF")
"""Formats of photographs, by content and not by name: Pillow hands an EPS to Ghostscript."""

Image.MAX_IMAGE_PIXELS = None  # `LimitSettings` says what is too large, by the header, in `read_header`

_EXIF_ORIENTATION = 274  # EXIF's tag of that name
_TRANSPOSED = (5, 6, 7, 8)  # EXIF's orientations that swap width and height
# What each EXIF orientation needs to look as the photographer saw it: (transpose first, flip rows, flip columns).
_UPRIGHT: Mapping[int, tuple[bool, bool, bool]] = {
    1: (False, False, False),
    2: (False, False, True),
    3: (False, True, True),
    4: (False, True, False),
    5: (True, False, False),
    6: (True, False, True),
    7: (True, True, True),
    8: (True, True, False),
}
_OTHER_FORMATS = (
    *((4, b"ftyp" + brand, "a HEIC") for brand in (b"heic", b"heix", b"mif1", b"msf1")),
    (4, b"ftypavif", "an AVIF"), (4, b"ftypcrx", "a raw picture (CR3)"), (8, b"WEBP", "a WebP"), (0, b"BM", "a BMP"),
    (0, b"GIF8", "a GIF"), (0, b"%PDF", "a PDF"),
)  # fmt: skip
"""Where a mark stands, the mark, and whose it is."""
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_JPEG_END = b"\xff\xd9"
_PNG_TAGS = {b"eXIf", b"tEXt", b"zTXt", b"iTXt"}  # where an orientation may stand


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageHeader:
    """Facts in an image file's header."""

    stored_wh: tuple[int, int]
    """Width and height as stored, pixels."""
    orientation: int
    """EXIF orientation, 1…8. 1 where the file does not say."""
    bits: int
    """Bits a channel."""

    @property
    def size_wh(self) -> tuple[int, int]:
        """Width and height as shown, the orientation applied."""
        width, height = self.stored_wh
        return (height, width) if self.orientation in _TRANSPOSED else (width, height)


def read_header(path: Path, name: str, limits: LimitSettings = LimitSettings()) -> ImageHeader:
    """Read size, orientation and depth of an image file, without its pixels.

    Args:
        path: the file.
        name: what to call it in messages.
        limits: the size that it may have.

    Raises:
        ImageError: it is missing, unreadable, too large, or no JPEG, PNG or TIFF by its content.
    """
    with _reading(path, name):
        if path.exists():
            require_file(path, name, "a photograph", refusal=ImageError)
        tag: object
        if is_tiff(path):
            size_wh, tag, bits = tiff_header(path)
        else:
            with Image.open(path, formats=FORMATS) as image:
                size_wh, tag = image.size, exif_of(image, path).get(_EXIF_ORIENTATION)
                bits = _bits(image, path)
        _check_size(size_wh, name, limits)
        orientation = tag if isinstance(tag, int) and tag in _UPRIGHT else 1
        return ImageHeader(stored_wh=size_wh, orientation=orientation, bits=bits)


def megapixels_of(folder: Path, limits: LimitSettings = LimitSettings()) -> float:
    """Size of all photographs in a folder by their headers, megapixels.

    Raises:
        OSError: there is no such folder.
        ImageError: one is unreadable.
    """
    total = 0
    for path in visible(folder):
        if path.suffix.lower() in EXTENSIONS:
            width, height = read_header(path, path.name, limits).stored_wh
            total += width * height
    return round(total / 1e6, 3)


def read_photograph(
    path: Path, name: str, limits: LimitSettings = LimitSettings(), *, as_stored: bool = False
) -> Photograph:
    """Read a photograph, turned as its EXIF orientation says.

    An alpha channel is dropped. Of a file with several pictures, as some cameras write them (MPO), the first is taken.

    Args:
        path: the file.
        name: what to call it in messages.
        limits: the size that it may have.
        as_stored: whether it is left as its pixels are stored, whatever its orientation.

    Raises:
        ImageError: as `read_header`; it is truncated or damaged, or has neither 8 nor 16 bits a channel.
    """
    header = read_header(path, name, limits)
    if header.bits not in (8, 16):
        remedy = "Export it as an ordinary JPEG, PNG or TIFF"
        raise ImageError(name, found=f"{header.bits} bits a channel", expected="8 or 16 bits", remedy=remedy)
    with _reading(path, name):
        _require_complete(path, name)
        if is_tiff(path):
            pixels = tiff_pixels(path)
        else:
            pixels = _decoded_8bit(path) if header.bits == 8 else _decoded_16bit_png(path)
        if pixels.shape[1::-1] != header.stored_wh:
            raise ValueError(f"{pixels.shape} pixels, which its header does not state")
    transpose, flip_rows, flip_columns = _UPRIGHT[1 if as_stored else header.orientation]
    if transpose:
        pixels = pixels.swapaxes(0, 1)
    pixels = pixels[:: -1 if flip_rows else 1, :: -1 if flip_columns else 1]
    return Photograph(name=name, pixels=np.ascontiguousarray(pixels))


def read_plain_picture(
    path: Path, name: str, formats: tuple[str, ...], limits: LimitSettings = LimitSettings()
) -> UInt8[Array, "h w 3"]:
    """Read a picture of a format that no camera writes, as 8-bit RGB.

    Args:
        path: the file.
        name: what to call it in messages.
        formats: as Pillow names them.
        limits: the size that it may have.

    Raises:
        ImageError: it cannot be read, or is too large.
    """
    with _reading(path, name), Image.open(path, formats=formats) as image:
        _check_size(image.size, name, limits)
        return np.array(image.convert("RGB"))


def read_mask(path: Path, name: str, limits: LimitSettings = LimitSettings()) -> Bool[Array, "h w"]:
    """Read a foreground mask: subject where grey reaches half its range.

    Raises:
        ImageError: as `read_photograph`.
    """
    values = read_photograph(path, name, limits).encoded()
    return np.asarray((values if values.ndim == 2 else values.mean(axis=2)) >= 0.5)


def demosaiced(raw: Array, pattern: str) -> Array:
    """Interpolate the colours of a Bayer sensor.

    Args:
        raw: (h, w), 8 or 16 bit.
        pattern: colours of the upper left two pixels: ``RG``, ``GR``, ``GB`` or ``BG``.

    Returns:
        (h, w, 3), RGB.
    """
    import cv2  # its names are those of the second row's second pixel on

    codes = {
        "RG": cv2.COLOR_BAYER_BG2RGB,
        "GR": cv2.COLOR_BAYER_GB2RGB,
        "GB": cv2.COLOR_BAYER_GR2RGB,
        "BG": cv2.COLOR_BAYER_RG2RGB,
    }
    return np.asarray(cv2.cvtColor(raw, codes[pattern]))


def check_sizes(headers: Mapping[str, ImageHeader], camera: str, expected_wh: tuple[int, int] | None = None) -> None:
    """Require one size and orientation for all photographs of a camera.

    A file turned by software keeps its look but not its stored pixels; a turned camera the other way round. Where the
    two cannot be distinguished, the photographs are refused, because a wrong guess makes a wrong calibration.

    Args:
        headers: name of each photograph → its header.
        camera: the camera that took them.
        expected_wh: the size that a ready-made calibration holds for.

    Raises:
        ImageError: names the photograph, its size or orientation, and what the others have.
    """
    first: tuple[str, ImageHeader] | None = None
    for name, header in headers.items():
        width, height = header.size_wh
        if first is None:
            first = (name, header)
            if expected_wh is None or header.size_wh == expected_wh:
                continue
            like, wanted = "in cameras.json", expected_wh
        else:
            like, wanted = f"in {first[0]}", first[1].size_wh
        if header.size_wh != wanted:
            turned = first[1].orientation != header.orientation
            raise ImageError(
                name,
                found=f"{width} × {height} pixels" + (f" (EXIF orientation {header.orientation})" if turned else ""),
                expected=f"{wanted[0]} × {wanted[1]} pixels, as {like} of camera {camera}"
                + (f" (EXIF orientation {first[1].orientation})" if turned else ""),
                remedy="Export all photographs of a camera turned the same way"
                if turned or (width, height) == wanted[::-1]
                else "Export the photographs at one size, without cropping or scaling",
            )
        if header.orientation != first[1].orientation and header.stored_wh == first[1].stored_wh:
            remedy = "Export all photographs of a camera turned the same way"
            expected = f"{first[1].orientation}, as {like} of camera {camera}"
            raise ImageError(name, found=f"EXIF orientation {header.orientation}", expected=expected, remedy=remedy)


def _check_size(size_wh: tuple[int, int], name: str, limits: LimitSettings) -> None:
    width, height = size_wh
    if width * height > limits.megapixels * 1e6:
        raise ImageError(
            name,
            found=f"{width} × {height} pixels, {width * height / 1e6:.0f} megapixels",
            expected=f"at most {limits.megapixels:g}",
            remedy="Check the file; if it is right, raise limits.megapixels",
        )


@contextmanager
def _reading(path: Path, name: str) -> Iterator[None]:
    """Turn any decoder error from a damaged file into one sentence."""
    try:
        yield
    except (MammometryError, MemoryError):
        raise
    except Exception as error:
        raise _unreadable(path, name, error) from None


def _decoded_8bit(path: Path) -> Array:
    with Image.open(path, formats=FORMATS) as image:
        if image.format == "JPEG" and image.mode in ("L", "RGB"):
            pixels = _decoded_jpeg(path, grey=image.mode == "L")
            if pixels is not None:
                return pixels
        image.load()
        grey = image.mode in ("L", "LA", "1")
        return np.array(image if image.mode in ("L", "RGB") else image.convert("L" if grey else "RGB"))


def _decoded_jpeg(path: Path, *, grey: bool) -> Array | None:
    """Decode a JPEG with OpenCV.

    It has the same library as Pillow, and takes half the time: it makes no copy of the pixels.

    None where the file does not end as a JPEG should: OpenCV fills what is missing and reports nothing, Pillow reports.
    """
    import cv2

    coded = np.fromfile(path, dtype=np.uint8)
    if bytes(coded[-2:]) != _JPEG_END:
        return None
    colours = cv2.IMREAD_GRAYSCALE if grey else cv2.IMREAD_COLOR_RGB
    try:
        pixels = cv2.imdecode(coded, colours | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        return None
    return None if pixels is None else np.asarray(pixels)


def _decoded_16bit_png(path: Path) -> Array:
    from imagecodecs import png_decode  # Pillow reduces 16-bit colour to 8

    pixels = np.asarray(png_decode(path.read_bytes()))
    if pixels.ndim == 3:
        pixels = pixels[..., 0] if pixels.shape[2] <= 2 else pixels[..., :3]
    return pixels


def _bits(image: Image.Image, path: Path) -> int:
    if image.format == "PNG":
        with path.open("rb") as file:
            depth = file.read(25)[24]
        return max(depth, 8)  # 1, 2 and 4 bits are expanded
    return 8


def exif_of(image: Image.Image, path: Path) -> Image.Exif:
    """Tags of a photograph.

    Pillow decodes a PNG to see what stands behind its pixels: only where something does.
    """
    kinds = [kind for kind, _ in _png_chunks(path)]
    behind = kinds[kinds.index(b"IDAT") :] if b"IDAT" in kinds else []
    return Image.Image.getexif(image) if kinds and not _PNG_TAGS.intersection(behind) else image.getexif()


def is_tiff(path: Path) -> bool:
    """Whether a file begins as a TIFF."""
    with path.open("rb") as file:
        return file.read(4) in SIGNATURES


def _png_chunks(path: Path) -> Iterator[tuple[bytes, int]]:
    """Kind and end, bytes, of each chunk of a PNG. The last chunk may be truncated. Empty for other files."""
    size = path.stat().st_size
    with path.open("rb") as file:
        position, kind = 8, b"" if file.read(8) == _PNG_SIGNATURE else b"IEND"
        while kind != b"IEND" and position <= size:
            file.seek(position)
            header = file.read(8)
            length, kind = struct.unpack(">I4s", header) if len(header) == 8 else (size, b"")
            position += 12 + length
            yield kind, position


def _require_complete(path: Path, name: str) -> None:
    """Find truncation before a decoder does. Some decoders fill the rest with grey and report nothing."""
    size = path.stat().st_size
    if any(end > size for _, end in _png_chunks(path)):
        raise _truncated(name)
    if is_tiff(path) and tiff_is_truncated(path):
        raise _truncated(name)


def _truncated(name: str) -> ImageError:
    return ImageError(
        name, found="a truncated image", expected="the whole file", remedy="Copy it again from the camera"
    )


def _other_format(path: Path) -> str | None:
    """Name of a picture's format that is not read here, by its first bytes."""
    with path.open("rb") as file:
        head = file.read(16)
    return next((words for place, mark, words in _OTHER_FORMATS if head[place:].startswith(mark)), None)


def _unreadable(path: Path, name: str, error: BaseException | None) -> ImageError:
    if isinstance(error, FileNotFoundError):
        return ImageError(name, found="no file", expected="a photograph", remedy="Put it there")
    if isinstance(error, PermissionError):
        return ImageError(
            name, found="a file that may not be read", expected="read permission", remedy="Change its permissions"
        )
    if path.is_file() and path.stat().st_size == 0:
        return ImageError(name, found="an empty file", expected="a photograph", remedy="Copy it again from the camera")
    if isinstance(error, UnusualTiffError):
        remedy = "Export it as an ordinary JPEG, PNG or TIFF"
        return ImageError(name, found=str(error), expected="a photograph, grey or RGB, of 8 or 16 bits", remedy=remedy)
    if error is not None and "truncated" in str(error).lower():
        return _truncated(name)
    if isinstance(error, OSError) and error.errno is not None:
        found = f"a file that cannot be read ({error.strerror})"
        return ImageError(name, found=found, expected="a photograph", remedy="Check the path and what it leads to")
    kind = "a damaged image"
    if isinstance(error, UnidentifiedImageError):
        kind = _other_format(path) or "a file that is not an image"
    remedy = "Copy it again from the camera, or export it again"
    return ImageError(name, found=kind, expected="a readable JPEG, PNG or TIFF", remedy=remedy)
