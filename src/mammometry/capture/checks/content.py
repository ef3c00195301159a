"""Whether a file is a photograph and nothing else.

As far as its bytes show without decoding its pixels.

A file can be two things at once: a photograph for a viewer, and an archive, a page or a program for whoever opens it
otherwise. We never hand such bytes out as anything but a photograph, and refuse them all the same.
"""

from __future__ import annotations

from pathlib import Path

_LOOKED_AT = 1 << 16  # bytes at either end: an archive's directory lies within 65,557 of the end (ZIP, APPNOTE 4.3.16)
_BEGIN = (b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n", b"II*\x00", b"MM\x00*")  # JPEG, PNG, TIFF in either byte order
_JPEG, _JPEG_END, _PNG_END = _BEGIN[0], b"\xff\xd9", b"IEND\xaeB`\x82"
_OTHERS = {
    b"PK\x03\x04": "an archive",
    b"PK\x05\x06": "an archive",
    b"Rar!\x1a\x07": "an archive",
    b"7z\xbc\xaf\x27\x1c": "an archive",
    b"%pdf-": "a PDF",
    b"%!ps-": "a PostScript program",
    b"<html": "a web page",
    b"<!doctype": "a web page",
    b"<script": "a web page",
    b"<svg": "a web page",
    b"<?php": "a program",
    b"\x7felf": "a program",
    b"this program cannot be run in dos mode": "a program",
}
"""How other files begin, in small letters, wherever that counts."""
_ANYWHERE = (b"%pdf-", b"<?php", b"<script", b"<html", b"<!doctype", b"<svg")  # what readers seek past the first byte
_HEAD_BYTES = 1024  # in which readers of PDF and browsers look for those


def not_only_a_photograph(path: Path) -> str | None:
    """What else a file is, in two words.

    ``no photograph`` where it is none. None for an ordinary photograph.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(_LOOKED_AT)
        size = file.seek(0, 2)
        file.seek(max(0, size - _LOOKED_AT))
        tail = file.read(_LOOKED_AT)
    if not head.startswith(_BEGIN):
        return "no photograph"
    begin = head[:_HEAD_BYTES].lower()
    for mark in _ANYWHERE:
        if mark in begin:
            return _OTHERS[mark]
    behind = _behind(head, tail).lower()
    return next((what for mark, what in _OTHERS.items() if mark.lower() in behind), None)


def _behind(head: bytes, tail: bytes) -> bytes:
    """What follows the end of the picture.

    A camera may put a second, smaller picture or its own notes there.
    """
    end = _JPEG_END if head.startswith(_JPEG) else _PNG_END if head.startswith(_BEGIN[1]) else b""
    if not end:  # a TIFF's parts lie in any order: only what closes an archive is telling
        return tail[tail.rfind(b"PK\x05\x06") :] if b"PK\x05\x06" in tail else b""
    place = tail.rfind(end)
    closing = tail.rfind(b"PK\x05\x06")
    return tail[min(position for position in (place, closing) if position >= 0) :] if max(place, closing) >= 0 else tail
