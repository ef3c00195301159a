"""The wall that closes a breast at its back: chosen, named and defined in every result."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from mammometry.errors import MeasureError
from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.geometry.camera import Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.base import Base, base_through
from mammometry.measure.boundary import Boundary
from mammometry.measure.breasts import within_outline
from mammometry.measure.cut import OpenPart, above, inside_curve
from mammometry.measure.settings import MeasureSettings, WallKind
from mammometry.measure.sew import sew
from mammometry.measure.thorax import Skin, Trunk, find_trunk, fit_thorax, frame_from_rig, frame_from_sides, seen_skin
from mammometry.measure.trace import edge_loop
from mammometry.measure.wall_shapes import cylinder_membrane, flat, membrane, thorax_fit
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
    rig: Rig | None = None,
) -> ChestWall:
    """Close one breast or cast with a wall.

    Args:
        boundary: around it, on the surface; world frame, mm.
        surface: the closed, repaired mesh.
        settings: which wall, and how a trunk is described.
        kind: the wall, instead of the settings' own.
        boundaries: every breast's, so that the trunk's skin can be told from the breasts'.
        rig: the cameras, whose upright is the patient's; without it two boundaries, left and right, must show the way.

    Raises:
        MeasureError: the wall does not fit the subject, does not cut the surface, or crosses itself.
    """
    wanted = _allowed(boundary, kind or settings.wall)
    if boundary.name == "model":
        return _cast_wall(boundary, surface, wanted)
    return _torso_wall(boundary, _torso(boundary, surface, settings, boundaries, rig), wanted)


def fit_all(
    boundary: Boundary,
    surface: RepairedSurface,
    settings: MeasureSettings = MeasureSettings(),
    *,
    boundaries: Sequence[Boundary] = (),
    rig: Rig | None = None,
) -> tuple[ChestWall, ...]:
    """Close one breast or cast with every wall that fits it, the wanted one first; arguments as for `fit`.

    The surface is cut once. Walls other than the wanted one are information: one that does not fit is left out.

    Raises:
        MeasureError: the wanted wall does not fit.
    """
    wanted = _allowed(boundary, settings.wall)
    if boundary.name == "model":
        kinds: Sequence[str] = CAST_WALLS
        close = partial(_cast_wall, boundary, surface)
    else:
        kinds = TORSO_WALLS
        close = partial(_torso_wall, boundary, _torso(boundary, surface, settings, boundaries, rig))
    walls = [close(wanted)]
    for kind in kinds:
        if kind != walls[0].kind:
            with suppress(MeasureError):
                walls.append(close(kind))
    return tuple(walls)


def _allowed(boundary: Boundary, wanted: str) -> str:
    fitting = CAST_WALLS if boundary.name == "model" else TORSO_WALLS
    if wanted != "default" and wanted not in fitting:
        raise MeasureError(
            "measure.wall",
            found=wanted,
            expected=f"one of {', '.join(('default', *fitting))} for the boundary {boundary.name!r}",
            remedy="Change it with --set measure.wall=default",
        )
    return wanted


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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Torso:
    """What all walls of one breast are made of."""

    part: OpenPart
    skin: Skin
    settings: MeasureSettings
    boundaries: tuple[Boundary, ...]
    rig: Rig | None

    def trunk(self, boundary: Boundary) -> Trunk:
        frame = _trunk_frame(self.boundaries, self.skin, self.rig)
        return find_trunk(self.skin, frame, self.settings.thorax, height_of=boundary.points_world.mean(axis=0))


def _torso(
    boundary: Boundary,
    surface: RepairedSurface,
    settings: MeasureSettings,
    boundaries: Sequence[Boundary],
    rig: Rig | None,
) -> _Torso:
    part = inside_curve(surface.mesh, edge_loop(boundary.name, boundary.points_world, surface.mesh))
    return _Torso(
        part=part,
        skin=seen_skin(surface),
        settings=settings,
        boundaries=tuple(boundaries) or (boundary,),
        rig=rig,
    )


def _torso_wall(boundary: Boundary, torso: _Torso, wanted: str) -> ChestWall:
    part = torso.part
    kind: WallKind
    if wanted == "plane":
        kind, (wall, closed) = "plane", flat(part)
        definition = "the boundary's best-fitting plane, joined to it by a skirt along the plane's normal"
    elif wanted == "membrane":
        kind, (wall, closed) = "membrane", membrane(part)
        definition = "a membrane through the boundary: height over its best-fitting plane, harmonic inside"
    elif wanted == "thorax-fit":
        trunk = torso.trunk(boundary)
        beside = _outside(torso.skin.points_world, torso.boundaries, trunk)
        thorax = fit_thorax(trunk, torso.skin.points_world[beside], torso.settings.thorax)
        kind, (wall, closed) = "thorax-fit", thorax_fit(part, thorax)
        definition = (
            "the thorax fitted to the skin beside both breasts (Fourier radius around the trunk's axis), "
            "its misfit on the boundary carried in harmonically"
        )
    else:
        kind, (wall, closed) = "cylinder-membrane", cylinder_membrane(part, torso.trunk(boundary))
        definition = (
            "a membrane in the trunk's cylindrical coordinates: distance from the axis, harmonic within the boundary; "
            "breast means what stands before that surface"
        )
    return ChestWall(kind=kind, definition=definition, mesh=wall, skin=part.mesh, closed=closed)


def _trunk_frame(boundaries: Sequence[Boundary], skin: Skin, rig: Rig | None) -> Float64[Array, "3 3"]:
    if rig is not None:
        return frame_from_rig(rig)
    by_name = {boundary.name: boundary.points_world for boundary in boundaries}
    if not {"left", "right"} <= by_name.keys():
        raise MeasureError(
            "chest wall",
            found="neither cameras nor a boundary on each side",
            expected="one of the two, to tell the patient's left from right and head from foot",
            remedy="Give both boundaries, or choose --set measure.wall=membrane",
        )
    return frame_from_sides(by_name["left"], by_name["right"], skin)


def _outside(points: Float64[Array, "n 3"], boundaries: Sequence[Boundary], trunk: Trunk) -> Bool[Array, " n"]:
    """Points beside every breast, with the trunk laid flat."""
    flat = trunk.cylindrical(points)[:, :2]
    keep = np.ones(len(points), dtype=bool)
    for boundary in boundaries:
        keep &= ~within_outline(flat, trunk.cylindrical(boundary.points_world)[:, :2])
    return keep


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
