"""Wavefront OBJ files: vertices, triangles and texture coordinates.

A negative index counts back from its own line, regardless of groups (specification, "Referencing vertex data").
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from mammometry.base.errors import SessionError
from mammometry.geometry.arrays import Array, Float64, Int64, UInt8
from mammometry.geometry.mesh_files.colours import eight_bit

_NUMBERS = ("v ", "vt ", "vn ", "f ")  # lines of numbers, in which # starts a comment; in names it does not
_KEPT = ("v", "vt", "vn", "f", "usemtl")
_WIDE = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
_DECIMAL_COMMA = re.compile(r"\d,\d")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ObjFile:
    """Content of an OBJ."""

    points: Float64[Array, "n 3"]
    """Vertices, in the file's unit."""
    colours: UInt8[Array, "n 3"] | None
    """sRGB after each vertex's coordinates. None unless all vertices have it."""
    faces: Int64[Array, "m 3"]
    """Triangles. Polygons are split into fans around their first corner."""
    uv: Float64[Array, "k 2"]
    """Texture coordinates, (0, 0) lower left."""
    face_uv: Int64[Array, "m 3"]
    """Index of each corner's texture coordinates. −1: none."""
    face_material: Int64[Array, " m"]
    """Index of each triangle's material. −1: none."""
    materials: tuple[str, ...]
    """Names of the materials in the order of first use."""
    libraries: tuple[str, ...]
    """Text after each ``mtllib``, unchanged: one name, or several separated by spaces."""
    lines: tuple[str, ...]
    """Lines of vertices, faces and material uses, without comments and group names."""


