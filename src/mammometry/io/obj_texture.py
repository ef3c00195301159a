"""Texture of an OBJ: which vertex lies where in which picture.

The geometry is read by `geometry.mesh_file`. Nothing but the OBJ itself is opened here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mammometry.base.errors import SessionError
from mammometry.base.parse import read_bytes
from mammometry.geometry.arrays import Array, Float64, UInt8

_MOST_MIB = 1024  # ten million triangles as text; scanners write a hundredth
_GREY = 128  # sRGB; of what no picture covers
_KEPT = ("v", "vt", "vn", "f")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoveredObj:
    """An OBJ's lines, and where its vertices lie in pictures."""

    library: str
    """Name of its material file. Empty: none."""
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
                body.append(f"usemtl m{number[line[7:]]}")
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
            height, width = picture.shape[:2]
            u, v = (self.uv[mine] % 1.0).T
            column = np.minimum((u * width).astype(int), width - 1)
            row = np.minimum(((1.0 - v) * height).astype(int), height - 1)
            found[mine] = picture[row, column]
        finite = np.isfinite(self.points).all(axis=1)
        return self.points[finite], found[finite]


def read_covered_obj(path: Path) -> CoveredObj:
    """Read an OBJ's vertices, their places in pictures, and its materials.

    Raises:
        SessionError: the file cannot be read, or a line holds no numbers.
    """
    content = read_bytes(path, path.name, "an OBJ", most_mib=_MOST_MIB)
    points: list[tuple[float, ...]] = []
    places: list[tuple[float, ...]] = []
    of_vertex: dict[int, tuple[int, int]] = {}
    materials: dict[str, int] = {}
    lines: list[str] = []
    library, current = "", -1
    try:
        for line in _lines(content):
            word, _, rest = line.partition(" ")
            if word == "v":
                points.append(_numbers(rest, 3))
            elif word == "vt":
                places.append(_numbers(rest, 2))
            elif word == "f":
                for corner in rest.split():
                    vertex, _, place = corner.partition("/")
                    place = place.partition("/")[0]
                    key = _index(vertex, len(points))
                    if key not in of_vertex:
                        of_vertex[key] = (_index(place, len(places)) if place else -1, current)
            elif word == "usemtl":
                current = materials.setdefault(rest.strip(), len(materials))
                line = f"usemtl {rest.strip()}"
            elif word == "mtllib":
                library = library or rest.strip()
            if word in _KEPT or word == "usemtl":
                lines.append(line)
        there = np.array(points, dtype=np.float64).reshape(-1, 3)
        uv = np.full((len(there), 2), np.nan)
        material = np.full(len(there), -1, dtype=np.int64)
        every = np.array(places, dtype=np.float64).reshape(-1, 2)
        for vertex_at, (place_at, number) in of_vertex.items():
            material[vertex_at] = number
            if place_at >= 0:
                uv[vertex_at] = every[place_at]
    except (ValueError, IndexError, OverflowError):
        raise SessionError(
            path.name, found="a line without its numbers", expected="a whole OBJ", remedy="Export it again"
        ) from None  # fmt: skip
    return CoveredObj(
        library=library, materials=tuple(materials), lines=tuple(lines), points=there, uv=uv, material=material
    )


def _lines(content: bytes) -> Iterator[str]:
    """Lines, each with single blanks where words part; one that goes on behind a backslash is joined."""
    text = content.decode("utf-8", "replace").replace("\\\r\n", " ").replace("\\\n", " ")
    for line in text.splitlines():
        yield line.strip().replace("\t", " ")


def _numbers(rest: str, count: int) -> tuple[float, ...]:
    words = rest.split()[:count]
    if len(words) < count:
        raise ValueError
    return tuple(map(float, words))


def _index(word: str, count: int) -> int:
    """A one-based or negative number of an OBJ as an index."""
    number = int(word)
    index = number - 1 if number > 0 else count + number
    if not 0 <= index < count:
        raise IndexError
    return index
