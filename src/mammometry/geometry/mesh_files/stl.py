"""STL files, binary or text: triangles without colours or unit."""

from __future__ import annotations

import re

import numpy as np

from mammometry.geometry.arrays import Array, Float64, Int64

_HEAD, _COUNT = 80, 4  # bytes of a binary file's header and triangle count
_ROW = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
_VERTEX = re.compile(rb"(?:^|[\r\n])[ \t]*vertex[ \t]+(\S+[ \t]+\S+[ \t]+\S+)", re.IGNORECASE)
_WORD = re.compile(rb"(?:^|[\r\n])[ \t]*facet\b", re.IGNORECASE)


def parse_stl(content: bytes) -> tuple[Float64[Array, "n 3"], Int64[Array, "m 3"]]:
    """Read corners and triangles.

    The count in a binary file may be wrong, so the number of triangles is computed from its length.

    Args:
        content: content of the file.

    Raises:
        ValueError: it is not an STL, or is truncated.
    """
    counted = int.from_bytes(content[_HEAD : _HEAD + _COUNT], "little")
    room, rest = divmod(len(content) - _HEAD - _COUNT, _ROW.itemsize)
    is_text = content.lstrip().lower().startswith(b"solid") and b"\0" not in content
    if is_text or (_is_facets(content) and counted != room):
        return _text(content)
    if room < 0 or (room < counted and rest):
        raise ValueError("it is shorter than its header states")
    count = room if rest == 0 else counted
    corners = np.frombuffer(content, _ROW, count, _HEAD + _COUNT)["corners"].astype(np.float64)
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def _is_facets(content: bytes) -> bool:
    return content.lstrip().lower().startswith(b"solid") and _WORD.search(content, 0, 4096) is not None


def _text(content: bytes) -> tuple[Float64[Array, "n 3"], Int64[Array, "m 3"]]:
    found = _VERTEX.findall(content)
    if len(found) % 3 or len(found) != 3 * len(_WORD.findall(content)):
        raise ValueError("it has facets without three corners")
    return np.array(b" ".join(found).split(), dtype=np.float64).reshape(-1, 3), np.arange(len(found)).reshape(-1, 3)
