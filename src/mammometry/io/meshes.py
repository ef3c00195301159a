"""Triangle meshes in binary PLY: mm, world frame, with any number of properties a vertex."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mammometry.errors import StorageError
from mammometry.geometry.arrays import Array
from mammometry.geometry.mesh import TriangleMesh

_TYPES = {"double": "<f8", "float": "<f4", "uchar": "u1", "int": "<i4", "short": "<i2", "ushort": "<u2", "uint": "<u4"}
_NAMES = {np.dtype(code): name for name, code in _TYPES.items()}
_ALIASES = {
    "float64": "double", "float32": "float", "uint8": "uchar", "int32": "int", "int16": "short", "uint16": "ushort",
    "uint32": "uint",
}  # fmt: skip
_HEADER_LIMIT = 1 << 22


def write_ply(
    path: Path, mesh: TriangleMesh, properties: Mapping[str, Array] | None = None, comments: tuple[str, ...] = ()
) -> None:
    """Write a binary little-endian PLY; positions as double, so that nothing is lost.

    Args:
        path: the file to write.
        mesh: vertices and faces, mm, world frame.
        properties: name → one value a vertex (n), of a type that PLY knows.
        comments: lines for the header.

    Raises:
        ValueError: a property of another length or of a type that PLY does not know.
    """
    columns: dict[str, Array] = {name: mesh.vertices[:, axis] for axis, name in enumerate("xyz")}
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


def read_ply(path: Path) -> tuple[TriangleMesh, dict[str, Array], tuple[str, ...]]:
    """Read a binary little-endian PLY of triangles: the mesh, the other vertex properties, and the comments.

    Raises:
        StorageError: it is not such a file, or it is cut short.
    """
    try:
        data = path.read_bytes()
        end = data.index(b"end_header\n", 0, _HEADER_LIMIT) + len(b"end_header\n")
        counts: dict[str, int] = {}
        columns: list[tuple[str, str]] = []
        comments = []
        for line in data[:end].decode().splitlines():
            word, _, rest = line.partition(" ")
            if word == "format" and rest != "binary_little_endian 1.0":
                raise ValueError(f"format {rest}")
            if word == "comment":
                comments.append(rest)
            elif word == "element":
                name, count = rest.split()
                counts[name] = int(count)
            elif word == "property" and "face" not in counts:
                kind, name = rest.split()
                columns.append((name, _TYPES[_ALIASES.get(kind, kind)]))
        vertices = np.frombuffer(data, dtype=columns, count=counts["vertex"], offset=end)
        corners = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
        faces = np.frombuffer(data, dtype=corners, count=counts["face"], offset=end + vertices.nbytes)
        if np.any(faces["count"] != 3):
            raise ValueError("faces that are no triangles")
        positions = np.stack([vertices[axis].astype(np.float64) for axis in "xyz"], axis=1)
        mesh = TriangleMesh(vertices=positions, faces=np.ascontiguousarray(faces["corners"]))
    except (OSError, ValueError, KeyError, UnicodeDecodeError) as error:
        raise StorageError(
            path.name,
            found=f"a mesh that cannot be read ({error})",
            expected="binary little-endian PLY with triangles",
            remedy="Export the mesh anew",
        ) from None
    others = {name: np.ascontiguousarray(vertices[name]) for name, _ in columns if name not in ("x", "y", "z")}
    return mesh, others, tuple(comments)
