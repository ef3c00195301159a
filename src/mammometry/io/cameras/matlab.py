"""Cameras of MATLAB's Computer Vision Toolbox, in a MAT-file of version 5 to 7.

Only MATLAB can read its own objects: ``toStruct`` converts them to structures. Pixels are counted from 1, at their
centres. ``IntrinsicMatrix`` and ``Rotation…`` apply to row vectors, so they are the transposes of ours. SciPy's reader
is not used, because it crashes on some damaged files. The format is documented in MathWorks' "MAT-File Format", chapter
"Level 5".
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from mammometry.base.errors import SessionError
from mammometry.base.parse import DEEPEST, numbers, parsing, read_bytes, shown
from mammometry.geometry.camera import Camera
from mammometry.io.cameras.own import READERS, camera_from_entry, pair_of_two, unfit

Variable: TypeAlias = Any
"""An array of numbers, text, a structure as a dictionary, a list of cells or structures, or `OBJECT`."""
OBJECT: Final = object()
"""Placeholder for types that only MATLAB can read: objects, functions, sparse matrices."""
_HEAD_BYTES = 128
_MOST_BYTES = 256 << 20  # decompressed: a calibration with all image points takes a few MiB
_MATRIX, _PACKED = 14, 15  # types of elements
_CELL, _STRUCT, _CHAR, _DOUBLE, _UINT64 = 1, 2, 4, 6, 15  # classes of arrays; numeric classes are between the last two
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8", 16: "u1"}
"""Type of an element → NumPy's name."""
_ENCODINGS = {1: "utf-8", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}


def read_variables(content: bytes) -> dict[str, Variable]:
    """Read all variables of a MAT-file.

    Raises:
        ValueError: it is not a MAT-file, or is damaged.
    """
    mark = content[126:_HEAD_BYTES]
    if mark not in (b"IM", b"MI"):
        raise ValueError("no header of a MAT-file of version 5 to 7")
    reader = _Reader(order="<" if mark == b"IM" else ">")
    try:
        return dict(reader.variables(content[_HEAD_BYTES:]))
    except (struct.error, zlib.error, UnicodeDecodeError) as error:
        raise ValueError(str(error)) from None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Reader:
    order: Literal["<", ">"]
    """Byte order, as in `struct`."""

    def variables(self, content: bytes) -> Iterator[tuple[str, Variable]]:
        for kind, data in self._elements(content):
            if kind == _PACKED:
                unpacking = zlib.decompressobj()
                unpacked = unpacking.decompress(data, _MOST_BYTES)
                if unpacking.unconsumed_tail:
                    raise ValueError(f"a variable of more than {_MOST_BYTES >> 20} MiB")
                yield from self.variables(unpacked)
            elif kind == _MATRIX:
                yield self._array(data, 0)

    def _elements(self, content: bytes) -> Iterator[tuple[int, bytes]]:
        """Type and data of each element in turn."""
        place = 0
        while place < len(content):
            kind, size = struct.unpack_from(f"{self.order}II", content, place)
            start = place + 8
            if kind >> 16:  # a small element has type and length in four bytes, and data in the next four
                kind, size, start = kind & 0xFFFF, kind >> 16, place + 4
                place += 8
            else:
                place = start + size + (0 if kind == _PACKED else -size % 8)
            if start + size > len(content):
                raise ValueError("a truncated file")
            yield kind, content[start : start + size]

    def _array(self, content: bytes, depth: int) -> tuple[str, Variable]:
        if depth > DEEPEST:
            raise ValueError(f"nested more than {DEEPEST} deep")
        if not content:
            return "", np.zeros((0, 0))
        parts = self._elements(content)
        flags, _ = struct.unpack_from(f"{self.order}II", self._next(parts)[1])
        kind = flags & 0xFF
        if not (kind in (_CELL, _STRUCT, _CHAR) or _DOUBLE <= kind <= _UINT64):
            return "an object", OBJECT
        shape = tuple(self._numbers(*self._next(parts)).astype(int).tolist())
        name = self._next(parts)[1].decode("ascii")
        if kind == _CHAR:
            return name, self._text(*self._next(parts))
        if kind == _CELL:
            return name, [self._array(data, depth + 1)[1] for _, data in parts]
        if kind == _STRUCT:
            tables = self._structures(parts, depth)
            return name, tables[0] if len(tables) == 1 else tables
        values = self._numbers(*self._next(parts))
        if min(shape) < 0 or np.prod(shape, dtype=float) != len(values):
            raise ValueError(f"{len(values)} values in a matrix of {' × '.join(map(str, shape))}")
        return name, values.reshape(shape, order="F")

    def _structures(self, parts: Iterator[tuple[int, bytes]], depth: int) -> list[dict[str, Variable]]:
        length = int(self._numbers(*self._next(parts))[0])
        text = self._next(parts)[1]
        if length < 1:
            raise ValueError("field names without letters")
        names = [text[place : place + length].split(b"\0")[0].decode("ascii") for place in range(0, len(text), length)]
        values = [self._array(data, depth + 1)[1] for _, data in parts]
        return [dict(zip(names, values[place:], strict=False)) for place in range(0, len(values), max(1, len(names)))]

    def _numbers(self, kind: int, data: bytes) -> np.ndarray[Any, Any]:
        if kind not in _NUMBERS:
            raise ValueError(f"numbers of unknown type {kind}")
        return np.frombuffer(data, dtype=np.dtype(_NUMBERS[kind]).newbyteorder(self.order)).astype(np.float64)

    def _text(self, kind: int, data: bytes) -> str:
        if kind not in _ENCODINGS:
            raise ValueError(f"text of unknown type {kind}")
        wide = {"utf-16": "utf-16-", "utf-32": "utf-32-"}.get(_ENCODINGS[kind])
        return data.decode(f"{wide}{'le' if self.order == '<' else 'be'}" if wide else _ENCODINGS[kind])

    @staticmethod
    def _next(parts: Iterator[tuple[int, bytes]]) -> tuple[int, bytes]:
        part = next(parts, None)
        if part is None:
            raise ValueError("a truncated variable")
        return part


