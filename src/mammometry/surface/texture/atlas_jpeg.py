"""The picture of a viewing mesh as a JPEG.

It is made once, and the mesh's picture is what it holds: so memory and disk have the same, and the disk has it small.
"""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
from PIL import Image

from mammometry.geometry.arrays import Array, UInt8
from mammometry.surface.texture.texture_atlas import Atlas

_QUALITY = 92  # of the JPEG, 1…100: the viewer's file stays small; chosen by eye
_NO_PICTURE = (0, 0, 3)  # shape of what stands for a picture that its JPEG gives


def as_jpeg(atlas: Atlas) -> Atlas:
    """Give the mesh the picture that its JPEG shows."""
    if atlas.jpeg is not None:
        return atlas
    buffer = io.BytesIO()
    Image.fromarray(np.asarray(atlas.picture)).save(buffer, "JPEG", quality=_QUALITY)
    jpeg = np.frombuffer(buffer.getvalue(), dtype=np.uint8)
    return replace(atlas, jpeg=jpeg, picture=_shown(jpeg))


def jpeg_of(atlas: Atlas) -> bytes:
    """The covering picture as a JPEG."""
    jpeg = as_jpeg(atlas).jpeg
    assert jpeg is not None
    return jpeg.tobytes()


def without_picture(atlas: Atlas) -> Atlas:
    """The mesh with its JPEG only, to be kept."""
    return replace(as_jpeg(atlas), picture=np.zeros(_NO_PICTURE, dtype=np.uint8))


def with_picture(atlas: Atlas) -> Atlas:
    """The mesh with the picture that its JPEG holds.

    Raises:
        OSError: the JPEG is damaged.
    """
    return atlas if atlas.jpeg is None else replace(atlas, picture=_shown(atlas.jpeg))


def _shown(jpeg: UInt8[Array, " b"]) -> UInt8[Array, "h w 3"]:
    return np.asarray(Image.open(io.BytesIO(jpeg.tobytes()), formats=("JPEG",)).convert("RGB"))
