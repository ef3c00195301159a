"""PLY: text or either byte order, polygons of any size, further properties."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mammometry.base.errors import SessionError
from mammometry.geometry.arrays import Array, Float64, Int64, UInt8
from mammometry.geometry.mesh_files.colours import eight_bit, of_vertices
from mammometry.geometry.mesh_files.scene import GREY

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4",
    "float64": "f8", "int64": "i8", "uint64": "u8",
}  # fmt: skip
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
_CORNERS = ("vertex_indices", "vertex_index")
_COLOURS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
_HEADER_BYTES = 1 << 22  # in which a header must end
_LINE = re.compile(rb"[^\r\n]*(?:\r\n|\r|\n)")
_LONGEST = 100_000  # corners of a polygon


@dataclass(slots=True)
class _Property:
    name: str
    kind: str
    """NumPy's code of a value."""
    length: str = ""
    """NumPy's code of a list's length. Empty: a single value."""


@dataclass(slots=True)
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)


def parse_ply(content: bytes, name: str) -> tuple[Float64[Array, "n 3"], Int64[Array, "m 3"], UInt8[Array, "n 3"]]:
    """Vertices, triangles and sRGB of each vertex. A polygon is a fan around its first corner.

    Where faces alone have colours, a vertex has the mean of those around it.

    Args:
        content: of the file.
        name: what to call it in messages.

    Raises:
        ValueError: it is no PLY, is cut short, or holds no numbers where they should be.
        SessionError: it holds triangle strips.
    """
    order, elements, body = _header(content, name)
    points = np.zeros((0, 3))
    triangles = np.zeros((0, 3), dtype=np.int64)
    colours = np.zeros((0, 3), dtype=np.uint8)
    has_colours, of_faces = False, None
    reader = _Text(body) if order == "" else _Binary(body, order)
    for element in elements:
        values = reader.read(element)
        if element.name == "vertex":
            points = np.stack([np.asarray(values[axis], dtype=np.float64) for axis in "xyz"], axis=1)
            stored = _stored_colours(element, values)
            has_colours = stored is not None
            colours = np.full((len(points), 3), GREY, dtype=np.uint8) if stored is None else stored
        elif element.name == "face":
            corners = next((values[word] for word in _CORNERS if word in values), None)
            if corners is None:
                raise ValueError("faces without corners")
            polygon, triangles = _triangles(corners)
            of_faces = _stored_colours(element, values)
    if of_faces is not None and not has_colours and triangles.max(initial=-1) < len(points):
        colours = of_vertices(triangles, of_faces[polygon], len(points), GREY)
    return points, triangles, colours


def _header(content: bytes, name: str) -> tuple[str, list[_Element], bytes]:
    if not content.startswith(b"ply"):
        raise ValueError("no header of a PLY")
    order, start = None, 0
    elements: list[_Element] = []
    for line in _LINE.finditer(content, 0, _HEADER_BYTES):
        word, *rest = line[0].decode("latin-1").split() or [""]
        if word == "end_header":
            start = line.end()
            break
        if word == "format":
            order = _ORDERS.get(rest[0])
        elif word == "element":
            if rest[0] == "tristrips":
                raise SessionError(
                    name,
                    found="triangle strips",
                    expected="single triangles (element face)",
                    remedy="Export it without strips",
                )
            elements.append(_Element(rest[0], int(rest[1])))
            if not 0 <= elements[-1].count <= len(content):
                raise ValueError("it ends before all that its header counts")
        elif word == "property" and rest[0] == "list":
            elements[-1].properties.append(_Property(rest[3], _TYPES[rest[2]], _TYPES[rest[1]]))
        elif word == "property":
            elements[-1].properties.append(_Property(rest[1], _TYPES[rest[0]]))
    if not start:
        raise ValueError("no header of a PLY")
    if order is None:
        raise ValueError("no format")
    return order, elements, content[start:]


class _Text:
    def __init__(self, body: bytes) -> None:
        self._words = body.split()
        self._at = 0

    def read(self, element: _Element) -> dict[str, Any]:
        if not any(property_.length for property_ in element.properties):
            width = len(element.properties)
            words = self._take(element.count * width)
            table = np.array(words, dtype=np.float64).reshape(element.count, width)
            return {property_.name: table[:, place] for place, property_ in enumerate(element.properties)}
        values: dict[str, list[Any]] = {property_.name: [] for property_ in element.properties}
        for _ in range(element.count):
            for property_ in element.properties:
                count = int(self._take(1)[0]) if property_.length else 1
                row = np.array(self._take(count), dtype=np.float64)
                values[property_.name].append(row if property_.length else row[0])
        return dict(values)

    def _take(self, count: int) -> list[bytes]:
        words = self._words[self._at : self._at + count]
        if len(words) < count or count < 0:
            raise ValueError("it ends before all that its header counts")
        self._at += count
        return words


