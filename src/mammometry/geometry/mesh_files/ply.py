"""PLY files. Reads text or binary, with polygons of any size. Writes binary triangles."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mammometry.base.errors import SessionError
from mammometry.geometry.arrays import Array, Float64, Int64, UInt8
from mammometry.geometry.mesh_files.colours import eight_bit, of_vertices
from mammometry.geometry.mesh_files.scene import GREY

if TYPE_CHECKING:
    from mammometry.geometry.mesh import TriangleMesh

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4",
    "float64": "f8", "int64": "i8", "uint64": "u8",
}  # fmt: skip
_NAMES = {np.dtype(f"<{_TYPES[name]}"): name for name in ("double", "float", "uchar", "int", "short", "ushort", "uint")}
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
_CORNERS = ("vertex_indices", "vertex_index")
_COLOURS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
_HEADER_BYTES = 1 << 22  # largest header
_LINE = re.compile(rb"[^\r\n]*(?:\r\n|\r|\n)")
_LONGEST = 100_000  # most corners of a polygon


@dataclass(slots=True)
class _Property:
    name: str
    kind: str
    """NumPy's type code of a value."""
    length: str = ""
    """NumPy's type code of a list's length. Empty: a single value."""


@dataclass(slots=True)
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)
    values: dict[str, Any] = field(default_factory=dict)
    """Values of each property. Lists of different lengths become a list of arrays."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlyFile:
    """Content of a PLY."""

    points: Float64[Array, "n 3"]
    """Vertices, in the file's unit."""
    faces: Int64[Array, "m 3"]
    """Triangles. Polygons are split into fans around their first corner."""
    comments: tuple[str, ...]
    elements: Mapping[str, _Element]
    polygons: Int64[Array, " m"]
    """Index of the polygon to which each triangle belongs."""

    def properties(self) -> dict[str, Array]:
        """Vertex properties other than coordinates: name → values (n), as stored."""
        values = self.elements["vertex"].values
        return {
            name: np.ascontiguousarray(column, column.dtype.newbyteorder("="))
            for name, column in values.items()
            if name not in ("x", "y", "z") and isinstance(column, np.ndarray)
        }

    def colours(self) -> UInt8[Array, "n 3"]:
        """Colour of each vertex, sRGB.

        If only faces have colours, each vertex has the mean of the faces around it. `GREY` without colours.
        """
        stored = _stored_colours(self.elements["vertex"])
        if stored is not None:
            return stored
        of_faces = _stored_colours(self.elements["face"]) if "face" in self.elements else None
        if of_faces is not None and self.faces.max(initial=-1) < len(self.points):
            return of_vertices(self.faces, of_faces[self.polygons], len(self.points), GREY)
        return np.full((len(self.points), 3), GREY, dtype=np.uint8)


def parse_ply(content: bytes, name: str) -> PlyFile:
    """Read a PLY.

    Args:
        content: content of the file.
        name: the file's name in messages.

    Raises:
        ValueError: the file is not a PLY, is truncated, or contains something other than numbers where they are
        expected (also KeyError, IndexError and TypeError).
        SessionError: the file contains triangle strips.
    """
    order, elements, comments, body = _header(content, name)
    reader = _Text(body) if order == "" else _Binary(body, order)
    for element in elements:
        element.values = reader.read(element)
    named = {element.name: element for element in elements}
    points = np.stack([np.asarray(named["vertex"].values[axis], dtype=np.float64) for axis in "xyz"], axis=1)
    if points.shape != (named["vertex"].count, 3):
        raise ValueError("vertices without three coordinates")
    polygons, faces = np.zeros(0, dtype=np.int64), np.zeros((0, 3), dtype=np.int64)
    if "face" in named:
        values = named["face"].values
        corners = next((values[word] for word in _CORNERS if word in values), None)
        if corners is None:
            raise ValueError("faces without corners")
        polygons, faces = _triangles(corners)
    return PlyFile(points=points, faces=faces, comments=comments, elements=named, polygons=polygons)


