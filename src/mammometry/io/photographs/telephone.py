"""Read pictures taken with a telephone, and how they were taken: camera, lens, mode and orientation.

Photographs of one walk share a lens, which is fixed to the sensor. So they are read as the sensor recorded them, and
all are rotated by the same angle.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from mammometry.base.extras import require
from mammometry.base.parse import LimitSettings
from mammometry.base.photograph import Photograph
from mammometry.io.photographs.heic import is_heic, read_heic
from mammometry.io.photographs.images import (
    FORMATS,
    TRANSPOSED,
    check_size,
    exif_of,
    read_header,
    read_photograph,
    reading,
    turned_upright,
)
from mammometry.io.photographs.tags import EXIF_IFD, camera_model
from mammometry.walk.inputs import Mode, PictureFacts

_ORIENTATION = 274  # TIFF 6.0, section 8; also of the EXIF data of a HEIC
_EXPOSURE_S, _CUSTOM_RENDERED, _ZOOM = 0x829A, 0xA401, 0xA404  # EXIF 2.32, table 8
_FOCAL_MM, _FOCAL_35 = 0x920A, 0xA405
_MODES: dict[int, Mode] = {6: "panorama", 7: "portrait", 8: "portrait"}
"""Apple's values of CustomRendered (exiftool.org/TagNames/EXIF.html). Values 2 to 4 (HDR) are ordinary pictures."""
_PANORAMA_MARK = b"GPano:"  # namespace of panoramas in XMP (developers.google.com/streetview/spherical-metadata)
_MOST_ORIENTATION = 8  # EXIF 2.32, 4.6.4
_HEAD_BYTES = 1 << 18  # XMP of a JPEG is in its first segments, of 64 KiB each
_LUMA_STEPS = 3688.0  # sum of the 64 quantisation steps at quality 50 (ITU-T T.81, table K.1)
_BACK = {6: 8, 8: 6}
"""Orientation → the one that undoes it. All others undo themselves."""
_UNMIRRORED = {2: 1, 4: 3, 5: 8, 7: 6}
"""Orientation of a mirrored picture → the same without mirroring."""


def read_facts(path: Path, name: str, limits: LimitSettings = LimitSettings()) -> PictureFacts:
    """Read how a picture was taken. Damaged tags count as missing.

    Args:
        path: a JPEG, PNG, TIFF or HEIC.
        name: its name in messages.
        limits: largest size.

    Raises:
        MissingLibraryError: a HEIC, and the extra `heic` is not installed.
        ImageError: it is missing, unreadable or too large.
    """
    if is_heic(path):
        return _heic_facts(path, name, limits)
    header = read_header(path, name, limits)
    try:
        with Image.open(path, formats=FORMATS) as image:
            is_png, exif, quality = image.format == "PNG", exif_of(image, path), _jpeg_quality(image)
    except Exception:  # a TIFF that Pillow cannot read, but tifffile can
        is_png, exif, quality = False, Image.Exif(), None
    facts = _facts(header.stored_wh, header.orientation, exif, path, is_png=is_png)
    return replace(facts, jpeg_quality=quality)


def _jpeg_quality(image: Image.Image) -> float | None:
    """Quality of a JPEG on libjpeg's scale, from its quantisation of brightness. None for other formats."""
    steps = getattr(image, "quantization", {}).get(0)
    if not steps:
        return None
    coarse = sum(steps) / _LUMA_STEPS
    return 100.0 - 50.0 * coarse if coarse < 1.0 else 50.0 / coarse


def read_from_sensor(path: Path, name: str, orientation: int, limits: LimitSettings = LimitSettings()) -> Photograph:
    """Read a picture as the sensor recorded it, and rotate it by a given orientation.

    Args:
        path: a JPEG, PNG, TIFF or HEIC.
        name: its name in messages.
        orientation: EXIF orientation to use instead of the picture's own. Mirroring is ignored.
        limits: largest size.

    Raises:
        MissingLibraryError: a HEIC, and the extra `heic` is not installed.
        ImageError: it is missing, unreadable or too large.
    """
    if is_heic(path):
        pixels, own = read_heic(path, name, limits).pixels, read_facts(path, name, limits).orientation
        pixels = turned_upright(pixels, _BACK.get(own, own))
    else:
        pixels = read_photograph(path, name, limits, as_stored=True).pixels
    turned = turned_upright(pixels, _UNMIRRORED.get(orientation, orientation))
    return Photograph(name=name, pixels=np.ascontiguousarray(turned))


def _heic_facts(path: Path, name: str, limits: LimitSettings) -> PictureFacts:
    require("heic", "pi_heif")
    import pi_heif

    with reading(path, name, "HEIC"):
        picture = pi_heif.open_heif(path, convert_hdr_to_8bit=True)  # decoded when its pixels are read
        check_size(picture.size, name, limits)
        width, height = picture.size
        exif = Image.Exif()
        exif.load(picture.info.get("exif") or b"")
    own = exif.get(_ORIENTATION)
    orientation = own if isinstance(own, int) and 1 <= own <= _MOST_ORIENTATION else 1
    return _facts(
        (height, width) if orientation in TRANSPOSED else (width, height), orientation, exif, path, is_png=False
    )


def _facts(stored_wh: tuple[int, int], orientation: int, exif: Image.Exif, path: Path, *, is_png: bool) -> PictureFacts:
    try:
        about: dict[int, Any] = {**exif.get_ifd(EXIF_IFD)}
        model = camera_model(exif)
    except Exception:  # damaged tags may raise any exception
        about, model = {}, ""
    with path.open("rb") as file:
        is_panorama = _PANORAMA_MARK in file.read(_HEAD_BYTES)
    rendered = int(_number(about.get(_CUSTOM_RENDERED)) or 0)
    return PictureFacts(
        stored_wh=stored_wh,
        orientation=orientation,
        is_png=is_png,
        model=model,
        focal_mm=_positive(about.get(_FOCAL_MM)),
        focal_35_mm=_positive(about.get(_FOCAL_35)),
        zoom=_positive(about.get(_ZOOM)),
        exposure_s=_positive(about.get(_EXPOSURE_S)),
        mode="panorama" if is_panorama else _MODES.get(rendered, ""),
    )


def _number(tag: object) -> float | None:
    try:
        number = float(tag)  # type: ignore[arg-type]  # a tag may be anything
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None
    return number if np.isfinite(number) else None


def _positive(tag: object) -> float | None:
    """A tag as a positive number. In EXIF, 0 means unknown."""
    number = _number(tag)
    return number if number is not None and number > 0 else None
