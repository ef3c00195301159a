"""Read photographs and masks: JPEG, PNG, TIFF, 8 or 16 bit, recognised by content, not by name.

All photographs are read here. Damaged ones are refused, because decoders fill in damaged parts without reporting it.
"""

from __future__ import annotations

import hashlib
import io
import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from mammometry.base.errors import ImageError, MammometryError
from mammometry.base.listing import visible
from mammometry.base.parse import LimitSettings, require_file
from mammometry.base.photograph import Photograph
from mammometry.geometry.arrays import Array, Bool, UInt8
from mammometry.io.photographs.jpeg_stream import DamagedJpegError, TruncatedJpegError, check_jpeg
from mammometry.io.photographs.seams import has_seam
from mammometry.io.photographs.tiff import (
    SIGNATURES,
    DamagedTiffError,
    UnusualTiffError,
    tiff_header,
    tiff_is_truncated,
    tiff_pixels,
)

EXTENSIONS = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
"""Extensions of photographs, in upper or lower case."""

FORMATS = ("JPEG", "PNG", "TIFF")
"""Formats of photographs, recognised by content and not by name: Pillow would run Ghostscript for an EPS."""

Image.MAX_IMAGE_PIXELS = None  # `read_header` checks the size by `LimitSettings`

_EXIF_ORIENTATION = 274  # EXIF's orientation tag
TRANSPOSED = (5, 6, 7, 8)
"""EXIF orientations that swap width and height."""
# How to make a picture with each EXIF orientation upright: (first transpose, flip rows, flip columns).
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
HEIC_MARKS = tuple(b"ftyp" + brand for brand in (b"heic", b"heix", b"mif1", b"msf1"))
"""Signatures of a HEIC, from byte 4."""
_OTHER_FORMATS = (
    *((4, mark, "a HEIC") for mark in HEIC_MARKS),
    (4, b"ftypavif", "an AVIF"), (4, b"ftypcrx", "a raw picture (CR3)"), (8, b"WEBP", "a WebP"), (0, b"BM", "a BMP"),
    (0, b"GIF8", "a GIF"), (0, b"%PDF", "a PDF"),
)  # fmt: skip
"""Position of a signature, the signature, and the format."""
UNREAD_ENDINGS = (
    ".heic", ".heif", ".avif", ".webp", ".nef", ".nrw", ".cr2", ".cr3", ".crw", ".arw", ".srf", ".sr2", ".raf", ".orf",
    ".rw2", ".pef", ".dng", ".raw", ".3fr", ".iiq", ".x3f", ".jp2", ".jxl", ".bmp",
)  # fmt: skip
"""Extensions of cameras' and telephones' images that are not read here, in upper or lower case."""
_PNG_SIGNATURE, _JPEG_SIGNATURE = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
_PNG_TAGS = {b"eXIf", b"tEXt", b"zTXt", b"iTXt"}  # chunks that may contain an orientation


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageHeader:
    """Facts in an image file's header."""

    stored_wh: tuple[int, int]
    """Width and height as stored, pixels."""
    orientation: int
    """EXIF orientation, 1…8. 1 if the file has none."""
    bits: int
    """Bits per channel."""

    @property
    def size_wh(self) -> tuple[int, int]:
        """Width and height as shown, with the orientation applied."""
        width, height = self.stored_wh
        return (height, width) if self.orientation in TRANSPOSED else (width, height)


def read_header(path: Path, name: str, limits: LimitSettings = LimitSettings()) -> ImageHeader:
    """Read size, orientation and depth of an image file without decoding its pixels.

    Args:
        path: the file.
        name: its name in messages.
        limits: largest size.

    Raises:
        ImageError: it is missing, unreadable or too large, or not a JPEG, PNG or TIFF.
    """
    with reading(path, name):
        if path.exists():
            require_file(path, name, "a photograph", refusal=ImageError)
        tag: object
        if is_tiff(path):
            with path.open("rb") as file:
                size_wh, tag, bits = tiff_header(file)
        else:
            with Image.open(path, formats=FORMATS) as image:
                size_wh, tag = image.size, exif_of(image, path).get(_EXIF_ORIENTATION)
                bits = _bits(image, path)
        check_size(size_wh, name, limits)
        orientation = tag if isinstance(tag, int) and tag in _UPRIGHT else 1
        return ImageHeader(stored_wh=size_wh, orientation=orientation, bits=bits)


