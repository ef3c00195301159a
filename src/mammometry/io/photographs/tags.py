"""EXIF data of photographs (camera, time), and JPEGs without metadata."""

import datetime
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from mammometry.io.photographs.images import FORMATS, exif_of

EXIF_IFD = 0x8769
"""Tag that points to the EXIF directory; EXIF 2.32, 4.6.3."""
_MAKE, _MODEL = 271, 272  # tags of the camera; TIFF 6.0, section 8
_TAKEN, _FRACTION, _OFFSET, _SERIAL = 0x9003, 0x9291, 0x9011, 0xA431  # EXIF 2.32, table 8
_OFFSET_TEXT = re.compile(r"([+-])(\d\d):(\d\d)")
_LONGEST = 64  # largest number of characters in a text


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotographTags:
    """Camera and time of a photograph, from its metadata."""

    serial: str = ""
    """Serial number of the camera body. Empty if not in the file's metadata."""
    model: str = ""
    """Make and model of the camera. Empty if not in the file's metadata."""
    taken_s: float | None = None
    """Time by the camera's clock, seconds since 1970; in UTC only if the camera records its time zone."""


def read_exposure(path: Path) -> PhotographTags:
    """Read the camera and time of a photograph. Missing or damaged tags are left empty.

    Raises:
        OSError: the file cannot be read.
    """
    try:
        with Image.open(path, formats=FORMATS) as image:
            tags = exif_of(image, path)
            about: dict[int, Any] = {**tags.get_ifd(EXIF_IFD)}
            model = camera_model(tags)
    except OSError:
        raise
    except Exception:  # damaged tags may raise any exception
        return PhotographTags()
    return PhotographTags(
        serial=_text(about.get(_SERIAL)),
        model=model,
        taken_s=_moment(_text(about.get(_TAKEN)), _text(about.get(_FRACTION)), _text(about.get(_OFFSET))),
    )


def camera_model(tags: Image.Exif) -> str:
    """Make and model of the camera. Empty if not in the tags."""
    return " ".join(filter(None, [_text(tags.get(_MAKE)), _text(tags.get(_MODEL))]))


def _text(value: object) -> str:
    """A tag's text, short and printable."""
    if isinstance(value, bytes):
        value = value.decode("ascii", "replace")
    text = value.replace("\x00", " ") if isinstance(value, str) else ""
    return "".join(character for character in text if character.isprintable()).strip()[:_LONGEST]


def _moment(taken: str, fraction: str, offset: str) -> float | None:
    try:
        moment = datetime.datetime.strptime(taken, "%Y:%m:%d %H:%M:%S").replace(tzinfo=datetime.UTC).timestamp()
    except ValueError:
        return None
    if fraction.isdecimal() and fraction.isascii():
        moment += int(fraction) / 10 ** len(fraction)
    if (zone := _OFFSET_TEXT.fullmatch(offset)) is not None:
        minutes = 60 * int(zone[2]) + int(zone[3])
        moment -= 60 * (minutes if zone[1] == "+" else -minutes)
    return moment


_START, _SCAN, _END = 0xD8, 0xDA, 0xD9  # JPEG markers, ITU-T T.81, table B.1
_BASELINE = 0xC0  # second byte of the marker of a baseline frame (ISO 10918-1, B.1.1.3)
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
_TAGS = {*range(0xE0, 0xF0), 0xFE}  # application segments and comments, table B.1
_KEPT_TAGS = {0xE0, 0xEE}  # JFIF and Adobe: colour coding


@dataclass(frozen=True, slots=True, kw_only=True)
class Jpeg:
    """A JPEG without metadata."""

    content: bytes
    size_wh: tuple[int, int]
    components: int
    """3 for colour, 1 for grey."""
    baseline: bool
    """Whether it is baseline, which every program reads."""


def without_tags(data: bytes) -> Jpeg | None:
    """Remove tags and comments from a JPEG without compressing it again.

    None for other files, and for other numbers of components than 1 and 3.
    """
    place, kept, frame = 2, bytearray(data[:2]), b""
    if data[:2] != bytes([0xFF, _START]):
        return None
    while place + 4 <= len(data) and data[place] == 0xFF:
        marker, length = data[place + 1], int.from_bytes(data[place + 2 : place + 4], "big")
        segment = data[place : place + 2 + length]
        if marker == _SCAN:
            end = data.find(bytes([0xFF, _END]), place)  # of the first image, if there are several
            if end < 0 or len(frame) < 10 or frame[9] not in (1, 3):
                return None
            kept += data[place : end + 2]
            height, width = int.from_bytes(frame[5:7], "big"), int.from_bytes(frame[7:9], "big")
            return Jpeg(
                content=bytes(kept), size_wh=(width, height), components=frame[9], baseline=frame[1] == _BASELINE
            )
        if marker in _FRAMES:
            frame = segment
        if marker not in _TAGS - _KEPT_TAGS:
            kept += segment
        place += 2 + length
    return None
