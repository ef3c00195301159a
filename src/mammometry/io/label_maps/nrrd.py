"""Label maps in NRRD files with an attached header, as 3D Slicer and ITK write them.

Format: https://teem.sourceforge.net/nrrd/format.html. The volume of a voxel is the determinant of its space directions,
or else the product of its spacings.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from mammometry.base.parse import number, parsing, read_bytes, shown
from mammometry.base.units import MM_PER_UNIT, unit_named
from mammometry.geometry.arrays import Array, Float64
from mammometry.io.label_maps import voxels
from mammometry.io.label_maps.voxels import LabelMap

SUFFIX = ".nrrd"
_EXPECTED = "a label map in NRRD, header and voxels in one file, raw or gzip"
_MAGIC = re.compile(rb"NRRD000[1-5]\r?\n")
_TYPES: Mapping[str, str] = MappingProxyType(
    {
        name: code
        for code, names in {
            "i1": ("signed char", "int8", "int8_t"),
            "u1": ("uchar", "unsigned char", "uint8", "uint8_t"),
            "i2": ("short", "short int", "signed short", "signed short int", "int16", "int16_t"),
            "u2": ("ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"),
            "i4": ("int", "signed int", "int32", "int32_t"),
            "u4": ("uint", "unsigned int", "uint32", "uint32_t"),
            "f4": ("float",),
            "f8": ("double",),
        }.items()
        for name in names
    }
)
_ANATOMICAL = re.compile(r"(right|left)-(anterior|posterior)-superior(-time)?|(RAS|LPS|LAS)T?", re.IGNORECASE)
_NOT_SPACE = ("none", "???", "list", "vector", "time")
_SEGMENT = re.compile(r"Segment([0-9]+)_(Name|LabelValue|Layer)", re.ASCII)


def read_nrrd(path: Path, units: str | None = None) -> LabelMap:
    """Read a label map. A fourth axis contains layers of segments that overlap.

    Args:
        path: the file.
        units: unit of its lengths, if the file does not state one. Anatomical spaces are in millimetres.

    Raises:
        SessionError: it is not such a file, its unit is unknown, or its values are not labels.
    """
    content = read_bytes(path, str(path), _EXPECTED, most_mib=voxels.LARGEST_MIB)
    with parsing("no label map", str(path), _EXPECTED):
        if not (magic := _MAGIC.match(content)):
            raise ValueError("it does not begin with NRRD and a version")
        end = re.compile(rb"\n\r?\n").search(content, magic.end() - 1)
        if end is None:
            raise ValueError("the header does not end with an empty line")
        fields, pairs = _header(content[magic.end() : end.start()].decode("utf-8", "replace"))
        return _map(fields, pairs, content[end.end() :], units)


def _header(text: str) -> tuple[dict[str, str], dict[str, str]]:
    """Fields of the format, and key–value pairs of the program that wrote it."""
    fields: dict[str, str] = {}
    pairs: dict[str, str] = {}
    for line in text.splitlines():
        if line.startswith("#") or not line.strip():
            continue
        if ":=" in line and ": " not in line.partition(":=")[0]:
            key, _, word = line.partition(":=")
            pairs[key.strip()] = word.strip()
        else:
            key, _, word = line.partition(":")
            fields[key.strip().lower().replace("datafile", "data file")] = word.strip()
    return fields, pairs


def _map(fields: dict[str, str], pairs: dict[str, str], data: bytes, units: str | None) -> LabelMap:
    if fields.get("data file") is not None or any(fields.get(f"{unit} skip", "0") != "0" for unit in ("line", "byte")):
        raise ValueError("its voxels are in another file, or not directly after the header")
    kind = _TYPES.get(fields["type"].lower())
    if kind is None:
        raise ValueError(f"the type {shown(fields['type'])}")
    if kind[1] != "1" and fields.get("endian") not in ("little", "big"):
        raise ValueError("no byte order")
    sizes = [_natural(word) for word in fields["sizes"].split()]
    if len(sizes) != _natural(fields["dimension"]) or not 3 <= len(sizes) <= 4:
        raise ValueError(f"sizes {shown(fields['sizes'])} for {shown(fields['dimension'])} dimensions, not 3 or 4")
    edges, spatial = _edges(fields, len(sizes))
    voxel_mm3 = voxels.checked_voxel_mm3(abs(float(np.linalg.det(edges * _mm_per_unit(fields, units)))))
    code = np.dtype(kind).newbyteorder("<" if fields.get("endian") != "big" else ">")
    encoding = fields["encoding"].lower()
    if encoding not in ("raw", "gzip", "gz"):
        raise ValueError(f"the encoding {shown(encoding)}")
    labels = voxels.whole_labels(voxels.stored_values(data, code, sizes, packed=encoding != "raw"))
    if len(sizes) == 4:
        (layers,) = set(range(4)) - set(spatial)
        labels = np.moveaxis(labels, 3 - layers, 0)
    else:
        labels = labels[None]
    return LabelMap(labels=labels, voxel_mm3=voxel_mm3, names=_names(pairs, len(labels)))


def _edges(fields: dict[str, str], count: int) -> tuple[Float64[Array, "3 3"], list[int]]:
    """Edges of a voxel as rows, in the file's unit, and the axes of the map to which they belong."""
    directions = fields.get("space directions")
    if directions is not None:
        words = re.findall(r"none|\([^)]*\)", directions)
        spatial = [axis for axis, word in enumerate(words) if word != "none"]
        rows = [[number(part.strip()) for part in words[axis].strip("()").split(",")] for axis in spatial]
        if len(words) != count or len(rows) != 3 or any(len(row) != 3 for row in rows):
            raise ValueError(f"space directions {shown(directions)}, not three of three numbers")
        return np.array(rows), spatial
    words = fields.get("spacings", "").split()
    kinds = fields.get("kinds", "").split() or ["domain"] * count
    spatial = [
        axis
        for axis, word in enumerate(words)
        if word.lower() != "nan" and (count == 3 or kinds[axis].lower() not in _NOT_SPACE)
    ]
    if len(words) != count or len(spatial) != 3:
        raise ValueError("neither space directions nor the spacings of three axes")
    return np.diag([number(words[axis]) for axis in spatial]), spatial