def megapixels_of(folder: Path, limits: LimitSettings = LimitSettings()) -> float:
    """Total size of all photographs in a folder, from their headers, megapixels.

    Raises:
        OSError: the folder does not exist.
        ImageError: a photograph is unreadable.
    """
    total = 0
    for path in visible(folder):
        if path.suffix.lower() in EXTENSIONS:
            width, height = read_header(path, path.name, limits).stored_wh
            total += width * height
    return round(total / 1e6, 3)


def read_photograph(
    path: Path,
    name: str,
    limits: LimitSettings = LimitSettings(),
    *,
    as_stored: bool = False,
    digest: str | None = None,
) -> Photograph:
    """Read a photograph, turned upright by its EXIF orientation.

    An alpha channel is dropped. In a JPEG with several images (MPO, written by some cameras), the first one is read, in
    a TIFF the one at full size.

    Args:
        path: the file.
        name: its name in messages.
        limits: largest size.
        as_stored: whether to ignore the orientation.
        digest: SHA-256 of the file at the time when the run was planned. None: unknown.

    Raises:
        ImageError: see `read_header`; or the photograph is truncated or damaged, has neither 8 nor 16 bits per channel,
        has 10 or 12 bits that were not scaled to 16, or its digest differs from `digest`.
    """
    header = read_header(path, name, limits)
    if header.bits not in (8, 16):
        remedy = "Export it as an ordinary JPEG, PNG or TIFF"
        raise ImageError(name, found=f"{header.bits} bits per channel", expected="8 or 16 bits", remedy=remedy)
    with reading(path, name):
        content = path.read_bytes()
        found = hashlib.sha256(content).hexdigest()
        if digest not in (None, found):
            raise ImageError(
                name,
                found="a file that changed during the run",
                expected="the same file from beginning to end",
                remedy="Wait until all photographs are copied, then run the same command again",
            )
        pixels = _pixels(content, header, checked=found in _undamaged)
        if pixels.shape[1::-1] != header.stored_wh:
            raise ValueError(f"{pixels.shape} pixels, unlike its header")
        if len(_undamaged) < _MOST_REMEMBERED:
            _undamaged.add(found)
        _require_scaled(pixels, name)
    pixels = turned_upright(pixels, 1 if as_stored else header.orientation)
    return Photograph(name=name, pixels=np.ascontiguousarray(pixels))


def turned_upright(pixels: Array, orientation: int) -> Array:
    """View of pixels, rotated upright by their EXIF orientation, 1…8."""
    transpose, flip_rows, flip_columns = _UPRIGHT[orientation]
    if transpose:
        pixels = pixels.swapaxes(0, 1)
    return pixels[:: -1 if flip_rows else 1, :: -1 if flip_columns else 1]


def read_plain_picture(
    path: Path, name: str, formats: tuple[str, ...], limits: LimitSettings = LimitSettings()
) -> UInt8[Array, "h w 3"]:
    """Read an image in a format that cameras do not write, as 8-bit RGB.

    Args:
        path: the file.
        name: its name in messages.
        formats: names of the formats in Pillow.
        limits: largest size.

    Raises:
        ImageError: it cannot be read or is too large.
    """
    with reading(path, name), Image.open(path, formats=formats) as image:
        check_size(image.size, name, limits)
        return np.array(image.convert("RGB"))


def read_mask(
    path: Path, name: str, limits: LimitSettings = LimitSettings(), *, digest: str | None = None
) -> Bool[Array, "h w"]:
    """Read a foreground mask. It shows the subject where grey is at least half its range.

    Raises:
        ImageError: see `read_photograph`.
    """
    values = read_photograph(path, name, limits, digest=digest).encoded()
    return np.asarray((values if values.ndim == 2 else values.mean(axis=2)) >= 0.5)


def demosaiced(raw: Array, pattern: str) -> Array:
    """Interpolate the colours of a Bayer sensor.

    Args:
        raw: (h, w), 8 or 16 bit.
        pattern: colours of the first two pixels in the upper left corner: ``RG``, ``GR``, ``GB`` or ``BG``.

    Returns:
        (h, w, 3), RGB.
    """
    import cv2  # OpenCV names patterns by the second pixel of the second row

    codes = {
        "RG": cv2.COLOR_BAYER_BG2RGB,
        "GR": cv2.COLOR_BAYER_GB2RGB,
        "GB": cv2.COLOR_BAYER_GR2RGB,
        "BG": cv2.COLOR_BAYER_RG2RGB,
    }
    return np.asarray(cv2.cvtColor(raw, codes[pattern]))


