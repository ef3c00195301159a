"""Triangles of other programs' PLY, OBJ, STL, GLB and USDZ files, which mostly do not say their unit.

PLY is read here: text or either byte order, polygons of any size, further properties.
"""

from __future__ import annotations

import codecs
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.base.errors import MammometryError, SessionError
from mammometry.base.parse import LARGEST, error_text, json_value, read_bytes
from mammometry.geometry.arrays import Array, Float64, Int32, Int64, UInt8
from mammometry.geometry.mesh_files.obj import decimal_commas, parse_obj
from mammometry.geometry.mesh_files.usdz import GREY, UsdPart, read_usdz

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
    reader = _Text(body) if order == "" else _Binary(body, order)
    for element in elements:
        values = reader.read(element)
        if element.name == "vertex":
            points = np.stack([np.asarray(values[axis], dtype=np.float64) for axis in "xyz"], axis=1)
            colours = _ply_colours(values, len(points))
        elif element.name == "face":
            corners = next((values[word] for word in _CORNERS if word in values), None)
            if corners is None:
                raise ValueError("faces without corners")
            triangles = _triangles(corners)
    return points, triangles, colours


def _header(content: bytes, name: str) -> tuple[str, list[_Element], bytes]:
    end = content.find(b"end_header", 0, _HEADER_BYTES)
    if end < 0 or not content.startswith(b"ply"):
        raise ValueError("no header of a PLY")
    order = None
    elements: list[_Element] = []
    for line in content[:end].decode("latin-1").splitlines():
        word, *rest = line.split() or [""]
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
    if order is None:
        raise ValueError("no format")
    start = content.index(b"\n", end) + 1 if b"\n" in content[end : end + 16] else content.index(b"\r", end) + 1
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


def _triangles(corners: Any) -> Int64[Array, "m 3"]:
    """Fans around the first corner of each polygon."""
    if isinstance(corners, np.ndarray) and corners.ndim == 2:
        groups = [corners.astype(np.int64)]
    else:
        lengths = np.array([len(row) for row in corners])
        groups = [
            np.array([corners[k] for k in np.flatnonzero(lengths == length)], dtype=np.int64)
            for length in np.unique(lengths)
        ]
    fans = [np.zeros((0, 3), dtype=np.int64)]
    for group in groups:
        fans += [group[:, [0, k, k + 1]] for k in range(1, group.shape[1] - 1)]
    return np.concatenate(fans)


def _ply_colours(values: dict[str, Any], count: int) -> UInt8[Array, "n 3"]:
    names = next((names for names in _COLOURS if all(name in values for name in names)), None)
    if names is None:
        return np.full((count, 3), GREY, dtype=np.uint8)
    colours = np.stack([np.asarray(values[name], dtype=np.float64) for name in names], axis=1)
    shares = np.asarray(values[names[0]]).dtype.kind == "f" and np.nanmax(colours, initial=0.0) <= 1.0
    return np.clip(np.nan_to_num(colours) * (255.0 if shares else 1.0) + 0.5, 0, 255).astype(np.uint8)


SUFFIXES = (".ply", ".obj", ".stl", ".glb", ".usdz")
KINDS = "PLY, OBJ, STL, GLB or USDZ"
_KINDS = f"a mesh as {KINDS}"
_MOST_MIB = 4096  # nearly a hundred million triangles as STL; a larger file would fill the memory
_HEAD_BYTES = 65_536  # in which a file shows how it is written
_SIGN = 64  # bytes in which every second one is zero in UTF-16, and in no mesh
_DECIMAL_COMMA = re.compile(rb"\d+,\d+")


def read_triangles(path: Path) -> tuple[Float64[Array, "n 3"], Int32[Array, "m 3"], UInt8[Array, "n 3"]]:
    """Read vertices, faces and colours.

    Vertices in one place become one. Faces without area are dropped. Nothing but this file is read: no materials, no
    pictures, no buffers beside it.

    Raises:
        SessionError: the file cannot be read, or holds no triangles or no numbers.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise _refused(path, "another kind of file", _KINDS, "Export the mesh as one of them")
    if not path.exists():
        raise _refused(path, "no such file", _KINDS, "Check the path")
    content = read_bytes(path, str(path), _KINDS, most_mib=_MOST_MIB).removeprefix(codecs.BOM_UTF8)
    if (found := _other_content(path, content[:_HEAD_BYTES])) is not None:
        raise _refused(
            path, found, f"what the ending {path.suffix} says", "Give it its right ending, or export it again"
        )
    if path.suffix.lower() == ".stl" and _is_text(start := content[:_HEAD_BYTES]) and b"\n" not in start:
        content = content.replace(b"\r", b"\n")  # the reader knows no other ends of lines
    try:
        vertices, faces, colours = _parsed(path, content)
    except MammometryError:
        raise
    except Exception as error:  # the readers raise anything that a damaged file makes them stumble over
        raise _cause(path, content, error) from None
    if not len(faces):
        raise _refused(path, "no triangles", "a triangulated surface", "Export it with its faces, not as points")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise _refused(path, "faces of vertices that are not there", "a whole mesh", "Export it again")
    if not (np.abs(vertices[faces]) <= LARGEST).all():
        raise _refused(path, "coordinates that are not finite", "numbers", "Export it again")
    _, first, place = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    faces = place.reshape(-1)[faces]
    different = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    faces = faces[different]
    if not len(faces):
        raise _refused(path, "no triangle with an area", "a triangulated surface", "Export it again")
    used, compact = np.unique(faces, return_inverse=True)
    return vertices[first[used]], _in_order(compact.reshape(-1, 3)).astype(np.int32), colours[first[used]]


def _in_order(faces: Int64[Array, "m 3"]) -> Int64[Array, "m 3"]:
    """Faces in the order of their corners, each with its smallest first: no result hangs on a file's order."""
    start = np.argmin(faces, axis=1)
    turned = np.take_along_axis(faces, (start[:, None] + np.arange(3)) % 3, axis=1)
    return turned[np.lexsort(turned.T[::-1])]


