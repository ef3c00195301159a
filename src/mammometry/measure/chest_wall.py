"""The wall that closes a breast at its back: chosen, named and defined in every result."""

from __future__ import annotations

from dataclasses import dataclass

from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.settings import WallKind


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChestWall:
    """A triangulated surface that spans a boundary."""

    kind: WallKind
    """Its short name."""
    definition: str
    """One sentence that says what surface it is; goes into every result."""
    mesh: TriangleMesh
    """The wall over the boundary, open, its normals pointing away from the breast; mm, world frame."""
