"""Vertex colours of other programs: 0 to 1, 8 bits or 16 bits."""

from __future__ import annotations

import numpy as np

from mammometry.geometry.arrays import Array, Int64, UInt8

_SHARE = 2.0  # largest float on a scale of 0 to 1; on a scale of 0 to 255 it would be black
_OVER = 0.01  # largest share of values above it: a few are defects of exporting programs
_BYTE, _WORD = 255, 65535  # white in 8 and 16 bits


def eight_bit(values: Array, *, whole: bool) -> UInt8[Array, "n 3"]:
    """Colours as 8-bit sRGB.

    Floats are on a scale of 0 to 1, unless more than a few are larger. Integers above 255 are 16-bit levels.

    Args:
        values: values as in the file, (n, 3).
        whole: whether the file contains integers. The array may have another type.
    """
    numbers = np.nan_to_num(np.asarray(values, dtype=np.float64), posinf=0.0, neginf=0.0)
    if not whole and (numbers > _SHARE).mean() <= _OVER:
        scale = float(_BYTE)
    elif whole and numbers.max(initial=0.0) > _BYTE:
        scale = _BYTE / _WORD
    else:
        scale = 1.0
    return np.clip(numbers * scale + 0.5, 0, _BYTE).astype(np.uint8)


def of_vertices(
    faces: Int64[Array, "m 3"], of_faces: UInt8[Array, "m 3"], count: int, grey: int
) -> UInt8[Array, "n 3"]:
    """Mean colour of the faces around each vertex.

    Args:
        faces: triangles.
        of_faces: colour of each triangle.
        count: number of vertices.
        grey: grey level of vertices without a face.
    """
    corners = faces.ravel()
    weight = np.bincount(corners, minlength=count)
    sums = [np.bincount(corners, np.repeat(channel, 3), minlength=count) for channel in of_faces.T.astype(np.float64)]
    mean = np.stack(sums, axis=1) / np.maximum(weight, 1)[:, None]
    return np.where(weight[:, None] > 0, np.round(mean), grey).astype(np.uint8)