def check_sizes(headers: Mapping[str, ImageHeader], camera: str, expected_wh: tuple[int, int] | None = None) -> None:
    """Require all photographs of a camera to have the same size and orientation.

    A file that software has rotated looks the same but has other stored pixels. If the camera was rotated, it is the
    other way round. If the two cannot be distinguished, the photographs are refused, because a wrong guess would give a
    wrong calibration.

    Args:
        headers: name of each photograph → its header.
        camera: the camera that took them.
        expected_wh: image size in an existing calibration.

    Raises:
        ImageError: names the photograph, its size or orientation, and those of the others.
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


def check_size(size_wh: tuple[int, int], name: str, limits: LimitSettings) -> None:
    """Raise an ImageError if an image is larger than the limit."""
    width, height = size_wh
    if width * height > limits.megapixels * 1e6:
        raise ImageError(
            name,
            found=f"{width} × {height} pixels, {width * height / 1e6:.0f} megapixels",
            expected=f"at most {limits.megapixels:g}",
            remedy="Check the file; if it is right, raise limits.megapixels",
        )


@contextmanager
def reading(path: Path, name: str, formats: str = "JPEG, PNG or TIFF") -> Iterator[None]:
    """Turn any error of a decoder for a damaged file into one sentence."""
    try:
        yield
    except (MammometryError, MemoryError):
        raise
    except Exception as error:
        raise _unreadable(path, name, error, formats) from None


# bits of sensors whose values are stored in 16 bits; 14 bits may also be a dark image of 16 bits
_SENSOR_BITS = (10, 12)


def _require_scaled(pixels: Array, name: str) -> None:
    """Refuse 16-bit files with unscaled sensor values, which would be almost black."""
    largest = int(pixels.max()) if pixels.dtype == np.uint16 else 0
    if (bits := largest.bit_length()) in _SENSOR_BITS:
        raise ImageError(
            name,
            found=f"no value above {largest} of 65535: {bits} bits that were not scaled to 16, or a black image",
            expected="values that use all 16 bits",
            remedy=f"Export it multiplied by {1 << (16 - bits)}, or with 8 bits; if it is black, take it again",
        )


_undamaged: set[str] = set()
"""Digests of files that were checked, because a run reads its photographs several times."""
_MOST_REMEMBERED = 10_000  # digests: 1 MB


def _pixels(content: bytes, header: ImageHeader, *, checked: bool) -> Array:
    """Check and decode a file.

    Raises:
        Exception: the file is damaged, even if a decoder would read it.
    """
    if content.startswith(SIGNATURES):
        if tiff_is_truncated(io.BytesIO(content)):
            raise DamagedTiffError("it is truncated")
        return tiff_pixels(io.BytesIO(content))
    if content.startswith(_PNG_SIGNATURE):
        if not checked:
            _check_png(content)
        return _by_pillow(content) if header.bits == 8 else _decoded_16bit_png(content)
    layout = None if checked else check_jpeg(content)
    pixels = _decoded_jpeg(content)
    if layout is not None and has_seam(pixels, layout):
        raise DamagedJpegError("its brightness jumps between rows of blocks")
    return pixels


def _by_pillow(content: bytes) -> Array:
    with Image.open(io.BytesIO(content), formats=FORMATS) as image:
        image.load()
        grey = image.mode in ("L", "LA", "1")
        return np.array(image if image.mode in ("L", "RGB") else image.convert("L" if grey else "RGB"))


def _decoded_jpeg(content: bytes) -> Array:
    """Decode a JPEG with OpenCV, or CMYK with Pillow.

    Both use libjpeg, but OpenCV takes half the time, because it does not copy the pixels.
    """
    import cv2

    with Image.open(io.BytesIO(content), formats=FORMATS) as image:
        mode = image.mode
    if mode in ("L", "RGB"):
        colours = cv2.IMREAD_GRAYSCALE if mode == "L" else cv2.IMREAD_COLOR_RGB
        pixels = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), colours | cv2.IMREAD_IGNORE_ORIENTATION)
        if pixels is not None:
            return np.asarray(pixels)
    return _by_pillow(content)


def _decoded_16bit_png(content: bytes) -> Array:
    from imagecodecs import png_decode  # Pillow reduces 16-bit colour to 8 bits

    pixels = np.asarray(png_decode(content))
    if pixels.ndim == 3:
        pixels = pixels[..., 0] if pixels.shape[2] <= 2 else pixels[..., :3]
    return pixels


def _bits(image: Image.Image, path: Path) -> int:
    if image.format == "PNG":
        with path.open("rb") as file:
            depth = file.read(25)[24]
        return max(depth, 8)  # 1, 2 and 4 bits are expanded to 8
    return 8


def exif_of(image: Image.Image, path: Path) -> Image.Exif:
    """EXIF tags of a photograph.

    Pillow decodes a whole PNG to find tags after its pixels. So a PNG is only opened if it has such tags.
    """
    kinds = [kind for kind, _ in _png_chunks(path)]
    behind = kinds[kinds.index(b"IDAT") :] if b"IDAT" in kinds else []
    return Image.Image.getexif(image) if kinds and not _PNG_TAGS.intersection(behind) else image.getexif()


def is_tiff(path: Path) -> bool:
    """Whether a file has a TIFF's signature."""
    with path.open("rb") as file:
        return file.read(4) in SIGNATURES