def write_ply(
    path: Path, mesh: TriangleMesh, properties: Mapping[str, Array] | None = None, comments: tuple[str, ...] = ()
) -> None:
    """Write a binary little-endian PLY.

    Floats are written as float and other positions as double, so that nothing is lost.

    Args:
        path: the file to write.
        mesh: vertices and faces, mm, world frame.
        properties: name → one value per vertex (n), of a type that PLY has.
        comments: lines for the header.

    Raises:
        ValueError: a property has another length, or a type that PLY does not have.
    """
    short = mesh.vertices.astype(np.float32)
    positions = short if np.array_equal(short, mesh.vertices) else mesh.vertices
    columns: dict[str, Array] = {name: positions[:, axis] for axis, name in enumerate("xyz")}
    columns |= properties or {}
    for name, values in columns.items():
        if values.shape != (len(mesh.vertices),) or values.dtype not in _NAMES:
            raise ValueError(f"property {name}: one number a vertex expected, found {values.dtype} {values.shape}")
    vertices = np.empty(len(mesh.vertices), dtype=[(name, values.dtype) for name, values in columns.items()])
    for name, values in columns.items():
        vertices[name] = values
    faces = np.empty(len(mesh.faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.faces
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {comment}" for comment in comments)]
    lines += [f"element vertex {len(vertices)}"]
    lines += [f"property {_NAMES[values.dtype]} {name}" for name, values in columns.items()]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    with path.open("wb") as file:
        file.write("\n".join(lines).encode())
        file.write(vertices.tobytes())
        file.write(faces.tobytes())


def _header(content: bytes, name: str) -> tuple[str, list[_Element], tuple[str, ...], bytes]:
    """Byte order (empty for text), elements, comments, and the bytes after the header."""
    if not content.startswith(b"ply"):
        raise ValueError("it has no PLY header")
    order, start = None, 0
    elements: list[_Element] = []
    comments: list[str] = []
    for line in _LINE.finditer(content, 0, _HEADER_BYTES):
        text = line[0].decode(errors="replace")
        word, *rest = text.split() or [""]
        if word == "end_header":
            start = line.end()
            break
        if word == "comment":
            comments.append(text.strip().partition(" ")[2])
        elif word == "format":
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
                raise ValueError("it is shorter than its header states")
        elif word == "property" and rest[0] == "list":
            elements[-1].properties.append(_Property(rest[3], _TYPES[rest[2]], _TYPES[rest[1]]))
        elif word == "property":
            elements[-1].properties.append(_Property(rest[1], _TYPES[rest[0]]))
    if not start:
        raise ValueError("it has no PLY header")
    if order is None:
        raise ValueError("no format")
    return order, elements, tuple(comments), content[start:]


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
            raise ValueError("it is shorter than its header states")
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
        """Length of list `number` in the first row, if the lists before it have the given lengths."""
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
        """All rows at once, if every list is as long as in the first row. Otherwise None."""
        fields: list[Any] = []
        for place, (property_, length) in enumerate(zip(element.properties, lengths, strict=True)):
            if not 0 <= length <= _LONGEST:
                raise ValueError("a list is longer than the file")
            if property_.length:
                fields.append((f"n{place}", self._order + property_.length))
            fields.append((f"v{place}", self._order + property_.kind, (length,) if property_.length else ()))
        row = np.dtype(fields)
        if self._at + element.count * row.itemsize > len(self._body):
            if any(property_.length for property_ in element.properties):
                return None
            raise ValueError("it is shorter than its header states")
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
            raise ValueError("it is shorter than its header states")
        found = np.frombuffer(self._body, self._order + kind, count, self._at)
        self._at += size
        return found


def _triangles(corners: Any) -> tuple[Int64[Array, " m"], Int64[Array, "m 3"]]:
    """Split polygons into fans around their first corner. Returns each triangle's polygon and corners."""
    if isinstance(corners, np.ndarray) and corners.shape[1:] == (3,):
        return np.arange(len(corners)), corners.astype(np.int64)
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


def _stored_colours(element: _Element) -> UInt8[Array, "n 3"] | None:
    """Colours of an element. None if it has no colours."""
    values = element.values
    names = next((names for names in _COLOURS if all(name in values for name in names)), None)
    if names is None:
        return None
    kinds = {property_.name: property_.kind for property_ in element.properties}
    return eight_bit(np.stack([np.asarray(values[name]) for name in names], axis=1), whole=kinds[names[0]][0] != "f")
