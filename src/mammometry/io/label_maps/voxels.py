"""A label map, and the volume of one of its segments."""

from __future__ import annotations

import gzip
import io
import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import field
from pathlib import Path

import numpy as np

from mammometry.base.errors import SessionError
from mammometry.base.parse import error_text, shown
from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Shaped

LARGEST_MIB = 1024
"""Largest file and largest map, MiB: 512 × 512 × 512 voxels of eight bytes."""
_LISTED = 12  # labels in a message at most
_EDGE_MM = (0.01, 50.0)  # smallest and largest edge of a cubic voxel, mm


@value(eq=False)
class LabelMap:
    """Labels of voxels of equal size."""

    labels: Shaped[Array, "layers z y x"]
    """Label of each voxel. Several layers if segments overlap. 0: none."""
    voxel_mm3: float
    names: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    """Name of a segment → its layer and label. Empty: the file has no names."""


def label_cc(path: Path, found: LabelMap, segment: str) -> float:
    """Volume of a segment, cc: number of its voxels times their size.

    Args:
        path: of the file, for messages.
        found: its content.
        segment: name or label. Empty: the only one.

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


def whole_labels(values: Shaped[Array, " n"]) -> Shaped[Array, " n"]:
    """Labels as whole numbers.

    Raises:
        ValueError: some are not, as in a map of probabilities.
    """
    if values.dtype.kind in "iu":
        return values
    rounded = np.rint(values)
    if not np.isfinite(values).all() or (rounded != values).any() or np.abs(rounded).max(initial=0.0) > 2**31:
        raise ValueError("values that are not whole numbers, as of an image or a map of probabilities")
    return rounded.astype(np.int64)


def checked_voxel_mm3(volume: float) -> float:
    """Volume of a voxel, mm³.

    Raises:
        ValueError: it is not within any scanner's range.
    """
    low, high = (edge**3 for edge in _EDGE_MM)
    if not low <= volume <= high:
        raise ValueError(f"voxels of {volume:.3g} mm³, not {low:g} to {high:g}: is the unit right?")
    return volume


def checked_bytes(sizes: Sequence[int], voxel_bytes: int) -> int:
    """Number of bytes of a map with these sizes, at so many bytes a voxel.

    Raises:
        ValueError: a size is not positive, or the map is too large.
    """
    count = voxel_bytes * math.prod(sizes)
    if min(sizes) < 1 or count > LARGEST_MIB * 2**20:
        raise ValueError(f"a size of {' × '.join(map(str, sizes))} voxels, not 1 voxel to {LARGEST_MIB} MiB")
    return count


def unpacked(content: bytes, size: int) -> bytes:
    """Unpack gzip data, up to this many bytes.

    Raises:
        ValueError: it is truncated or damaged.
    """
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(content)) as file:
            return file.read(size)
    except (EOFError, OSError, zlib.error) as error:
        raise ValueError(f"truncated or damaged gzip data: {error_text(error)}") from None
