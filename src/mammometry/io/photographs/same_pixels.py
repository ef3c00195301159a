"""Test whether two files contain the same image, even if renamed, or saved losslessly or without tags.

An image that was compressed again is not recognised. It differs from the original as little as two photographs of a
board at rest differ from each other.
"""

import hashlib
from pathlib import Path

import numpy as np
from PIL import Image

from mammometry.base.photograph import Photograph
from mammometry.geometry.arrays import Array, Float32
from mammometry.io.photographs.images import FORMATS

_DRAFT_PX, _BLOCKS = 128, 16  # size at which a JPEG is decoded, and size of the images that are compared first
_REDUCED_APART = 8.0  # of 255 levels, RMS. A JPEG decoded at reduced size differs by up to 3.2, another pose by 35


def pixels_digest(photograph: Photograph) -> str:
    """SHA-256 of a photograph's size and pixels, hexadecimal."""
    pixels = photograph.pixels
    about = f"{pixels.shape} {pixels.dtype}".encode()
    return hashlib.sha256(about + np.ascontiguousarray(pixels).tobytes()).hexdigest()


def may_be_same(one: Path, other: Path) -> bool:
    """Quick test whether two files may contain the same image. `pixels_digest` then decides.

    Raises:
        OSError: one is not a readable image.
    """
    with Image.open(one, formats=FORMATS) as left, Image.open(other, formats=FORMATS) as right:
        if left.size != right.size:
            return False
        apart = _reduced(left) - _reduced(right)
    return float(np.sqrt(np.mean(apart**2))) < _REDUCED_APART


def _reduced(picture: Image.Image) -> Float32[Array, "h w"]:
    """Means of blocks, grey, 0 to 255. A JPEG is decoded only as far as needed."""
    picture.draft("L", (_DRAFT_PX, _DRAFT_PX))
    wide = picture.mode.startswith("I;16")
    grey = np.asarray(picture if wide else picture.convert("L"), dtype=np.float32) / (257.0 if wide else 1.0)
    small = Image.fromarray(grey).resize((_BLOCKS, _BLOCKS), Image.Resampling.BOX)
    return np.asarray(small, dtype=np.float32)
