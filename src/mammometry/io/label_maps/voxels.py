"""A label map, and the volume of one of its segments."""

from __future__ import annotations

import gzip
import io
import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.base.errors import SessionError
from mammometry.base.parse import error_text, shown
from mammometry.base.units import MM_PER_UNIT, unit_named
from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Shaped

LARGEST_MIB = 1024
"""Largest file and largest unpacked map, MiB: 512 × 512 × 512 voxels of eight bytes."""
_LISTED = 12  # most labels in a message
_EDGE_MM = (0.01, 50.0)  # smallest and largest edge of a cubic voxel, mm


@value(eq=False)
class LabelMap:
    """Labels of voxels of equal size."""

    labels: Shaped[Array, "layers z y x"]
    """Label of each voxel; 0 is no segment. There are several layers if segments overlap."""
    voxel_mm3: float
    """Volume of a voxel."""
    names: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    """Name of a segment → its layer and label. Empty if the file has no names."""


def label_cc(path: Path, found: LabelMap, segment: str) -> float:
    """Volume of a segment, cc: number of its voxels times their size.

    Args:
        path: the file, for messages.
        found: its content.
        segment: name or label of the segment. Empty: the only one.

    Raises:
        SessionError: there is no such segment, or several, or it has no voxel.
    """
    present = {
        (layer, int(label)) for layer, labels in enumerate(found.labels) for label in np.unique(labels) if label != 0
    }
    if segment in found.names:
        chosen = {found.names[segment]}
    else:
        chosen = {one for one in present | set(found.names.values()) if segment in ("", str(one[1]))}
    if len(chosen) == 1:
        (layer, label) = next(iter(chosen))
        count = int(np.count_nonzero(found.labels[layer] == label))
        if count:
            return count * found.voxel_mm3 / 1000.0
    names = {place: name for name, place in found.names.items()}
    listed = [f"{label} {names.get((layer, label), '')}".strip() for layer, label in sorted(present)]
    known = ", ".join(listed[:_LISTED]) + (", …" if len(listed) > _LISTED else "")
    wanted = f", none or several called {shown(segment)}" if segment else ""
    raise SessionError(
        str(path),
        found=(f"the labels {known}" if listed else "no labelled voxel") + wanted,
        expected="one segment with voxels",
        remedy="Give its number or name in the column segment" if listed else "Export the segmentation again",
    )


def whole_labels(values: Array) -> Array:
    """Convert labels to whole numbers.

    Raises:
        ValueError: some are not whole, as in a map of probabilities.
    """
    if values.dtype.kind in "iu":
        return values
    rounded = np.rint(values)
    if not np.isfinite(values).all() or (rounded != values).any() or np.abs(rounded).max(initial=0.0) > 2**31:
        raise ValueError("values that are not whole numbers, as of an image or a map of probabilities")
    return rounded.astype(np.int64)


def checked_voxel_mm3(volume: float) -> float:
    """Return the volume of a voxel, mm³, if it is plausible.

    Raises:
        ValueError: it is implausible for any scanner.
    """
    low, high = (edge**3 for edge in _EDGE_MM)
    if not low <= volume <= high:
        raise ValueError(f"voxels of {volume:.3g} mm³, not {low:g} to {high:g}: is the unit right?")
    return volume


def stored_values(
    content: bytes, dtype: np.dtype[Any], sizes: Sequence[int], *, start: int = 0, packed: bool = False
) -> Array:
    """Values of all voxels. The axes are in reverse order, because the map's first axis varies fastest.

    Args:
        content: content of the file, or a part of it.
        dtype: type of a value, with its byte order.
        sizes: number of voxels along each axis.
        start: offset of the voxels after decompression, bytes.
        packed: whether `content` is compressed by gzip.

    Raises:
        ValueError: a size is not positive, the map is too large, or the data are truncated.
    """
    size = dtype.itemsize * math.prod(sizes)
    if min(sizes) < 1 or size > LARGEST_MIB * 2**20:
        raise ValueError(f"a size of {' × '.join(map(str, sizes))} voxels, not 1 voxel to {LARGEST_MIB} MiB")
    data = (unpacked(content, start + size) if packed else content)[start : start + size]
    if len(data) < size:
        raise ValueError(f"{len(data):,} bytes of voxels, not {size:,}: it is truncated")
    return np.frombuffer(data, dtype).reshape(sizes[::-1])


def given_mm(units: str | None) -> float:
    """Length of a unit given by the user, mm.

    Raises:
        ValueError: no unit is given, or it is unknown.
    """
    if units is None or (name := unit_named(units)) is None:
        raise ValueError("no unit: give it in the column units")
    return MM_PER_UNIT[name]


def unpacked(content: bytes, size: int) -> bytes:
    """Decompress gzip data, at most `size` bytes.

    Raises:
        ValueError: the data are truncated or damaged.
    """
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(content)) as file:
            return file.read(size)
    except (EOFError, OSError, zlib.error) as error:
        raise ValueError(f"truncated or damaged gzip data: {error_text(error)}") from None
