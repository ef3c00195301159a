"""The wall that closes a breast at its back: chosen, named and defined in every result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from mammometry.errors import MeasureError
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.base import Base, base_through
from mammometry.measure.boundary import Boundary
from mammometry.measure.cut import above
from mammometry.measure.settings import MeasureSettings, WallKind
from mammometry.measure.sew import sew
from mammometry.surface.repair import Provenance, RepairedSurface

CAST_WALLS: tuple[WallKind, ...] = ("plane", "convex-cylinder")
"""Walls of a cast: its own base; the data choose."""
TORSO_WALLS: tuple[WallKind, ...] = ("cylinder-membrane", "thorax-fit", "membrane", "plane")
"""Walls of a torso, the default first."""
_SPACING_MM = 2.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChestWall:
    """A triangulated surface that closes a breast."""

    kind: WallKind
    """Its short name."""
    definition: str
    """One sentence that says what surface it is; goes into every result."""
    mesh: TriangleMesh
    """The wall over the boundary, open, its normals pointing away from the breast; mm, world frame."""
    skin: TriangleMesh
    """The breast's own surface up to the wall, open; mm, world frame."""
    closed: TriangleMesh
    """Skin and wall, sewn together; mm, world frame."""


def fit(
    boundary: Boundary,
    surface: RepairedSurface,
    settings: MeasureSettings = MeasureSettings(),
    *,
    kind: WallKind | Literal["default"] | None = None,
    boundaries: Sequence[Boundary] = (),
) -> ChestWall:
    """Close one breast or cast with a wall.

    Args:
        boundary: around it, on the surface; world frame, mm.
        surface: the closed, repaired mesh.
        settings: which wall, and how a trunk is described.
        kind: the wall, instead of the settings' own.
        boundaries: every breast's, so that the trunk's skin can be told from the breasts'.

    Raises:
        MeasureError: the wall does not fit the subject, does not cut the surface, or crosses itself.
    """
    wanted = kind or settings.wall
    fitting = CAST_WALLS if boundary.name == "model" else TORSO_WALLS
    if wanted != "default" and wanted not in fitting:
        raise MeasureError(
            "measure.wall",
            found=wanted,
            expected=f"one of {', '.join(('default', *fitting))} for the boundary {boundary.name!r}",
            remedy="Change it with --set measure.wall=default",
        )
    if boundary.name == "model":
        return _cast_wall(boundary, surface, wanted)
    raise NotImplementedError


def _cast_wall(boundary: Boundary, surface: RepairedSurface, wanted: str) -> ChestWall:
    towards_viewer = _viewer_side(surface, boundary.points_world)
    kind: Literal["plane", "convex-cylinder"] | None = None
    if wanted != "default":
        kind = "plane" if wanted == "plane" else "convex-cylinder"
    base = base_through(boundary.points_world, towards_viewer, kind=kind)
    part = above(surface.mesh, base.height)
    loops = tuple(base.flatten(part.mesh.vertices[loop]) for loop in part.loops)
    wall, closed = sew(
        part,
        loops,
        lambda patch: base.lift(patch.points[patch.n_loop :]),
        spacing_mm=None if base.is_plane else _SPACING_MM,
        subject="base of the model",
    )
    return ChestWall(
        kind="plane" if base.is_plane else "convex-cylinder",
        definition=describe(base),
        mesh=wall,
        skin=part.mesh,
        closed=closed,
    )


def describe(base: Base) -> str:
    """One sentence on what a cast's base is."""
    if base.is_plane:
        return "the cast's own flat base: the plane through the rim that the photographs show"
    return (
        "the cast's own curved base: the circular cylinder, radius "
        f"{1 / base.curvature_per_mm:.0f} mm, bent away from the viewer, through the rim that the photographs show"
    )


def _viewer_side(surface: RepairedSurface, boundary: Float64[Array, "n 3"]) -> Float64[Array, 3]:
    """From the boundary towards what was measured, mm."""
    seen = surface.provenance == Provenance.MEASURED
    points = surface.mesh.vertices[seen] if seen.any() else surface.mesh.vertices
    return points.mean(axis=0) - boundary.mean(axis=0)
