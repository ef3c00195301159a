"""Photographic colour of the surface: each vertex from the photographs that see it best."""

from __future__ import annotations

from dataclasses import dataclass

from mammometry.geometry.arrays import Array, UInt8, read_only
from mammometry.geometry.mesh import TriangleMesh


@dataclass(frozen=True, slots=True, kw_only=True)
class TextureSettings:
    """How photographs are blended on the surface."""

    occlusion_mm: float = 2.0
    """A vertex further than this behind the nearest surface along a camera's ray is hidden from it, mm."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TexturedMesh:
    """A mesh with a colour per vertex."""

    mesh: TriangleMesh
    """World frame, mm."""
    colours: UInt8[Array, "n 3"]
    """sRGB-encoded colour of each vertex; mid grey where no camera sees it."""

    def __post_init__(self) -> None:
        if len(self.colours) != len(self.mesh.vertices):
            raise ValueError(f"{len(self.mesh.vertices)} vertices but {len(self.colours)} colours")
        object.__setattr__(self, "colours", read_only(self.colours))