def _png_chunks(path: Path) -> Iterator[tuple[bytes, int]]:
    """Type and end, bytes, of each chunk of a PNG. The last chunk may be truncated. Empty for other files."""
    size = path.stat().st_size
    with path.open("rb") as file:
        position, kind = 8, b"" if file.read(8) == _PNG_SIGNATURE else b"IEND"
        while kind != b"IEND" and position <= size:
            file.seek(position)
            header = file.read(8)
            length, kind = struct.unpack(">I4s", header) if len(header) == 8 else (size, b"")
            position += 12 + length
            yield kind, position


def _check_png(content: bytes) -> None:
    """Require correct checksums of all chunks of a PNG.

    Raises:
        ValueError: a checksum is wrong.
    """
    place, kind = len(_PNG_SIGNATURE), b""
    while kind != b"IEND":
        length, kind = struct.unpack_from(">I4s", content, place)
        end = place + 8 + length
        if end + 4 > len(content):
            raise ValueError("it is truncated")
        if zlib.crc32(memoryview(content)[place + 4 : end]) != int.from_bytes(content[end : end + 4], "big"):
            raise ValueError("it is damaged")
        place = end + 4


def _is_truncated(path: Path) -> bool:
    """Whether a JPEG, PNG or TIFF ends before its pixels end."""
    with path.open("rb") as file:
        head = file.read(len(_PNG_SIGNATURE))
    if head.startswith(SIGNATURES):
        with path.open("rb") as file, suppress(Exception):  # tifffile may raise any exception for damaged files
            return tiff_is_truncated(file)
    if head == _PNG_SIGNATURE:
        return max((end for _, end in _png_chunks(path)), default=0) > path.stat().st_size
    if head.startswith(_JPEG_SIGNATURE):
        try:
            check_jpeg(path.read_bytes())
        except DamagedJpegError as error:
            return isinstance(error, TruncatedJpegError)
    return False


def _truncated(name: str) -> ImageError:
    return ImageError(
        name, found="a truncated image", expected="the complete file", remedy="Copy it again from the camera"
    )


def _other_format(path: Path) -> str | None:
    """Name of an image format that is not read here, recognised by its first bytes."""
    with path.open("rb") as file:
        head = file.read(16)
    return next((words for place, mark, words in _OTHER_FORMATS if head[place:].startswith(mark)), None)


def _unreadable(path: Path, name: str, error: BaseException | None, formats: str) -> ImageError:
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
    if isinstance(error, OSError) and error.errno is not None:
        found = f"a file that cannot be read ({error.strerror})"
        return ImageError(name, found=found, expected="a photograph", remedy="Check the path and its links")
    if isinstance(error, (TruncatedJpegError, struct.error)) or _is_truncated(path):
        return _truncated(name)
    if isinstance(error, (DamagedJpegError, DamagedTiffError)):
        remedy = "Copy it again from the camera"
        return ImageError(name, found=f"a damaged image ({error})", expected="an undamaged image", remedy=remedy)
    kind = "a damaged image"
    if isinstance(error, UnidentifiedImageError):
        kind = _other_format(path) or "a file that is not an image"
    remedy = "Copy it again from the camera, or export it again"
    return ImageError(name, found=kind, expected=f"a readable {formats}", remedy=remedy)
