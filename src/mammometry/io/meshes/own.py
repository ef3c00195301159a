"""Our triangle meshes: PLY in mm, world frame, and textured GLB and OBJ for any viewer.

Units are metres in GLB, as its standard says, and mm in OBJ.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mammometry.base.errors import SessionError, StorageError
from mammometry.base.parse import LARGEST, error_text, number, read_bytes, whole
from mammometry.base.sizes import fitting, subject_extent
from mammometry.geometry import Array, Float64, Int32, TriangleMesh

if TYPE_CHECKING:
    from mammometry.surface.texture.texture_atlas import Atlas

_TYPES = {"double": "<f8", "float": "<f4", "uchar": "u1", "int": "<i4", "short": "<i2", "ushort": "<u2", "uint": "<u4"}
_NAMES = {np.dtype(code): name for name, code in _TYPES.items()}
_ALIASES = {
    "float64": "double", "float32": "float", "uint8": "uchar", "int32": "int", "int16": "short", "uint16": "ushort",
    "uint32": "uint",
}  # fmt: skip
_LIST = re.compile(r"list (?:uchar|uint8) u?int(?:32)? \w+")
_END = b"end_header\n"
_HEADER_LIMIT = 1 << 22  # bytes in which a header must end; ours have a few hundred, and a list of convergence
_MOST_MIB = 4096  # of a whole file: a hundred million vertices


def write_ply(
    path: Path, mesh: TriangleMesh, properties: Mapping[str, Array] | None = None, comments: tuple[str, ...] = ()
) -> None:
    """Write a binary little-endian PLY.

    Positions as float where they are floats, else as double: nothing is lost.

    Args:
        path: the file to write.
        mesh: vertices and faces, mm, world frame.
        properties: name → one value a vertex (n), of a type that PLY knows.
        comments: lines for the header.

    Raises:
        ValueError: a property of another length or of a type that PLY does not know.
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


def read_ply(path: Path) -> tuple[TriangleMesh, dict[str, Array], tuple[str, ...]]:
    """Read a binary little-endian PLY: mesh, other vertex properties, comments.

    Raises:
        StorageError: it is not such a file, or it is cut short.
    """
    expected = "binary little-endian PLY with triangles"
    data = read_bytes(path, path.name, expected, most_mib=_MOST_MIB, refusal=StorageError)
    try:
        start = data.index(_END, 0, _HEADER_LIMIT) + len(_END)
        header = _header(data[:start].decode())
        corners = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
        columns = np.dtype(list(header.columns))
        if start + header.vertices * columns.itemsize + header.faces * corners.itemsize > len(data):
            raise ValueError("fewer vertices or faces than its header says")
        vertices = np.frombuffer(data, dtype=columns, count=header.vertices, offset=start)
        faces = np.frombuffer(data, dtype=corners, count=header.faces, offset=start + vertices.nbytes)
        if np.any(faces["count"] != 3):
            raise ValueError("faces that are no triangles")
        positions = np.stack([vertices[axis].astype(np.float64) for axis in "xyz"], axis=1)
        if not (np.abs(positions) <= LARGEST).all():
            raise ValueError("coordinates that are not finite")
        mesh = TriangleMesh(vertices=positions, faces=np.ascontiguousarray(faces["corners"]))
    except (ValueError, KeyError) as error:
        remedy = "Export the mesh again"
        raise StorageError(
            path.name, found=f"a mesh that cannot be read ({error_text(error)})", expected=expected, remedy=remedy
        ) from None
    others = {name: np.ascontiguousarray(vertices[name]) for name, _ in header.columns if name not in ("x", "y", "z")}
    return mesh, others, header.comments


@dataclass(frozen=True, slots=True, kw_only=True)
class _Header:
    """Description of a PLY's content."""

    vertices: int
    faces: int
    columns: tuple[tuple[str, str], ...]
    """Properties of a vertex: name, NumPy's code."""
    comments: tuple[str, ...]


