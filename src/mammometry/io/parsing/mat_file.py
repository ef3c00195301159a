"""MATLAB's MAT-files of versions 5 to 7: numbers, texts and structures.

Not read by SciPy, whose reader ends the whole process at some damaged files. The format is that of MathWorks' "MAT-File
Format", chapter "Level 5".
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from mammometry.base.parse import DEEPEST

Variable: TypeAlias = Any
"""An array of numbers, a text, a structure as a dictionary, a list (of cells or structures), or `OBJECT`."""
OBJECT: Final = object()
"""Stands for what only MATLAB reads: objects, functions, sparse matrices."""
_HEAD_BYTES = 128
_MOST_BYTES = 256 << 20  # unpacked: a calibration with all its pictures' points has some MiB
_MATRIX, _PACKED = 14, 15  # types of elements
_CELL, _STRUCT, _CHAR, _DOUBLE, _UINT64 = 1, 2, 4, 6, 15  # classes of arrays; those of numbers lie between the last two
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8", 16: "u1"}
"""Type of an element → NumPy's name."""
_ENCODINGS = {1: "utf-8", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}


def read_variables(content: bytes) -> dict[str, Variable]:
    """Read all variables of a MAT-file.

    Raises:
        ValueError: it is no such file, or damaged.
    """
    mark = content[126:_HEAD_BYTES]
    if mark not in (b"IM", b"MI"):
        raise ValueError("no mark of a MAT-file of version 5 or 7")
    reader = _Reader(order="<" if mark == b"IM" else ">")
    try:
        return dict(reader.variables(content[_HEAD_BYTES:]))
    except (struct.error, zlib.error, UnicodeDecodeError) as error:
        raise ValueError(str(error)) from None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Reader:
    order: Literal["<", ">"]
    """Of bytes, as `struct` writes it."""

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
        """Type and data of one element after the other."""
        place = 0
        while place < len(content):
            kind, size = struct.unpack_from(f"{self.order}II", content, place)
            start = place + 8
            if kind >> 16:  # both in four bytes, and the data in the next four
                kind, size, start = kind & 0xFFFF, kind >> 16, place + 4
                place += 8
            else:
                place = start + size + (0 if kind == _PACKED else -size % 8)
            if start + size > len(content):
                raise ValueError("a file that ends too early")
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
            raise ValueError("names of no letters")
        names = [text[place : place + length].split(b"\0")[0].decode("ascii") for place in range(0, len(text), length)]
        values = [self._array(data, depth + 1)[1] for _, data in parts]
        return [dict(zip(names, values[place:], strict=False)) for place in range(0, len(values), max(1, len(names)))]

    def _numbers(self, kind: int, data: bytes) -> np.ndarray[Any, Any]:
        if kind not in _NUMBERS:
            raise ValueError(f"numbers of an unknown type {kind}")
        return np.frombuffer(data, dtype=np.dtype(_NUMBERS[kind]).newbyteorder(self.order)).astype(np.float64)

    def _text(self, kind: int, data: bytes) -> str:
        if kind not in _ENCODINGS:
            raise ValueError(f"letters of an unknown type {kind}")
        wide = {"utf-16": "utf-16-", "utf-32": "utf-32-"}.get(_ENCODINGS[kind])
        return data.decode(f"{wide}{'le' if self.order == '<' else 'be'}" if wide else _ENCODINGS[kind])

    @staticmethod
    def _next(parts: Iterator[tuple[int, bytes]]) -> tuple[int, bytes]:
        part = next(parts, None)
        if part is None:
            raise ValueError("a variable that ends too early")
        return part