class _Binary:
    def __init__(self, body: bytes, order: str) -> None:
        self._body, self._order, self._at = body, order, 0

    def read(self, element: _Element) -> dict[str, Any]:
        lengths = [self._first_length(element, number) for number in range(len(element.properties))]
        known = self._rows(element, lengths)
        return self._one_by_one(element) if known is None else known

    def _first_length(self, element: _Element, number: int) -> int:
        """Length of the list `number` in the first row, as if the others of the row were as they are there."""
        at = self._at
        for place, property_ in enumerate(element.properties):
            count = 1
            if property_.length:
                size = np.dtype(property_.length).itemsize
                if at + size > len(self._body):
                    return 0
                count = int(np.frombuffer(self._body, self._order + property_.length, 1, at)[0])
                at += size
            if place == number:
                return count
            at += count * np.dtype(property_.kind).itemsize
        return 1

    def _rows(self, element: _Element, lengths: list[int]) -> dict[str, Any] | None:
        """All rows at once, where their lists are as long as the first row's. None: they are not."""
        fields: list[Any] = []
        for place, (property_, length) in enumerate(zip(element.properties, lengths, strict=True)):
            if not 0 <= length <= _LONGEST:
                raise ValueError("a list that it cannot hold")
            if property_.length:
                fields.append((f"n{place}", self._order + property_.length))
            fields.append((f"v{place}", self._order + property_.kind, (length,) if property_.length else ()))
        row = np.dtype(fields)
        if self._at + element.count * row.itemsize > len(self._body):
            if any(property_.length for property_ in element.properties):
                return None
            raise ValueError("it ends before all that its header counts")
        table = np.frombuffer(self._body, row, element.count, self._at)
        for place, (property_, length) in enumerate(zip(element.properties, lengths, strict=True)):
            if property_.length and not (table[f"n{place}"] == length).all():
                return None
        self._at += table.nbytes
        return {property_.name: table[f"v{place}"] for place, property_ in enumerate(element.properties)}

    def _one_by_one(self, element: _Element) -> dict[str, Any]:
        values: dict[str, list[Any]] = {property_.name: [] for property_ in element.properties}
        for _ in range(element.count):
            for property_ in element.properties:
                count = int(self._take(property_.length, 1)[0]) if property_.length else 1
                row = self._take(property_.kind, count)
                values[property_.name].append(row if property_.length else row[0])
        return dict(values)

    def _take(self, kind: str, count: int) -> Array:
        size = np.dtype(kind).itemsize * count
        if count < 0 or self._at + size > len(self._body):
            raise ValueError("it ends before all that its header counts")
        found = np.frombuffer(self._body, self._order + kind, count, self._at)
        self._at += size
        return found


def _triangles(corners: Any) -> tuple[Int64[Array, " m"], Int64[Array, "m 3"]]:
    """Fans around the first corner of each polygon: the polygon of each triangle, and its corners."""
    if isinstance(corners, np.ndarray) and corners.ndim == 2:
        groups = [(np.arange(len(corners)), corners.astype(np.int64))]
    else:
        lengths = np.array([len(row) for row in corners])
        groups = []
        for length in np.unique(lengths):
            chosen = np.flatnonzero(lengths == length)
            groups.append((chosen, np.array([corners[k] for k in chosen], dtype=np.int64)))
    polygons = [np.zeros(0, dtype=np.int64)]
    fans = [np.zeros((0, 3), dtype=np.int64)]
    for chosen, group in groups:
        for k in range(1, group.shape[1] - 1):
            polygons.append(chosen)
            fans.append(group[:, [0, k, k + 1]])
    return np.concatenate(polygons), np.concatenate(fans)


def _stored_colours(element: _Element, values: dict[str, Any]) -> UInt8[Array, "n 3"] | None:
    """Colours of an element. None: it has none."""
    names = next((names for names in _COLOURS if all(name in values for name in names)), None)
    if names is None:
        return None
    kinds = {property_.name: property_.kind for property_ in element.properties}
    return eight_bit(np.stack([np.asarray(values[name]) for name in names], axis=1), whole=kinds[names[0]][0] != "f")
