"""Long arrays of neighbouring numbers, laid out so that deflate shortens them.

A mesh's vertices lie on multiples of 1/1024 mm, and each vertex and face is near the one before it. Their differences
are small whole numbers. Written byte by byte, first all lowest bytes, they take half the room. Nothing is lost: an
array that would come back with other bits stays as it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mammometry.geometry.arrays import Array, UInt8

_LEAST = 1 << 12  # numbers of an array that is worth it
_PER_UNIT = 1024.0  # steps of positions, 1/mm
_LARGEST = 2.0**30  # whole number whose differences fit 32 bits


def packed(array: Array) -> tuple[UInt8[Array, "4 n"], dict[str, Any]] | None:
    """Lay an array out, and say what `unpacked` needs.

    None where nothing is gained, or where it would come back with other bits.
    """
    if array.size < _LEAST or array.dtype not in (np.int32, np.float64) or not array.flags.c_contiguous:
        return None
    per_unit = _PER_UNIT if array.dtype == np.float64 else 1.0
    scaled = array * per_unit
    if not (np.abs(scaled) < _LARGEST).all():  # not where NaN either
        return None
    whole = scaled.astype(np.int32)
    if per_unit != 1.0 and (whole.astype(np.float64) / per_unit).tobytes() != array.tobytes():
        return None
    steps = whole.copy()
    steps[1:] -= whole[:-1]
    folded = ((steps << 1) ^ (steps >> 31)).astype("<i4")  # 0, −1, 1, −2 … become 0, 1, 2, 3 …
    planes = np.ascontiguousarray(folded.reshape(-1).view(np.uint8).reshape(-1, 4).T)
    return planes, {"dtype": array.dtype.str, "shape": list(array.shape), "per_unit": per_unit}


def unpacked(planes: UInt8[Array, "4 n"], about: Mapping[str, Any]) -> Array:
    """Bring back what `packed` laid out.

    Raises:
        ValueError: the bytes do not fit what is said of them.
    """
    folded = np.ascontiguousarray(planes.T).view("<u4").reshape(about["shape"])
    steps = (folded >> np.uint32(1)).astype(np.int32) ^ -(folded & np.uint32(1)).astype(np.int32)
    whole = np.add.accumulate(steps, axis=0, dtype=np.int32)
    per_unit = float(about["per_unit"])
    values = whole if per_unit == 1.0 else whole / per_unit
    return values.astype(about["dtype"], copy=False)