_EXPECTED = "a structure of stereoParameters, or of cameraParameters with rotationMatrix and translationVector"
_MOST_MIB = 64  # including all image points of the board
_HDF5 = b"MATLAB 7.3 MAT-file"
_MM = {
    **dict.fromkeys(("mm", "millimeters", "millimetres", ""), 1.0),
    **dict.fromkeys(("cm", "centimeters", "centimetres"), 10.0),
    **dict.fromkeys(("m", "meters", "metres"), 1000.0),
    **dict.fromkeys(("in", "inches"), 25.4),
}
_FROM_ONE = 1.0  # px: the first pixel's centre is at 1
_AS_STRUCT = "In MATLAB: s = toStruct(stereoParams); save('rig.mat', 's', '-v7')"


@READERS.add(".mat")
def read_matlab(path: Path, pair_names: Mapping[str, tuple[str, str]]) -> dict[str, Camera]:
    """Read a pair of cameras, or one camera that is named by the file.

    The world is the frame of the pair's first camera. For a single camera, it is the board's frame, from
    ``rotationMatrix`` and ``translationVector`` returned by ``extrinsics``.

    Raises:
        SessionError: it contains objects or other structures, or an impossible lens or unit.
    """
    variables = _variables(path)
    structures = [value for value in variables.values() if isinstance(value, Mapping)]
    pairs = [value for value in structures if "CameraParameters1" in value]
    names: tuple[str, ...]
    singles = [value for value in structures if {"IntrinsicMatrix", "K"} & set(value)]
    if len(pairs) == 1:
        pair = pair_of_two(pair_names)
        if pair is None:
            found = f"a pair of cameras for a session of {len(pair_names)} pairs"
            raise unfit(path.name, found, "a session of one pair, or a file for each camera")
        names, stereo = pair, pairs[0]
        lenses = [_part(path, stereo, "CameraParameters1"), _part(path, stereo, "CameraParameters2")]
        turned, moved = _part(path, stereo, "RotationOfCamera2"), _part(path, stereo, "TranslationOfCamera2")
        poses: list[tuple[Any, Any]] = [(np.eye(3), np.zeros(3)), (turned, moved)]
    elif len(singles) == 1:
        names, lenses = (path.stem,), singles
        if not {"rotationMatrix", "translationVector"} <= set(variables):
            raise unfit(path.name, "one camera without its pose in the rig", _EXPECTED)
        poses = [(variables["rotationMatrix"], variables["translationVector"])]
    elif any(value is OBJECT for value in variables.values()):
        raise SessionError(path.name, found="MATLAB's objects", expected=_EXPECTED, remedy=_AS_STRUCT)
    else:
        raise unfit(path.name, f"variables {', '.join(variables) or 'none'}", _EXPECTED)
    cameras = {}
    for name, lens, (rotation, translation) in zip(names, lenses, poses, strict=True):
        with parsing("an invalid value", f"{path.name}, camera {name}", _EXPECTED):
            entry = _lens(path, lens) | {"R": numbers(rotation, 3, 3).T, "t": numbers(translation, 3) * _mm(path, lens)}
        cameras[name] = camera_from_entry(path.name, name, entry)
    return cameras


def _variables(path: Path) -> dict[str, Any]:
    content = read_bytes(path, path.name, "a MAT-file", most_mib=_MOST_MIB)
    if content.startswith(_HDF5):
        raise SessionError(path.name, found="a MAT-file of version 7.3", expected="version 7", remedy=_AS_STRUCT)
    with parsing("an invalid MAT-file", path.name, "a MAT-file of version 7"):
        return read_variables(content)


def _part(path: Path, table: Mapping[str, Any], name: str) -> Any:
    if name not in table:
        raise unfit(path.name, f"no {name}", _EXPECTED)
    return table[name]


def _lens(path: Path, table: Any) -> dict[str, Any]:
    if table is OBJECT:
        raise SessionError(path.name, found="MATLAB's objects", expected=_EXPECTED, remedy=_AS_STRUCT)
    matrix = numbers(_part(path, table, "K"), 3, 3) if "K" in table else _rows(path, table)
    radial = numbers(_part(path, table, "RadialDistortion"), -1)
    tangential = numbers(table.get("TangentialDistortion", [0.0, 0.0]), 2)
    if not 2 <= len(radial) <= 3:
        raise ValueError(f"{len(radial)} radial coefficients")
    size = numbers(_part(path, table, "ImageSize"), -1)
    if len(size) < 2:
        raise ValueError("no ImageSize: give it to estimateCameraParameters")
    matrix = matrix.copy()
    matrix[:2, 2] -= _FROM_ONE
    return {"K": matrix, "dist": [radial[0], radial[1], *tangential, *radial[2:]], "image_size": (size[1], size[0])}


def _rows(path: Path, table: Mapping[str, Any]) -> Any:
    return numbers(_part(path, table, "IntrinsicMatrix"), 3, 3).T


def _mm(path: Path, table: Mapping[str, Any]) -> float:
    unit = table.get("WorldUnits", "mm")
    unit = unit if isinstance(unit, str) else ""
    if unit.lower() not in _MM:
        raise unfit(path.name, f"lengths in {shown(unit)}", "WorldUnits in mm, cm, m or in")
    return _MM[unit.lower()]