def _mm_per_unit(fields: dict[str, str], units: str | None) -> float:
    stated = re.findall(r'"([^"]*)"', fields.get("space units", fields.get("units", "")))
    stated = [unit for unit in stated if unit.strip()]
    if stated:
        names = {unit_named(unit) for unit in stated[:3]}
        name = names.pop()
        if names or name is None:
            raise ValueError(f"the units {shown(' '.join(stated))}")
        return MM_PER_UNIT[name]
    if _ANATOMICAL.fullmatch(fields.get("space", "")) and not (units and unit_named(units)):
        return 1.0
    return voxels.given_mm(units)


def _names(pairs: dict[str, str], layers: int) -> Mapping[str, tuple[int, int]]:
    """Name of a segment → its layer and label, as written by 3D Slicer."""
    segments: dict[str, dict[str, str]] = {}
    for key, word in pairs.items():
        if found := _SEGMENT.fullmatch(key):
            segments.setdefault(found[1], {})[found[2]] = word
    names: dict[str, tuple[int, int]] = {}
    for one in segments.values():
        place = _natural(one.get("Layer", "0")), _natural(one.get("LabelValue", "1"))
        if place[0] >= layers or one.get("Name", "") in names:
            raise ValueError(f"the segment {shown(one.get('Name'))} twice, or in layer {place[0]} of {layers}")
        if "Name" in one:
            names[one["Name"]] = place
    return names


def _natural(word: str) -> int:
    if not re.fullmatch(r"[0-9]{1,9}", word.strip(), re.ASCII):
        raise ValueError(f"{shown(word)}, not a whole number")
    return int(word)
