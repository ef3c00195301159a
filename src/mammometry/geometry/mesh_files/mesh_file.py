"""Triangles of other programs' PLY, OBJ, STL, GLB and USDZ files, which mostly do not say their unit."""

from __future__ import annotations

import codecs
import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.base.errors import MammometryError, SessionError
from mammometry.base.parse import LARGEST, error_text, json_value, read_bytes
from mammometry.geometry.arrays import Array, Float64, Int32, Int64, UInt8
from mammometry.geometry.mesh_files.obj import decimal_commas, parse_obj
from mammometry.geometry.mesh_files.ply import parse_ply
from mammometry.geometry.mesh_files.usdz import UsdPart, read_usdz

SUFFIXES = (".ply", ".obj", ".stl", ".glb", ".usdz")
KINDS = "PLY, OBJ, STL, GLB or USDZ"
_KINDS = f"a mesh as {KINDS}"
_MOST_MIB = 4096  # nearly a hundred million triangles as STL; a larger file would fill the memory
_HEAD_BYTES = 65_536  # in which a file shows how it is written
_SIGN = 64  # bytes in which every second one is zero in UTF-16, and in no mesh
_DECIMAL_COMMA = re.compile(rb"\d+,\d+")
_GREY = 128  # sRGB; of a file without colours


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
        grey = np.full((len(obj.points), 3), _GREY, dtype=np.uint8)
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
    """What a file holds that its ending does not say. None where they fit, or nothing is known."""
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
    return np.full((count, 3), _GREY, dtype=np.uint8)


def _refused(path: Path, found: str, expected: str, remedy: str) -> SessionError:
    return SessionError(str(path), found=found, expected=expected, remedy=remedy)
