"""JPEG files without their tags.

A picture keeps its pixels as they were coded. Tags name camera, place and time, and sometimes a patient.
"""

from __future__ import annotations

from dataclasses import dataclass

_START, _SCAN, _END = 0xD8, 0xDA, 0xD9  # JPEG markers, ITU-T T.81, table B.1
_BASELINE = 0xC0  # second byte of the marker of a baseline frame (ISO 10918-1, B.1.1.3)
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
_TAGS = {*range(0xE0, 0xF0), 0xFE}  # application segments and comments, table B.1
_KEPT_TAGS = {0xE0, 0xEE}  # JFIF and Adobe: how colours are coded


@dataclass(frozen=True, slots=True, kw_only=True)
class Jpeg:
    """A JPEG without its tags."""

    content: bytes
    size_wh: tuple[int, int]
    components: int
    """3 for colour, 1 for grey."""
    baseline: bool
    """Coded in the plainest of ways, which every program reads."""


def without_tags(data: bytes) -> Jpeg | None:
    """Take tags and comments out of a JPEG.

    Its picture is not coded again. None for any other file, and for other numbers of components.
    """
    place, kept, frame = 2, bytearray(data[:2]), b""
    if data[:2] != bytes([0xFF, _START]):
        return None
    while place + 4 <= len(data) and data[place] == 0xFF:
        marker, length = data[place + 1], int.from_bytes(data[place + 2 : place + 4], "big")
        segment = data[place : place + 2 + length]
        if marker == _SCAN:
            end = data.find(bytes([0xFF, _END]), place)  # of the first picture, where a file holds several
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