def parse_obj(content: bytes, name: str) -> ObjFile:
    """Read an OBJ.

    Args:
        content: content of the file. Bytes that are not UTF-8 become surrogates, as in file names.
        name: the file's name in messages.

    Raises:
        SessionError: a line has no numbers, or refers to a vertex that does not exist.
    """
    vertices: list[list[str]] = []
    places: list[list[str]] = []
    faces: list[tuple[int, int, int]] = []
    face_uv: list[tuple[int, int, int]] = []
    face_material: list[int] = []
    materials: dict[str, int] = {}
    libraries: list[str] = []
    lines: list[str] = []
    material = -1
    try:
        for line in _lines(content):
            word, _, rest = line.partition(" ")
            if word == "v":
                vertices.append(rest.split())
            elif word == "vt":
                places.append(rest.split()[:2])
            elif word == "f":
                corners = [_corner(corner, len(vertices), len(places)) for corner in rest.split()]
                for second, third in pairwise(corners[1:]):
                    faces.append((corners[0][0], second[0], third[0]))
                    face_uv.append((corners[0][1], second[1], third[1]))
                    face_material.append(material)
            elif word == "usemtl":
                material = materials.setdefault(rest.strip(), len(materials))
            elif word == "mtllib":
                libraries.append(rest.strip())
            if word in _KEPT:
                lines.append(line)
        points, colours = _points(vertices)
        uv = np.array([[float(part) for part in (*place, "0")[:2]] for place in places], dtype=np.float64)
    except (ValueError, IndexError, OverflowError):
        raise _wrong_numbers(name, [*vertices, *places]) from None
    corners_of = np.array(faces, dtype=np.int64).reshape(-1, 3)
    places_of = np.array(face_uv, dtype=np.int64).reshape(-1, 3)
    if corners_of.max(initial=-1) >= len(points) or places_of.max(initial=-1) >= len(uv):
        raise _wrong_numbers(name, [])
    return ObjFile(
        points=points,
        colours=colours,
        faces=corners_of,
        uv=uv.reshape(-1, 2),
        face_uv=places_of,
        face_material=np.array(face_material, dtype=np.int64),
        materials=tuple(materials),
        libraries=tuple(libraries),
        lines=tuple(lines),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ObjPart:
    """A part of an OBJ to be written."""

    material: str
    faces: Array
    """Vertices of each triangle, (m, 3), counted from 0 over all parts."""
    points: Float64[Array, "n 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    """Vertices that earlier parts do not have."""
    uv: Float64[Array, "k 2"] = field(default_factory=lambda: np.zeros((0, 2)))
    """Texture coordinates, with (0, 0) at the lower left."""
    face_uv: Array | None = None
    """Texture coordinates of each triangle's corners, (m, 3), counted from 0 over all parts. None without a picture."""


def obj_text(library: str, parts: Sequence[ObjPart], *, exact: bool = False) -> str:
    """Text of an OBJ.

    Args:
        library: name of its material file.
        parts: parts, in this order.
        exact: whether numbers are written with all digits. Otherwise with 4 decimals, texture coordinates with 6.
    """
    point, place = ("%r", "%r") if exact else ("%.4f", "%.6f")
    text = [f"mtllib {library}\n"]
    for part in parts:
        text.append(f"usemtl {part.material}\n")
        text.append(_rows(f"v {point} {point} {point}\n", part.points))
        text.append(_rows(f"vt {place} {place}\n", part.uv))
        if part.face_uv is None:
            text.append(_rows("f %d %d %d\n", part.faces + 1))
        else:
            text.append(_rows("f %d/%d %d/%d %d/%d\n", np.stack([part.faces, part.face_uv], axis=2) + 1))
    return "".join(text)


def _rows(line: str, rows: Array) -> str:
    """Each row as a line. All are formatted in one call, because there are hundreds of thousands."""
    return line * len(rows) % tuple(rows.ravel().tolist())


def decimal_commas(name: str, sample: str) -> SessionError:
    """The error for a mesh file whose numbers have decimal commas.

    Args:
        name: the file's name in messages.
        sample: one of the numbers.
    """
    return SessionError(
        name,
        found=f"numbers with decimal commas, such as {sample[:20]}",
        expected="decimal points",
        remedy="Set decimal points in the exporting program or its computer, and export again",
    )


def _lines(content: bytes) -> Iterator[str]:
    """Lines with a space after the first word, without comments after numbers. Continued lines are joined."""
    wide = next((code for mark, code in _WIDE.items() if content.startswith(mark) and len(content) % 2 == 0), None)
    text = content.decode("utf-8-sig", "surrogateescape")
    if wide is not None and "\nf " not in text.replace("\r", "\n"):  # otherwise only its comments are UTF-16
        text = content.decode(wide, "replace")
    for line in re.split("\r\n|\r|\n", re.sub("\\\\(\r\n|\r|\n)", " ", text)):
        plain = line.strip(" \t\0").replace("\t", " ")
        yield plain.partition("#")[0].rstrip() if plain.startswith(_NUMBERS) else plain


def _points(vertices: list[list[str]]) -> tuple[Float64[Array, "n 3"], UInt8[Array, "n 3"] | None]:
    widths = {len(row) for row in vertices}
    if min(widths, default=3) < 3:
        raise ValueError("a vertex with fewer than three numbers")
    points = np.array([row[:3] for row in vertices], dtype=np.float64).reshape(-1, 3)
    if min(widths, default=0) < 6:
        return points, None
    return points, eight_bit(np.array([row[3:6] for row in vertices], dtype=np.float64), whole=False)


def _corner(text: str, vertex_count: int, place_count: int) -> tuple[int, int]:
    """Vertex and texture index of a corner, such as ``7``, ``7/3``, ``7//2`` or ``-1/-1/-1``."""
    vertex, _, rest = text.partition("/")
    place = rest.partition("/")[0]
    return _index(vertex, vertex_count), _index(place, place_count) if place else -1


def _index(word: str, count: int) -> int:
    number = int(word)
    if number < -count or number == 0:
        raise IndexError
    return number - 1 if number > 0 else count + number


def _wrong_numbers(name: str, rows: list[list[str]]) -> SessionError:
    commas = next((part for row in rows for part in row if _DECIMAL_COMMA.search(part)), "")
    if commas:
        return decimal_commas(name, commas)
    return SessionError(
        name, found="a line without its numbers", expected="a complete OBJ", remedy="Export it again"
    )  # fmt: skip
