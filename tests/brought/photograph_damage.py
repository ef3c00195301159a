"""Photographs in every format, and what cards, cables and disks do to their bytes."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from random import Random

import cv2
import numpy as np
import tifffile
from PIL import Image
from scipy.ndimage import gaussian_filter

Pixels = np.ndarray
WIDE, HIGH = 480, 320


@cache
def picture(seed: int) -> Pixels:
    """A picture (h, w, 3), 8 bit, as rough and as noisy as a photograph."""
    rng = np.random.default_rng(seed)
    coarse = gaussian_filter(rng.normal(size=(HIGH, WIDE)), 30)
    fine = gaussian_filter(rng.normal(size=(HIGH, WIDE)), 2)
    grey = 128 + 45 * coarse / coarse.std() + 12 * fine / fine.std()
    tint = np.array([1.1, 1.0, 0.9]) * grey[..., None] + rng.normal(0, 2.0, (HIGH, WIDE, 3))
    return tint.clip(2, 253).astype(np.uint8)


def jpeg(**options: object) -> Callable[[Pixels], bytes]:
    def encode(pixels: Pixels) -> bytes:
        buffer = io.BytesIO()
        image = Image.fromarray(pixels).convert(str(options.get("mode", "RGB")))
        image.save(buffer, "JPEG", **{name: value for name, value in options.items() if name != "mode"})  # type: ignore[arg-type]
        return buffer.getvalue()

    return encode


def png(bits: int) -> Callable[[Pixels], bytes]:
    def encode(pixels: Pixels) -> bytes:
        return cv2.imencode(".png", pixels if bits == 8 else pixels.astype(np.uint16) * 257)[1].tobytes()

    return encode


def tiff(bits: int = 8, **options: object) -> Callable[[Pixels], bytes]:
    def encode(pixels: Pixels) -> bytes:
        buffer = io.BytesIO()
        stored = pixels if bits == 8 else pixels.astype(np.uint16) * 257
        tifffile.imwrite(buffer, stored, photometric="rgb", metadata=None, rowsperstrip=64, **options)  # type: ignore[arg-type]
        return buffer.getvalue()

    return encode


FORMS: dict[str, Callable[[Pixels], bytes]] = {
    "JPEG": jpeg(quality=92, subsampling=2),
    "JPEG, own tables": jpeg(quality=95, subsampling=0, optimize=True),
    "JPEG, progressive": jpeg(quality=92, progressive=True),
    "JPEG, restarted each row": jpeg(quality=92, restart_marker_rows=1),
    "JPEG, restarted every 7 units": jpeg(quality=92, restart_marker_blocks=7),
    "JPEG, grey": jpeg(mode="L", quality=90),
    "JPEG, inks": jpeg(mode="CMYK", quality=92),
    "PNG": png(8),
    "PNG, 16 bits": png(16),
    "TIFF, JPEG": tiff(compression="jpeg", compressionargs={"level": 92}),
    "TIFF, deflate": tiff(compression="zlib", predictor=True),
    "TIFF, LZW": tiff(compression="lzw", predictor=True),
    "TIFF, packed bits": tiff(compression="packbits"),
    "TIFF": tiff(),
    "TIFF, 16 bits": tiff(16),
}
"""Format of a photograph → what writes it."""


@cache
def written(form: str, seed: int) -> bytes:
    return FORMS[form](picture(seed))


def pixels_at(content: bytes) -> tuple[int, int]:
    """First and last byte of the coded pixels, about: behind the header, before what ends the file."""
    if content.startswith(b"\xff\xd8"):
        return content.index(b"\xff\xda") + 14, len(content) - 2
    if content.startswith(b"\x89PNG"):
        return 41, len(content) - 16
    with tifffile.TiffFile(io.BytesIO(content)) as file:
        page = file.pages.first
        return min(page.dataoffsets) + 640 * (page.compression == 7), max(page.dataoffsets) + page.databytecounts[-1]


Damaged = Callable[[bytes, bytes, Random], bytes]


def place(content: bytes, rng: Random, length: int) -> int:
    begin, end = pixels_at(content)
    return rng.randrange(begin, end - length)


def overwritten(length: int, by: Callable[[bytes, Random, int], bytes]) -> Damaged:
    def change(content: bytes, other: bytes, rng: Random) -> bytes:
        at = place(content, rng, length)
        return content[:at] + by(other, rng, length) + content[at + length :]

    return change


def flipped(content: bytes, other: bytes, rng: Random) -> bytes:
    changed = bytearray(content)
    changed[place(content, rng, 1)] ^= 1 << rng.randrange(8)
    return bytes(changed)


def cut(content: bytes, other: bytes, rng: Random) -> bytes:
    """Cut off, and ended as its format ends."""
    begin, end = pixels_at(content)
    ending = {b"\xff\xd8": 2, b"\x89P": 12}.get(content[:2], 0)
    return content[: begin + int(rng.uniform(0.1, 0.95) * (end - begin))] + (content[-ending:] if ending else b"")


def lost(content: bytes, other: bytes, rng: Random) -> bytes:
    at = place(content, rng, 512)
    return content[:at] + content[at + 512 :]


def from_other(other: bytes, rng: Random, length: int) -> bytes:
    at = place(other, rng, length)
    return other[at : at + length]


@dataclass(frozen=True)
class Damage:
    """What happened to a file."""

    apply: Damaged
    unfound: frozenset[str] = frozenset()
    """Formats that have no means of finding it: pixels without compression or checksum may be anything."""
    sometimes: bool = False
    """Whether codes may stay valid by chance. What is not found then has nearly always changed little."""


_PLAIN = frozenset({"TIFF", "TIFF, 16 bits"})
DAMAGES = {
    "4096 zeros": Damage(overwritten(4096, lambda other, rng, length: bytes(length))),
    "1024 zeros": Damage(overwritten(1024, lambda other, rng, length: bytes(length))),
    "cut": Damage(cut),
    "512 bytes lost": Damage(lost),
    "512 bytes of noise": Damage(
        overwritten(512, lambda other, rng, length: rng.randbytes(length)), _PLAIN, sometimes=True
    ),
    "4096 bytes of another": Damage(overwritten(4096, from_other), _PLAIN, sometimes=True),
    "512 bytes of another": Damage(overwritten(512, from_other), _PLAIN, sometimes=True),
    "a bit": Damage(flipped, _PLAIN | {"TIFF, packed bits"}, sometimes=True),
}


def damaged(form: str, damage: str, number: int) -> bytes:
    """The file, other than it was."""
    rng = Random(f"{form} {damage} {number}")
    whole = written(form, number % 3)
    while (changed := DAMAGES[damage].apply(whole, written(form, 3 + number % 3), rng)) == whole:
        pass
    return changed
