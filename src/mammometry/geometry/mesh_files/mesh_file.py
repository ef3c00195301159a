"""Read triangles from other programs' PLY, OBJ, STL, GLB and USDZ files, often without a unit."""

from __future__ import annotations

import codecs
import re
from pathlib import Path
from typing import TypeAlias

import numpy as np

from mammometry.base.errors import MammometryError, SessionError
from mammometry.base.parse import LARGEST, error_text, read_bytes
from mammometry.geometry.arrays import Array, Float64, Int64, UInt8
from mammometry.geometry.mesh_files.glb import read_glb
from mammometry.geometry.mesh_files.in_child import read_in_child
from mammometry.geometry.mesh_files.obj import decimal_commas, parse_obj
from mammometry.geometry.mesh_files.ply import parse_ply
from mammometry.geometry.mesh_files.scene import GREY, MeshContent, joined_parts
from mammometry.geometry.mesh_files.stl import parse_stl
from mammometry.geometry.mesh_files.usdz import parse_usdz

_Parsed: TypeAlias = tuple[
    Float64[Array, "n 3"], Int64[Array, "m 3"], UInt8[Array, "n 3"], tuple[str, ...]
]  # points, triangles, colours, remarks
SUFFIXES = (".ply", ".obj", ".stl", ".glb", ".usdz")
KINDS = "PLY, OBJ, STL, GLB or USDZ"
_KINDS = f"a mesh as {KINDS}"
_MOST_MIB = 4096  # almost 100 million triangles as STL; a larger file would not fit into memory
_HEAD_BYTES = 65_536  # number of bytes from which the format is recognised
_SIGN = 64  # number of bytes; in UTF-16, but in no mesh format, every second one is zero
_DECIMAL_COMMA = re.compile(rb"\d+,\d+")


def read_mesh_file(path: Path) -> MeshContent:
    """Read a mesh file in a child process.

    Vertices at the same position are merged. Faces without area are removed. Only this file is read, without materials,
    pictures or buffers in other files.

    Raises:
        SessionError: the file cannot be read, has no triangles, or has values that are not numbers.
    """
    _check_name(path)
    return read_in_child(parse_mesh_file, path)


def parse_mesh_file(path: Path) -> MeshContent:
    """Read a mesh file in this process, in the same way as `read_mesh_file`."""
    _check_name(path)
    content = read_bytes(path, str(path), _KINDS, most_mib=_MOST_MIB).removeprefix(codecs.BOM_UTF8)
    if (found := _other_content(path, content[:_HEAD_BYTES])) is not None:
        raise _refused(
            path, found, f"a {path.suffix} file, as its name says", "Correct the file extension, or export it again"
        )
    try:
        vertices, faces, colours, remarks = _parsed(path, content)
    except MammometryError:
        raise
    except Exception as error:  # readers may raise any exception for damaged files
        raise _cause(path, content, error) from None
    if not len(faces):
        raise _refused(path, "no triangles", "a triangulated surface", "Export it with its faces, not as points")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise _refused(path, "faces that refer to vertices that do not exist", "a complete mesh", "Export it again")
    if not (np.abs(vertices[faces]) <= LARGEST).all():
        raise _refused(path, "coordinates that are not finite", "numbers", "Export it again")
    _, first, place = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    faces = place.reshape(-1)[faces]
    different = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    faces = faces[different]
    if not len(faces):
        raise _refused(path, "no triangle with an area", "a triangulated surface", "Export it again")
    used, compact = np.unique(faces, return_inverse=True)
    return MeshContent(
        points=vertices[first[used]],
        faces=_in_order(compact.reshape(-1, 3)).astype(np.int32),
        colours=colours[first[used]],
        remarks=remarks,
    )


def _check_name(path: Path) -> None:
    if path.suffix.lower() not in SUFFIXES:
        raise _refused(path, "another file type", _KINDS, "Export the mesh as one of them")
    if not path.exists():
        raise _refused(path, "no such file", _KINDS, "Check the path")


def _in_order(faces: Int64[Array, "m 3"]) -> Int64[Array, "m 3"]:
    """Sort the faces, each with its smallest index first. So results do not depend on the file's order."""
    start = np.argmin(faces, axis=1)
    turned = np.take_along_axis(faces, (start[:, None] + np.arange(3)) % 3, axis=1)
    return turned[np.lexsort(turned.T[::-1])]


def _parsed(path: Path, content: bytes) -> _Parsed:
    kind = path.suffix.lower()
    if kind == ".obj":
        obj = parse_obj(content, str(path))
        return obj.points, obj.faces, _grey(obj.points) if obj.colours is None else obj.colours, ()
    if kind == ".ply":
        ply = parse_ply(content, str(path))
        return ply.points, ply.faces, ply.colours(), ()
    if kind == ".stl":
        points, faces = parse_stl(content)
        return points, faces, _grey(points), ()
    scene = parse_usdz(path) if kind == ".usdz" else read_glb(content, str(path))
    return *joined_parts(scene.parts), scene.remarks


def _grey(points: Float64[Array, "n 3"]) -> UInt8[Array, "n 3"]:
    return np.full((len(points), 3), GREY, dtype=np.uint8)


def _other_content(path: Path, head: bytes) -> str | None:
    """Format of a file whose extension is wrong. None if they match or the format is unknown."""
    letters, between = head[:_SIGN:2], head[1:_SIGN:2]
    kind = path.suffix.lower()
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return None if kind == ".obj" else "text in UTF-16"
    if len(between) > 0 and not any(between) and all(letters):
        return "text in UTF-16 without a byte-order mark"
    head = head.lstrip()
    if kind != ".ply" and re.match(rb"ply[ \t]*[\r\n]", head):
        return "a PLY"
    if kind != ".glb" and head.startswith(b"glTF"):
        return "a GLB"
    if kind != ".stl" and head.startswith(b"solid") and b"facet" in head:
        return "an STL"
    if kind in (".ply", ".stl") and re.search(rb"[\r\n]v +\S+ +\S+ +\S+[^\r\n]*[\r\n]+v ", head):
        return "an OBJ"
    is_text = re.search(rb"(?:^|[\r\n])v[ \t]", head) is not None  # comments may contain anything
    return "binary data" if kind == ".obj" and b"\0" in head and not is_text else None


def _cause(path: Path, content: bytes, error: Exception) -> SessionError:
    """The error for a file that a reader could not read, with its most likely cause."""
    head = content[:_HEAD_BYTES]
    commas = _DECIMAL_COMMA.search(head.partition(b"end_header")[2] or head) if _is_text(head) else None
    if commas is not None:
        return decimal_commas(str(path), commas[0].decode())
    return _refused(path, f"a file that cannot be read ({error_text(error)})", _KINDS, "Export it again")


def _is_text(head: bytes) -> bool:
    return b"\0" not in head and (b"format ascii" in head or head.lstrip().startswith(b"solid"))


def _refused(path: Path, found: str, expected: str, remedy: str) -> SessionError:
    return SessionError(str(path), found=found, expected=expected, remedy=remedy)
