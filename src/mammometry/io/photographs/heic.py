"""Read telephones' HEIC photographs, decoded by libheif through pi-heif, which cannot encode."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mammometry.base.extras import require
from mammometry.base.parse import LimitSettings
from mammometry.base.photograph import Photograph
from mammometry.io.photographs.images import HEIC_MARKS, check_size, reading

HEIC_EXTENSIONS = (".heic", ".heif")


def is_heic(path: Path) -> bool:
    """Whether a file has a HEIC's signature."""
    with path.open("rb") as file:
        return file.read(12)[4:] in HEIC_MARKS


def read_heic(path: Path, name: str, limits: LimitSettings = LimitSettings()) -> Photograph:
    """Read a HEIC photograph with 8 bits per channel, upright.

    The format itself rotates the picture, so the orientation in the EXIF data is ignored, as the standard requires
    (ISO/IEC 23008-12). Damaged bytes cannot be detected, because the format has no checksum.

    Args:
        path: the file.
        name: its name in messages.
        limits: largest size.

    Raises:
        MissingLibraryError: the extra `heic` is not installed.
        ImageError: it is missing, unreadable, truncated or too large.
    """
    require("heic", "pi_heif")
    import pi_heif

    with reading(path, name, "HEIC"):
        picture = pi_heif.open_heif(path, convert_hdr_to_8bit=True)
        check_size(picture.size, name, limits)
        pixels = np.array(picture.to_pillow())  # copied, because `np.asarray(picture)` becomes invalid with the picture
    return Photograph(name=name, pixels=np.ascontiguousarray(pixels[..., :3]) if pixels.ndim == 3 else pixels)