def _parsed(path: Path, content: bytes) -> tuple[Float64[Array, "n 3"], Int64[Array, "m 3"], UInt8[Array, "n 3"]]:
    if path.suffix.lower() == ".obj":
        obj = parse_obj(content, str(path))
        grey = np.full((len(obj.points), 3), GREY, dtype=np.uint8)
        return obj.points, obj.faces, grey if obj.colours is None else obj.colours
    if path.suffix.lower() == ".ply":
        return parse_ply(content, str(path))
    if path.suffix.lower() == ".usdz":
        return _of_parts(read_usdz(path).parts)
    loaded = _loaded(path, content)
    vertices = np.asarray(loaded.vertices, dtype=np.float64).reshape(-1, 3)
    return vertices, np.asarray(loaded.faces, dtype=np.int64).reshape(-1, 3), _colours(loaded, len(vertices))


def _of_parts(parts: Sequence[UsdPart]) -> tuple[Float64[Array, "n 3"], Int64[Array, "m 3"], UInt8[Array, "n 3"]]:
    """One mesh of a scene's parts."""
    before = np.cumsum([0, *(len(part.points) for part in parts)])
    return (
        np.concatenate([np.empty((0, 3)), *(part.points for part in parts)]),
        np.concatenate([np.empty((0, 3), np.int64), *(part.faces + before[n] for n, part in enumerate(parts))]),
        np.concatenate([np.empty((0, 3), np.uint8), *(part.colours for part in parts)]),
    )


def _other_content(path: Path, head: bytes) -> str | None:
    """Format of a file whose ending says another, None where they fit or nothing is known."""
    letters, between = head[:_SIGN:2], head[1:_SIGN:2]
    kind = path.suffix.lower()
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return None if kind == ".obj" else "a text in UTF-16"
    if len(between) > 0 and not any(between) and all(letters):
        return "a text in UTF-16 that does not say so"
    head = head.lstrip()
    if kind != ".ply" and re.match(rb"ply[ \t]*[\r\n]", head):
        return "a PLY"
    if kind != ".glb" and head.startswith(b"glTF"):
        return "a GLB"
    if kind != ".stl" and head.startswith(b"solid") and b"facet" in head:
        return "an STL"
    if kind in (".ply", ".stl") and re.search(rb"[\r\n]v +\S+ +\S+ +\S+[^\r\n]*[\r\n]+v ", head):
        return "an OBJ"
    is_text = re.search(rb"(?:^|[\r\n])v[ \t]", head) is not None  # whose comments may hold anything
    return "numbers in binary" if kind == ".obj" and b"\0" in head and not is_text else None


def _cause(path: Path, content: bytes, error: Exception) -> SessionError:
    """The refusal of a file that a reader stumbled over, by its likeliest cause."""
    head = content[:_HEAD_BYTES]
    commas = _DECIMAL_COMMA.search(head.partition(b"end_header")[2] or head) if _is_text(head) else None
    if commas is not None:
        return decimal_commas(str(path), commas[0].decode())
    return _refused(path, f"a file that cannot be read ({error_text(error)})", _KINDS, "Export it again")


def _is_text(head: bytes) -> bool:
    return b"\0" not in head and (b"format ascii" in head or head.lstrip().startswith(b"solid"))


def _loaded(path: Path, content: bytes) -> Any:
    """One mesh of all that the file holds. Without a path, trimesh cannot follow what a file refers to."""
    import trimesh

    kind = path.suffix.lower()[1:]
    if kind == "glb":
        check_glb(path, content)
    scene: Any = trimesh.load_scene(io.BytesIO(content), file_type=kind, process=False, skip_materials=True)
    placed = (scene.geometry[scene.graph[node][1]] for node in scene.graph.nodes_geometry)
    count = sum(len(getattr(mesh, "faces", ())) for mesh in placed)
    if count > len(content):  # one mesh placed a thousand times, before it is copied as often
        raise _refused(path, f"{count} triangles out of {len(content)} bytes", "a surface", "Export it again")
    return scene.to_mesh()


def check_glb(path: Path, content: bytes) -> None:
    """Check a GLB's counts and buffers before memory is allocated.

    The counts must fit the file, and the file must hold its buffers itself.
    """
    length = int.from_bytes(content[12:16], "little")
    table = json_value(content[20 : 20 + length].decode(), str(path), "a GLB")
    if any(not isinstance(buffer, dict) or "uri" in buffer for buffer in table.get("buffers", [])):
        raise _refused(path, "vertices in another file", "a GLB that holds them itself", "Export it as one file")
    if any(accessor["count"] > len(content) for accessor in table.get("accessors", [])):
        raise _refused(path, "counts that it cannot hold", "a whole GLB", "Export it again")


def _colours(loaded: Any, count: int) -> UInt8[Array, "n 3"]:
    found = getattr(getattr(loaded, "visual", None), "kind", None)
    if found == "vertex":
        return np.asarray(loaded.visual.vertex_colors, dtype=np.uint8)[:, :3].copy()
    return np.full((count, 3), GREY, dtype=np.uint8)


def _refused(path: Path, found: str, expected: str, remedy: str) -> SessionError:
    return SessionError(str(path), found=found, expected=expected, remedy=remedy)
