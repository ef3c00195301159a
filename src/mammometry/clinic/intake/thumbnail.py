"""Smaller pictures of a photograph, drawn again. Nothing of the sender's bytes is in them."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from PIL import Image

from mammometry.base.photograph import Photograph
from mammometry.clinic.models import Upload

_LONGEST_PX, _QUALITY = 480, 75  # of a picture of about 20 kB; chosen by eye
_SCREEN_PX, _SCREEN_QUALITY = 1600, 85  # of a picture that fills a screen, about 200 kB; chosen by eye


def thumbnail_path(upload: Upload) -> Path:
    """Where the small picture of an upload lies."""
    return upload.path.with_suffix(".webp")


def write_thumbnail(photograph: Photograph, path: Path) -> None:
    """Write it as WebP."""
    small_picture(_roughly(photograph, _LONGEST_PX), path)


def screen_picture(photograph: Photograph) -> bytes:
    """WebP that fills a screen."""
    picture = _roughly(photograph, _SCREEN_PX)
    picture.thumbnail((_SCREEN_PX, _SCREEN_PX))
    buffer = io.BytesIO()
    picture.save(buffer, format="WEBP", quality=_SCREEN_QUALITY)
    return buffer.getvalue()


def _roughly(photograph: Photograph, longest_px: int) -> Image.Image:
    """A picture of at least twice that size, 8 bit. The rest is done well by Pillow."""
    pixels = photograph.pixels
    shift = 8 * (pixels.dtype.itemsize - 1)
    step = max(1, max(photograph.size_wh) // (2 * longest_px))
    return Image.fromarray(np.ascontiguousarray((pixels[::step, ::step] >> shift).astype(np.uint8)))


def small_picture(picture: Image.Image, path: Path) -> None:
    """Write a picture that Pillow has open. Of a JPEG only as much is decoded as that needs."""
    picture.draft("RGB", (_LONGEST_PX, _LONGEST_PX))
    picture.thumbnail((_LONGEST_PX, _LONGEST_PX))
    small = picture if picture.mode in ("L", "RGB") else picture.convert("RGB")
    small.save(path, format="WEBP", quality=_QUALITY)
