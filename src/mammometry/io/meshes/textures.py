"""Textures of scans: an OBJ with its pictures, and GLB or USDZ written out as one."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.base.errors import SessionError
from mammometry.base.parse import LimitSettings, error_text, read_bytes
from mammometry.geometry import Array, Float64, Int64, TriangleMesh, UInt8
from mammometry.geometry.mesh_files.mesh_file import check_glb
from mammometry.geometry.mesh_files.obj import ObjFile, parse_obj
from mammometry.geometry.mesh_files.usdz import read_usdz

_MOST_MIB = 1024  # ten million triangles as text; scanners write a hundredth
_GREY = 128  # sRGB; of what no picture covers


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoveredObj:
    """An OBJ's lines, and where its vertices lie in pictures."""

    libraries: tuple[str, ...]
    """What its ``mtllib`` lines say, as it stands. Empty: no material file."""
    materials: tuple[str, ...]
    """Materials in the order of their first use."""
    lines: tuple[str, ...]
    """Vertices, faces and uses of materials; no comments and no names of parts."""
    points: Float64[Array, "n 3"]
    """Its vertices, in its own unit."""
    uv: Float64[Array, "n 2"]
    """Place of each vertex in its picture, (0, 0) lower left. NaN: in none."""
    material: Array
    """Number of each vertex's material (n). −1: none."""

    def text(self, library: str | None) -> str:
        """Text of the OBJ with neutral names: materials m1 and so on.

        Args:
            library: file name of the material file. None: without materials.
        """
        head = [] if library is None else [f"mtllib {library}"]
        number = {name: place for place, name in enumerate(self.materials, 1)}
        body = []
        for line in self.lines:
            if not line.startswith("usemtl "):
                body.append(line)
            elif library is not None:
                body.append(f"usemtl m{number[line[7:].strip()]}")
        return "\n".join([*head, *body]) + "\n"

    def colours(
        self, pictures: Mapping[str, UInt8[Array, "h w 3"]]
    ) -> tuple[Float64[Array, "n 3"], UInt8[Array, "n 3"]]:
        """Return all finite vertices, and the colour of each.

        Args:
            pictures: material → its picture, sRGB.
        """
        rgb = np.full((len(self.points), 3), _GREY, dtype=np.uint8)
        for number, name in enumerate(self.materials):
            picture = pictures.get(name)
            mine = np.flatnonzero((self.material == number) & np.isfinite(self.uv).all(axis=1))
            if picture is None or not len(mine):
                continue
            rgb[mine] = _pixels(picture, self.uv[mine])
        finite = np.isfinite(self.points).all(axis=1)
        return self.points[finite], rgb[finite]


def _pixels(picture: UInt8[Array, "h w 3"], uv: Float64[Array, "n 2"]) -> UInt8[Array, "n 3"]:
    """Pixels at places in a picture, which repeats itself."""
    height, width = picture.shape[:2]
    u, v = (uv % 1.0).T
    column = np.minimum((u * width).astype(int), width - 1)
    row = np.minimum(((1.0 - v) * height).astype(int), height - 1)
    return picture[row, column]


def texture_at(
    obj: ObjFile,
    pictures: Mapping[str, UInt8[Array, "h w 3"]],
    points: Float64[Array, "n 3"],
    otherwise: UInt8[Array, "n 3"],
    within: float,
) -> UInt8[Array, "n 3"]:
    """Colours of an OBJ's pictures at points near its surface.

    Args:
        obj: with places in pictures.
        pictures: material → its picture, sRGB.
        points: in the OBJ's unit.
        otherwise: colours of points that no picture covers.
        within: distance from the surface up to which a point is on it, in that unit.
    """
    from mammometry.geometry.nearest import barycentric, closest_on_mesh

    closest = closest_on_mesh(points, TriangleMesh(vertices=obj.points, faces=obj.faces.astype(np.int32)))
    places = obj.face_uv[closest.faces]
    weights = barycentric(closest.points, obj.points[obj.faces[closest.faces]])
    uv = np.einsum("nk,nkj->nj", weights, obj.uv[places])
    there = (places >= 0).all(axis=1) & (closest.distances_mm < within) & np.isfinite(uv).all(axis=1)
    colours = otherwise.copy()
    for number, name in enumerate(obj.materials):
        mine = there & (obj.face_material[closest.faces] == number)
        if name in pictures:
            colours[mine] = _pixels(pictures[name], uv[mine])
    return colours


def read_covered_obj(path: Path) -> CoveredObj:
    """Read an OBJ's vertices, their places in pictures, and its materials.

    A vertex has the place and the material of the first face that names it.

    Raises:
        SessionError: the file cannot be read, or a line holds no numbers.
    """
    obj = parse_obj(read_bytes(path, path.name, "an OBJ", most_mib=_MOST_MIB), path.name)
    uv = np.full((len(obj.points), 2), np.nan)
    material = np.full(len(obj.points), -1, dtype=np.int64)
    used, first = np.unique(obj.faces, return_index=True)  # in the order of faces
    material[used] = obj.face_material[first // 3]
    place = obj.face_uv.ravel()[first]
    uv[used[place >= 0]] = obj.uv[place[place >= 0]]
    return CoveredObj(
        libraries=obj.libraries, materials=obj.materials, lines=obj.lines, points=obj.points, uv=uv, material=material
    )


_MOST_MIB_OF_GLB = 4096  # of a file, as of other meshes


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
    content = read_bytes(path, path.name, "a GLB", most_mib=_MOST_MIB_OF_GLB)
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
        remedy = "Export it again"
        raise SessionError(
            path.name, found=f"a file that cannot be read ({error_text(error)})", expected="a GLB", remedy=remedy
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
