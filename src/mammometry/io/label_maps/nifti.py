"""Label maps in NIfTI files of version 1 or 2.

Format: https://nifti.nimh.nih.gov. Header and voxels are in one file, which may be compressed by gzip. The volume of a
voxel is the determinant of the sform, or else the product of the voxel's sizes. If both exist, they must agree.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, TypeAlias

import numpy as np

from mammometry.base.parse import parsing, read_bytes
from mammometry.geometry.arrays import Array
from mammometry.io.label_maps import voxels
from mammometry.io.label_maps.voxels import LabelMap

SUFFIXES = (".nii", ".nii.gz")
_EXPECTED = "a label map in NIfTI: one file .nii or .nii.gz"
_Order: TypeAlias = Literal["<", ">"]
_ORDERS: tuple[_Order, _Order] = ("<", ">")
_GZIP = b"\x1f\x8b"
_VERSIONS: Mapping[int, np.dtype[Any]] = MappingProxyType(
    {
        size: np.dtype(
            {
                "names": [name for name, _, _ in fields],
                "formats": [form for _, form, _ in fields],
                "offsets": [offset for _, _, offset in fields],
                "itemsize": size,
            }
        )
        for size, fields in {
            348: (
                ("dim", "(8,)i2", 40), ("datatype", "i2", 70), ("pixdim", "(8,)f4", 76), ("start", "f4", 108),
                ("slope", "f4", 112), ("shift", "f4", 116), ("units", "u1", 123), ("sform", "i2", 254),
                ("rows", "(3,4)f4", 280), ("magic", "S4", 344),
            ),
            540: (
                ("magic", "S8", 4), ("datatype", "i2", 12), ("dim", "(8,)i8", 16), ("pixdim", "(8,)f8", 104),
                ("start", "i8", 168), ("slope", "f8", 176), ("shift", "f8", 184), ("sform", "i4", 348),
                ("rows", "(3,4)f8", 400), ("units", "i4", 500),
            ),
        }.items()
    }
)  # fmt: skip
"""Size of the header → its fields that are used."""
_MAGICS = (b"n+1", b"n+2\0\r\n\x1a\n")
_TYPES: Mapping[int, str] = MappingProxyType(
    {2: "u1", 4: "i2", 8: "i4", 16: "f4", 64: "f8", 256: "i1", 512: "u2", 768: "u4", 1024: "i8", 1280: "u8"}
)
_UNITS: Mapping[int, float] = MappingProxyType({1: 1000.0, 2: 1.0, 3: 0.001})  # of space: m, mm, µm
_UNIT_BITS = 7  # bits for the unit of space, in a byte that also contains the unit of time
_LATEST = 2**24  # largest first byte of the voxels: extensions of the header come before them
_ALIKE = 0.01  # largest relative difference between a voxel's volume from the sform and from its sizes


def read_nifti(path: Path, units: str | None = None) -> LabelMap:
    """Read a label map.

    Args:
        path: the file.
        units: unit of its lengths, if the file does not state one.

    Raises:
        SessionError: it is not such a file, its unit is unknown, or its values are not labels.
    """
    content = read_bytes(path, str(path), _EXPECTED, most_mib=voxels.LARGEST_MIB)
    with parsing("no label map", str(path), _EXPECTED):
        packed = content.startswith(_GZIP)
        header, order = _header(voxels.unpacked(content, max(_VERSIONS)) if packed else content)
        count, dim = int(header["dim"][0]), [int(size) for size in header["dim"]]
        if not 3 <= count <= 7 or any(size != 1 for size in dim[4 : count + 1]):
            raise ValueError(f"the dimensions {dim[1 : max(1, min(count, 7)) + 1]}, not three")
        kind = _TYPES.get(int(header["datatype"]))
        if kind is None:
            raise ValueError(f"the data type {int(header['datatype'])}")
        code = np.dtype(kind).newbyteorder(order)
        start = float(header["start"])
        if not header.dtype.itemsize <= start <= _LATEST:
            raise ValueError(f"voxels from byte {start:g}")
        values = voxels.stored_values(content, code, dim[1:4], start=int(start), packed=packed)
        return LabelMap(
            labels=_labels(values, float(header["slope"]), float(header["shift"]))[None],
            voxel_mm3=voxels.checked_voxel_mm3(_voxel(header) * _mm_per_unit(header, units) ** 3),
        )


def _header(content: bytes) -> tuple[Any, _Order]:
    """The header, and its byte order."""
    for size, form in _VERSIONS.items():
        for order in _ORDERS:
            if len(content) >= size and int(np.frombuffer(content, f"{order}i4", 1)[0]) == size:
                header = np.frombuffer(content, form.newbyteorder(order), 1)[0]
                if bytes(header["magic"]) not in _MAGICS:
                    raise ValueError(
                        "its voxels are in another file, or it is of ANALYZE 7.5, which has no orientation"
                    )
                return header, order
    raise ValueError("no header of NIfTI")


def _voxel(header: Any) -> float:
    """Volume of a voxel, in cubes of the file's unit."""
    sizes, rows = np.abs(header["pixdim"][1:4].astype(np.float64)), header["rows"][:, :3].astype(np.float64)
    by_sizes = float(np.prod(sizes))
    if int(header["sform"]) <= 0:
        return by_sizes
    if not np.isfinite(rows).all():
        raise ValueError("an sform that is not a number")
    by_sform = abs(float(np.linalg.det(rows)))
    if by_sizes and not abs(by_sform / by_sizes - 1) <= _ALIKE:
        raise ValueError(f"voxels of {by_sform:.4g} by the sform, but of {by_sizes:.4g} by their sizes")
    return by_sform


def _mm_per_unit(header: Any, units: str | None) -> float:
    stated = _UNITS.get(int(header["units"]) & _UNIT_BITS)
    return voxels.given_mm(units) if stated is None else stated


def _labels(values: Array, slope: float, shift: float) -> Array:
    """Labels from stored values: slope × value + shift, or the values themselves if the file has no slope."""
    if not slope or not np.isfinite([slope, shift]).all() or (slope, shift) == (1.0, 0.0):
        return voxels.whole_labels(values)
    return voxels.whole_labels(slope * values.astype(np.float64) + shift)
