"""Textures of scans: an OBJ with its pictures, and GLB or USDZ files converted to this form."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from mammometry.base.errors import SessionError
from mammometry.base.parse import LimitSettings, error_text, read_bytes
from mammometry.geometry import Array, Float64, TriangleMesh, UInt8
from mammometry.geometry.mesh_files.glb import read_glb
from mammometry.geometry.mesh_files.in_child import read_in_child
from mammometry.geometry.mesh_files.obj import ObjFile, ObjPart, obj_text, parse_obj
from mammometry.geometry.mesh_files.scene import SceneContent, ScenePart
from mammometry.geometry.mesh_files.usdz import read_usdz

_MOST_MIB = 1024  # largest OBJ: ten million triangles as text; those of scanners are a hundred times smaller
_GREY = 128  # sRGB of vertices without a picture
_PICTURE_FORMATS = ("JPEG", "PNG", "WEBP")
_MATERIAL = "m-"  # prefix of our materials' names


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoveredObj:
    """An OBJ's lines and texture coordinates."""

    libraries: tuple[str, ...]
    """Content of its ``mtllib`` lines. Empty without a material file."""
    materials: tuple[str, ...]
    """Materials in the order of their first use."""
    lines: tuple[str, ...]
    """Vertices, faces and uses of materials, without comments and names of parts."""
    points: Float64[Array, "n 3"]
    """Its vertices, in its own unit."""
    uv: Float64[Array, "n 2"]
    """Texture coordinates of each vertex, with (0, 0) at the lower left. NaN if it has none."""
    material: Array
    """Index of each vertex's material (n). −1 if it has none."""

    def text(self, library: str | None) -> str:
        """Text of the OBJ, with materials renamed to m1, m2 and so on.

        Args:
            library: file name of the material file. None: the text has no materials.
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
        """All finite vertices, and their colours.

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
    """Pixels at texture coordinates of a picture that repeats periodically."""
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
        obj: OBJ with texture coordinates.
        pictures: material → its picture, sRGB.
        points: points, in the OBJ's unit.
        otherwise: colours of points without a picture.
        within: largest distance of a point from the surface, in that unit.
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


def parse_covered_obj(path: Path) -> CoveredObj:
    """Read an OBJ. Each vertex gets the texture coordinates and material of its first face.

    Raises:
        SessionError: the file cannot be read, or a line contains no numbers.
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


_MOST_MIB_OF_GLB = 4096  # largest file, as for other meshes


def covered_parts(path: Path, folder: Path, limits: LimitSettings) -> Path | None:
    """Convert a GLB or USDZ with pictures to OBJ, MTL and pictures.

    Args:
        path: the GLB or USDZ.
        folder: empty folder for the files.
        limits: largest size of a picture.

    Returns:
        The OBJ, in the file's unit. None if a part has no picture, because its colours are then stored differently.

    Raises:
        SessionError: it cannot be read, or a picture is too large.
    """
    scene = read_usdz(path) if path.suffix.lower() == ".usdz" else read_in_child(_parse_glb, path)
    parts = [part for part in scene.parts if len(part.faces)]
    if not parts or any(part.uv is None or part.picture is None for part in parts):
        return None
    files = {}
    for number, (name, content) in enumerate(scene.pictures.items()):
        files[name] = _picture_file(path, content, folder / str(number), limits)
    (folder / "a.mtl").write_text("".join(f"newmtl {_MATERIAL}{file}\nmap_Kd {file}\n" for file in files.values()))
    (folder / "a.obj").write_text(_obj(parts, files))
    return folder / "a.obj"


def _parse_glb(path: Path) -> SceneContent:
    content = read_bytes(path, path.name, "a GLB", most_mib=_MOST_MIB_OF_GLB)
    try:
        return read_glb(content, path.name)
    except SessionError:
        raise
    except Exception as error:  # the reader raises many kinds of exceptions for damaged files
        found = f"a file that cannot be read ({error_text(error)})"
        raise SessionError(path.name, found=found, expected="a GLB", remedy="Export it again") from None


def _picture_file(path: Path, content: bytes, stem: Path, limits: LimitSettings) -> str:
    """Write a picture as JPEG or PNG, and return its file name."""
    try:
        with Image.open(io.BytesIO(content), formats=_PICTURE_FORMATS) as picture:
            width, height = picture.size
            if width * height > limits.megapixels * 1e6:
                raise SessionError(
                    path.name, found=f"a picture of {width} × {height} pixels",
                    expected=f"at most {limits.megapixels:g} megapixels", remedy="Export it with a smaller texture",
                )  # fmt: skip
            suffix = {"JPEG": ".jpg", "PNG": ".png"}.get(picture.format or "")
            file = stem.with_suffix(suffix or ".png")
            if suffix is None:
                picture.convert("RGB").save(file)
            else:
                file.write_bytes(content)
    except (OSError, ValueError, SyntaxError) as error:
        found = f"a picture that cannot be read ({error_text(error)})"
        raise SessionError(path.name, found=found, expected="JPEG, PNG or WebP", remedy="Export it again") from None
    return file.name


def _obj(parts: Sequence[ScenePart], files: Mapping[str, str]) -> str:
    covered, before = [], 0
    for part in parts:
        assert part.uv is not None and part.picture is not None  # noqa: PT018
        faces = part.faces + before
        covered.append(
            ObjPart(
                material=f"{_MATERIAL}{files[part.picture]}", points=part.points, faces=faces, uv=part.uv, face_uv=faces
            )
        )
        before += len(part.points)
    return obj_text("a.mtl", covered, exact=True)
