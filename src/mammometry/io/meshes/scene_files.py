"""A GLB or USDZ with its pictures, written out as an OBJ with a material file and pictures."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.base.errors import SessionError
from mammometry.base.parse import LimitSettings, error_text, read_bytes
from mammometry.geometry.arrays import Array, Float64, Int64
from mammometry.geometry.mesh_files.mesh_file import check_glb
from mammometry.geometry.mesh_files.usdz import read_usdz

_MOST_MIB = 4096  # of a file, as of other meshes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Part:
    """A part of a scene with one picture."""

    points: Float64[Array, "n 3"]
    faces: Int64[Array, "m 3"]
    uv: Float64[Array, "n 2"]
    """Place of each point in the picture, (0, 0) lower left."""
    picture: int
    """Number of the picture."""


def covered_parts(path: Path, folder: Path, limits: LimitSettings) -> Path | None:
    """Write a GLB or USDZ with pictures as OBJ, MTL and pictures.

    Args:
        path: of the GLB or USDZ.
        folder: empty, for the files.
        limits: size that a picture may have.

    Returns:
        The OBJ, in the file's unit. None where a part has no picture: its colours lie elsewhere.

    Raises:
        SessionError: it cannot be read, or a picture is too large.
    """
    if path.suffix.lower() == ".usdz":
        return _covered_usdz(path, folder)
    content = read_bytes(path, path.name, "a GLB", most_mib=_MOST_MIB)
    check_glb(path, content)
    pictures: list[Any] = []
    try:
        parts = _parts(content, pictures)
        if parts is None:
            return None
        for number, picture in enumerate(pictures):
            if math.prod(picture.size) > limits.megapixels * 1e6:
                raise SessionError(
                    path.name, found=f"a picture of {picture.size[0]} × {picture.size[1]} pixels",
                    expected=f"at most {limits.megapixels:g} megapixels", remedy="Export it with a smaller texture",
                )  # fmt: skip
            picture.convert("RGB").save(folder / f"{number}.png")
    except SessionError:
        raise
    except Exception as error:  # the reader raises anything that a damaged file makes it stumble over
        raise SessionError(
            path.name,
            found=f"a file that cannot be read ({error_text(error)})",
            expected="a GLB",
            remedy="Export it again",
        ) from None
    return _written(folder, parts, [f"{number}.png" for number in range(len(pictures))])


def _covered_usdz(path: Path, folder: Path) -> Path | None:
    scene = read_usdz(path)
    names = list(scene.pictures)
    files = [f"{number}{Path(name).suffix.lower()}" for number, name in enumerate(names)]
    parts = [
        _Part(points=part.points, faces=part.faces, uv=part.uv, picture=names.index(part.picture))
        for part in scene.parts
        if part.uv is not None and part.picture is not None
    ]
    if not parts or len(parts) < len(scene.parts):
        return None
    for file, content in zip(files, scene.pictures.values(), strict=True):
        (folder / file).write_bytes(content)
    return _written(folder, parts, files)


def _written(folder: Path, parts: list[_Part], pictures: list[str]) -> Path:
    (folder / "a.mtl").write_text("".join(f"newmtl m{n}\nmap_Kd {file}\n" for n, file in enumerate(pictures)))
    (folder / "a.obj").write_text(_obj(parts))
    return folder / "a.obj"


def _parts(content: bytes, pictures: list[Any]) -> list[_Part] | None:
    """Parts of a scene as they stand in it, with the pictures that cover them."""
    import trimesh

    scene: Any = trimesh.load_scene(io.BytesIO(content), file_type="glb", process=False)
    parts = []
    for node in scene.graph.nodes_geometry:
        place, name = scene.graph[node]
        mesh = scene.geometry[name]
        if not len(getattr(mesh, "faces", ())):
            continue
        uv = getattr(mesh.visual, "uv", None)
        picture = getattr(getattr(mesh.visual, "material", None), "baseColorTexture", None)
        if uv is None or picture is None:
            return None
        if not any(picture is other for other in pictures):
            pictures.append(picture)
        points = np.asarray(mesh.vertices, dtype=np.float64) @ place[:3, :3].T + place[:3, 3]
        parts.append(
            _Part(
                points=points,
                faces=np.asarray(mesh.faces, dtype=np.int64),
                uv=np.asarray(uv, dtype=np.float64),
                picture=next(number for number, other in enumerate(pictures) if other is picture),
            )
        )
    return parts or None


def _obj(parts: list[_Part]) -> str:
    lines, before = ["mtllib a.mtl"], 1
    for part in parts:
        lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in part.points.tolist()]
        lines += [f"vt {u!r} {v!r}" for u, v in part.uv.tolist()]
        lines.append(f"usemtl m{part.picture}")
        lines += [f"f {a}/{a} {b}/{b} {c}/{c}" for a, b, c in (part.faces + before).tolist()]
        before += len(part.points)
    return "\n".join(lines) + "\n"