def _header(text: str) -> _Header:
    """Read a header: vertices, then faces as lists of indices, nothing else."""
    counts: dict[str, int] = {}
    columns: list[tuple[str, str]] = []
    comments: list[str] = []
    lists = 0
    first, *lines = text.splitlines()
    if first != "ply" or "format binary_little_endian 1.0" not in lines:
        raise ValueError("no binary little-endian PLY")
    for line in lines[:-1]:
        word, _, rest = line.partition(" ")
        if word == "comment":
            comments.append(rest)
        elif word == "element":
            name, count = rest.split()
            counts[name] = whole(number(count))
        elif word == "property" and "face" not in counts:
            kind, name = rest.split()
            columns.append((name, _TYPES[_ALIASES.get(kind, kind)]))
        elif word == "property":
            lists += bool(_LIST.fullmatch(rest)) or 2  # any other property of a face makes too many
    if list(counts) != ["vertex", "face"] or lists != 1 or min(counts.values()) < 0:
        raise ValueError("other elements than vertices, then faces of corners alone")
    vertices, faces = counts.values()
    return _Header(vertices=vertices, faces=faces, columns=tuple(columns), comments=tuple(comments))


def read_wall(path: Path) -> TriangleMesh:
    """Read the wall behind a breast, measured by itself.

    Raises:
        SessionError: as `read_ply`, or it is too small or too large for a wall in mm.
    """
    wall = read_ply(path)[0]
    extent = subject_extent(float(np.ptp(wall.vertices, axis=0).max()))
    if not extent.is_possible:
        remedy = f"Export it in millimetres{fitting(extent.mm, [extent])}"
        raise SessionError(path.name, found=f"a wall of which {extent}", expected=extent.expected, remedy=remedy)
    return wall


def write_glb(path: Path, atlas: Atlas) -> None:
    """Write one binary glTF file, with its picture inside, in metres.

    Raises:
        OSError: the disk refuses.
    """
    import trimesh
    from PIL import Image

    from mammometry.surface.texture.texture_atlas import jpeg_of

    vertices, faces, uv = _unwelded(atlas)
    picture = Image.open(io.BytesIO(jpeg_of(atlas)), formats=("JPEG",))
    visual: Any = trimesh.visual
    material = visual.material.PBRMaterial(baseColorTexture=picture, metallicFactor=0.0, roughnessFactor=1.0)
    mesh = trimesh.Trimesh(
        vertices=vertices / 1000.0, faces=faces, visual=visual.TextureVisuals(uv=uv, material=material), process=False
    )
    exported: Any = mesh.export(file_type="glb")
    path.write_bytes(exported)


def write_obj(path: Path, atlas: Atlas) -> None:
    """Write an OBJ with its material and picture (NAME.mtl, NAME.jpg), mm.

    Raises:
        OSError: the disk refuses.
    """
    from mammometry.surface.texture.texture_atlas import jpeg_of

    path.with_suffix(".jpg").write_bytes(jpeg_of(atlas))
    path.with_suffix(".mtl").write_text(material(f"{path.stem}.jpg"))
    path.write_text(obj_text(atlas, f"{path.stem}.mtl"))


def material(picture: str) -> str:
    """Text of a material file: ``skin`` shows the picture, ``wall`` is grey."""
    return f"newmtl skin\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nmap_Kd {picture}\nnewmtl wall\nKd 0.5 0.5 0.5\nKs 0 0 0\n"


def obj_text(atlas: Atlas, library: str, wall: Int32[Array, "k 3"] | None = None) -> str:
    """Text of an OBJ, mm.

    Args:
        atlas: the covered mesh.
        library: name of its material file.
        wall: further faces on the same vertices, without a picture.
    """
    origin, faces, uv = atlas.unwelded()
    corners = np.stack([origin[faces], faces], axis=2) + 1
    return (
        f"# mm, world frame\nmtllib {library}\nusemtl skin\n"
        + _lines("v %.4f %.4f %.4f\n", atlas.mesh.vertices)
        + _lines("vt %.6f %.6f\n", _upwards(uv))
        + _lines("f %d/%d %d/%d %d/%d\n", corners)
        + ("" if wall is None else "usemtl wall\n" + _lines("f %d %d %d\n", wall + 1))
    )


def _lines(line: str, rows: Array) -> str:
    """Every row as a line of text. All in one go, for there are hundreds of thousands."""
    return line * len(rows) % tuple(rows.ravel().tolist())


def _unwelded(atlas: Atlas) -> tuple[Float64[Array, "n 3"], Int32[Array, "m 3"], Float64[Array, "n 2"]]:
    """Vertices, faces and texture coordinates, each vertex once a chart.

    Texture coordinates run from (0, 0), lower left, to (1, 1), upper right.
    """
    origin, faces, uv = atlas.unwelded()
    return atlas.mesh.vertices[origin], faces, _upwards(uv)


def _upwards(uv: Float64[Array, "n 2"]) -> Float64[Array, "n 2"]:
    return np.column_stack([uv[:, 0], 1.0 - uv[:, 1]])
