"""Texture of an OBJ: which vertex lies where in which picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mammometry.base.parse import read_bytes
from mammometry.geometry.arrays import Array, Float64, UInt8
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.mesh_files.obj import ObjFile, parse_obj

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
        """The same OBJ under names of ours, materials m1 and so on.

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
        found = np.full((len(self.points), 3), _GREY, dtype=np.uint8)
        for number, name in enumerate(self.materials):
            picture = pictures.get(name)
            mine = np.flatnonzero((self.material == number) & np.isfinite(self.uv).all(axis=1))
            if picture is None or not len(mine):
                continue
            found[mine] = _pixels(picture, self.uv[mine])
        finite = np.isfinite(self.points).all(axis=1)
        return self.points[finite], found[finite]


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
