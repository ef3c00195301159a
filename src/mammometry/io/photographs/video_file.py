"""Container of a telephone's video: MP4 or QuickTime (ISO/IEC 14496-12), read without decoding it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import BinaryIO

from mammometry.base.errors import ImageError

VIDEO_EXTENSIONS = (".mp4", ".mov", ".m4v")
"""Extensions of telephones' videos, in any case."""
_BRANDS = (b"qt  ", b"iso", b"mp4", b"M4V", b"avc1", b"3gp", b"3g2", b"MSNV", b"XAVC")
"""Beginnings of a video's major brand (mp4ra.org). Pictures (HEIC, AVIF) and sound have others."""
_HEAD_BYTES = 12  # size and type of the first box, and its major brand
_BOX_BYTES, _LONG_BOX_BYTES = 8, 16  # header of a box; of one with a 64-bit size
_TO_THE_END, _IS_LONG = 0, 1  # sizes with a special meaning (ISO/IEC 14496-12, 4.2)


def is_video(path: Path) -> bool:
    """Whether a file starts like a telephone's video. Its name does not matter.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    return head[4:8] == b"ftyp" and head[8:].startswith(_BRANDS)


def require_whole(path: Path, name: str) -> None:
    """Refuse a file that is not a video, or only the first part of one.

    Playlists and other text files are refused as well: their decoders would open further files.

    Args:
        path: the file.
        name: its name in messages.

    Raises:
        ImageError: it is of another format, ends within a box, or has no table of frames.
    """
    try:
        if not is_video(path):
            raise ImageError(
                name,
                found="not a video, or one of another format",
                expected="an MP4 or MOV from a telephone",
                remedy="Send the telephone's original file",
            )
        with path.open("rb") as file:
            types, is_cut = _boxes(file)
    except OSError:
        raise ImageError(
            name, found="a file that cannot be read", expected="a video", remedy="Copy it again from the telephone"
        ) from None
    if is_cut or b"moov" not in types:
        raise ImageError(
            name,
            found="only the first part of a video",
            expected="the whole file",
            remedy="Copy it again from the telephone, and wait until it is finished",
        )


def _boxes(file: BinaryIO) -> tuple[set[bytes], bool]:
    """Types of the top-level boxes, and whether the last one is truncated."""
    end, start = file.seek(0, os.SEEK_END), 0
    types: set[bytes] = set()
    while end - start >= _BOX_BYTES:
        file.seek(start)
        head = file.read(_LONG_BOX_BYTES)
        size, least = int.from_bytes(head[:4], "big"), _BOX_BYTES
        if size == _TO_THE_END:
            size = end - start
        elif size == _IS_LONG:
            size, least = int.from_bytes(head[8:], "big"), _LONG_BOX_BYTES
        if size < least:
            break  # bytes after the last box
        types.add(head[4:8])
        start += size
    return types, start > end
