"""A small picture of a photograph, drawn again.

Nothing of the sender's bytes is in it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from mammometry.base.photograph import Photograph
from mammometry.clinic.models import Upload

_LONGEST_PX, _QUALITY = 480, 75  # of a picture of about 20 kB; chosen by eye


def thumbnail_path(upload: Upload) -> Path:
    """Where the small picture of an upload lies."""
    return upload.path.with_suffix(".webp")


def write_thumbnail(photograph: Photograph, path: Path) -> None:
    """Write it as WebP."""
    pixels = photograph.pixels
    shift = 8 * (pixels.dtype.itemsize - 1)
    step = max(1, max(photograph.size_wh) // (2 * _LONGEST_PX))  # the rest is done well by Pillow
    small_picture(Image.fromarray(np.ascontiguousarray((pixels[::step, ::step] >> shift).astype(np.uint8))), path)


def small_picture(picture: Image.Image, path: Path) -> None:
    """Write a picture that Pillow has open.

    Of a JPEG only as much is decoded as that needs.
    """
    picture.draft("RGB", (_LONGEST_PX, _LONGEST_PX))
    picture.thumbnail((_LONGEST_PX, _LONGEST_PX))
    small = picture if picture.mode in ("L", "RGB") else picture.convert("RGB")
    small.save(path, format="WEBP", quality=_QUALITY)
