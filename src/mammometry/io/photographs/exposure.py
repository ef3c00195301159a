"""Which camera took a photograph, and when. Read from EXIF, without pixels."""

from __future__ import annotations

import datetime
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from mammometry.io.photographs.images import FORMATS, exif_of

_EXIF_IFD = 0x8769  # tag that points to the EXIF directory; EXIF 2.32, 4.6.3
_MAKE, _MODEL = 271, 272  # tags of the camera; TIFF 6.0, section 8
_TAKEN, _FRACTION, _OFFSET, _SERIAL = 0x9003, 0x9291, 0x9011, 0xA431  # EXIF 2.32, table 8
_OFFSET_TEXT = re.compile(r"([+-])(\d\d):(\d\d)")
_LONGEST = 64  # characters of a text that is kept


@dataclass(frozen=True, slots=True, kw_only=True)
class Exposure:
    """Camera and time of a photograph, from its file."""

    serial: str = ""
    """Serial number of the camera's body. Empty if the file does not say."""
    model: str = ""
    """Maker and model of the camera. Empty if the file does not say."""
    taken_s: float | None = None
    """When, by the camera's own clock: seconds since 1970; in UTC only where the camera tells its time zone."""


def read_exposure(path: Path) -> Exposure:
    """Read which camera took a photograph, and when. What is missing, or damaged, is left out.

    Raises:
        OSError: the file cannot be read.
    """
    try:
        with Image.open(path, formats=FORMATS) as image:
            tags = exif_of(image, path)
            about: dict[int, Any] = {**tags.get_ifd(_EXIF_IFD)}
            words = [_text(tags.get(_MAKE)), _text(tags.get(_MODEL))]
    except OSError:
        raise
    except Exception:  # whatever a decoder stumbles over in damaged tags
        return Exposure()
    return Exposure(
        serial=_text(about.get(_SERIAL)),
        model=" ".join(filter(None, words)),
        taken_s=_moment(_text(about.get(_TAKEN)), _text(about.get(_FRACTION)), _text(about.get(_OFFSET))),
    )


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
