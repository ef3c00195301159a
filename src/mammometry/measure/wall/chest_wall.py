"""The wall that closes a breast at its back: chosen, named and defined in every result."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from mammometry.base.errors import CrossingError, MeasureError
from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.geometry.camera import Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.boundary.breasts import within_outline
from mammometry.measure.boundary.cast_base import Base, base_through
from mammometry.measure.boundary.trace import edge_loop
from mammometry.measure.settings import MeasureSettings, WallKind
from mammometry.measure.solid.cut import OpenPart, above, inside_curve
from mammometry.measure.solid.sew import sew
from mammometry.measure.trunk.thorax import (
    Skin,
    Thorax,
    Trunk,
    find_trunk,
    fit_thorax,
    frame_from_rig,
    frame_from_sides,
    seen_skin,
)
from mammometry.measure.wall.shapes import Sewn, best_plane, coons, flat, membrane, thin_plate
from mammometry.measure.wall.trunk_walls import (
    TrunkChart,
    cylinder_membrane,
    measured_back,
    mirrored,
    tangent,
    thorax_fit,
)
from mammometry.surface.repair import Provenance, RepairedSurface

_SPACING_MM = 2.0
_MUCH_UNSEEN = 0.1


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
    back: TriangleMesh | None = None,
    skin: Skin | None = None,
) -> ChestWall:
    """Close one breast or cast with a wall.

    Args:
        boundary: around it, on the surface; world frame, mm.
        surface: the closed, repaired mesh.
        settings: which wall, and how a trunk is described.
        kind: the wall, instead of the settings' own.
        boundaries: every breast's, so that the trunk's skin can be told from the breasts'.
        rig: the cameras, whose upright is the patient's; without it two boundaries, left and right, must show the way.
        back: the wall as it was measured by itself, mm, world frame; then it is the default.
        skin: what was seen of the whole subject, where that is known already or `surface` is but a part of it.

    Raises:
        MeasureError: the wall does not fit the subject, does not cut the surface, or crosses itself.
    """
    opened = _Opened(
        boundary=boundary, surface=surface, settings=settings, all=boundaries, rig=rig, back=back, seen=skin
    )
    return _close_first(opened, _wanted(opened, kind or settings.wall))


def fit_all(
    boundary: Boundary,
    surface: RepairedSurface,
    settings: MeasureSettings = MeasureSettings(),
    *,
    boundaries: Sequence[Boundary] = (),
    rig: Rig | None = None,
    back: TriangleMesh | None = None,
    skin: Skin | None = None,
) -> tuple[ChestWall, ...]:
    """Close one breast or cast with every wall that fits it, the wanted one first; arguments as for `fit`.

    The surface is cut once. Walls other than the wanted one are information: one that does not fit is left out.

    Raises:
        MeasureError: the wanted wall does not fit.
    """
    opened = _Opened(
        boundary=boundary, surface=surface, settings=settings, all=boundaries, rig=rig, back=back, seen=skin
    )
    walls = [_close_first(opened, _wanted(opened, settings.wall))]
    for kind in _walls_of(opened):
        if kind != walls[0].kind:
            with suppress(MeasureError):
                wall = _close(opened, kind)
                walls += [wall] if wall.kind == kind else []  # a rim that is flat bends no cylinder
    return tuple(walls)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Opened:
    """A breast cut out along its boundary, and what its walls are made of, found when first needed."""

    boundary: Boundary
    surface: RepairedSurface
    settings: MeasureSettings
    all: Sequence[Boundary]
    rig: Rig | None
    back: TriangleMesh | None
    seen: Skin | None

    @property
    def is_cast(self) -> bool:
        return self.boundary.name == "model"

    @property
    def boundaries(self) -> tuple[Boundary, ...]:
        return tuple(self.all) or (self.boundary,)

    @cached_property
    def part(self) -> OpenPart:
        if self.is_cast:
            return above(self.surface.mesh, self.base(None).height)
        name, points = self.boundary.name, self.boundary.points_world
        return inside_curve(self.surface.mesh, edge_loop(name, points, self.surface.mesh))

    def base(self, kind: Literal["plane", "convex-cylinder"] | None) -> Base:
        points = self.boundary.points_world
        return base_through(points, _viewer_side(self.surface, points), kind=kind)

    @cached_property
    def skin(self) -> Skin:
        return seen_skin(self.surface) if self.seen is None else self.seen

    @cached_property
    def trunk(self) -> Trunk:
        frame = _trunk_frame(self.boundaries, self.skin, self.rig)
        height_of = self.boundary.points_world.mean(axis=0)
        return find_trunk(self.skin, frame, self.settings.thorax, height_of=height_of)

    @cached_property
    def beside(self) -> Float64[Array, "n 3"]:
        """Skin outside every breast."""
        return self.skin.points_world[_outside(self.skin.points_world, self.boundaries, self.trunk)]

    @cached_property
    def thorax(self) -> Thorax:
        return fit_thorax(self.trunk, self.beside, self.settings.thorax)


@dataclass(frozen=True, slots=True, kw_only=True)
class WallModel:
    """One way to close a breast."""

    definition: str
    """One sentence that says what surface it is."""
    close: Callable[[_Opened], Sewn]
    """The wall and the closed solid of a breast that was cut out."""


_TRUNK_MEMBRANE = WallModel(
    definition="a membrane in the trunk's cylindrical coordinates: distance from the axis, harmonic within the "
    "boundary; breast means what stands before that surface",
    close=lambda breast: cylinder_membrane(breast.part, breast.trunk),
)
TORSO_WALLS: Mapping[WallKind, WallModel] = MappingProxyType(
    {
        "cylinder-membrane": _TRUNK_MEMBRANE,
        "thorax-fit": WallModel(
            definition="the thorax fitted to the skin beside both breasts (Fourier radius around the trunk's axis), "
            "its misfit on the boundary carried in harmonically",
            close=lambda breast: thorax_fit(breast.part, breast.thorax),
        ),
        "tangent-continuous": WallModel(
            definition="a thin plate in the trunk's cylindrical coordinates through the boundary and the skin 12 to "
            "24 mm outside it, so that it continues that skin's slope",
            close=lambda breast: tangent(breast.part, breast.trunk, breast.beside),
        ),
        "mirrored": WallModel(
            definition="the other side's skin, on which no breast stands, mirrored in the trunk's mid-sagittal plane, "
            "its misfit on the boundary carried in harmonically",
            close=lambda breast: mirrored(
                breast.part, breast.trunk, breast.thorax, breast.skin, breast_mm=breast.settings.breast.fewest_mm
            ),
        ),
        "measured": WallModel(
            definition="the wall as it was measured by itself (wall.ply), its misfit on the boundary carried in "
            "harmonically",
            close=lambda breast: measured_back(breast.part, TrunkChart(trunk=breast.trunk), _back(breast)),
        ),
        "membrane": WallModel(
            definition="the surface of least area through the boundary, as a film of soap would hang in it",
            close=lambda breast: membrane(breast.part),
        ),
        "thin-plate": WallModel(
            definition="the plate of least bending through the boundary: a thin-plate spline over its best plane",
            close=lambda breast: thin_plate(breast.part),
        ),
        "coons": WallModel(
            definition="Coons' bilinearly blended patch between the boundary's four sides",
            close=lambda breast: coons(breast.part),
        ),
        "plane": WallModel(
            definition="the boundary's best-fitting plane, joined to it by a skirt along the plane's normal",
            close=lambda breast: flat(breast.part),
        ),
    }
)
"""Walls of a torso, the default first."""
CAST_WALLS: Mapping[WallKind, WallModel] = MappingProxyType(
    {
        "measured": WallModel(
            definition="the cast's back as it was measured by itself (wall.ply), its misfit on the rim carried in "
            "harmonically",
            close=lambda breast: measured_back(breast.part, best_plane(breast.part), _back(breast)),
        ),
        **{kind: TORSO_WALLS[kind] for kind in ("membrane", "thin-plate", "coons")},
    }
)
"""Walls of a cast beside its own base, ``plane`` or ``convex-cylinder``, which is the default: the data choose."""
_BASES: tuple[WallKind, ...] = ("plane", "convex-cylinder")


def _walls_of(breast: _Opened) -> tuple[WallKind, ...]:
    return (*_BASES, *CAST_WALLS) if breast.is_cast else tuple(TORSO_WALLS)


def _wanted(breast: _Opened, wanted: str) -> str:
    """The wall to take first; a measured one where there is one."""
    fitting = _walls_of(breast)
    if wanted != "default" and wanted not in fitting:
        raise MeasureError(
            "measure.wall",
            found=wanted,
            expected=f"one of {', '.join(('default', *fitting))} for the boundary {breast.boundary.name!r}",
            remedy="Change it with --set measure.wall=default",
        )
    if wanted == "default" and breast.back is not None:
        return "measured"
    if wanted == "default" and not breast.is_cast:
        return next(iter(TORSO_WALLS))
    return wanted


def _close_first(breast: _Opened, kind: str) -> ChestWall:
    """The wanted wall; where the boundary crosses itself on skin that nobody measured, the error says so."""
    try:
        return _close(breast, kind)
    except CrossingError as error:
        nearest = cKDTree(breast.surface.mesh.vertices).query(breast.boundary.points_world, workers=1)[1]
        unseen = float((breast.surface.provenance[nearest] != Provenance.MEASURED).mean())
        if unseen < _MUCH_UNSEEN:
            raise
        raise CrossingError(
            f"boundary {breast.boundary.name!r}",
            found=f"{error.found}; {100 * unseen:.0f} % of it runs over skin that no pair measured",
            expected=error.expected,
            remedy="Photograph it with more pairs of cameras, from the front or from below, or draw the boundary with "
            "`mammometry edit`, clear of the skin that nobody measured",
        ) from error


def _close(breast: _Opened, kind: str) -> ChestWall:
    if breast.is_cast and kind in ("default", *_BASES):
        return _own_base(breast, kind)
    model = (CAST_WALLS if breast.is_cast else TORSO_WALLS)[kind]  # type: ignore[index]  # checked by `_wanted`
    wall, closed = model.close(breast)
    return ChestWall(kind=kind, definition=model.definition, mesh=wall, skin=breast.part.mesh, closed=closed)  # type: ignore[arg-type]


def _own_base(breast: _Opened, wanted: str) -> ChestWall:
    """A cast closed by its base, plane or convex cylinder; by default whichever its rim shows."""
    base = breast.base(None if wanted == "default" else "plane" if wanted == "plane" else "convex-cylinder")
    part = above(breast.surface.mesh, base.height)
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


def _back(breast: _Opened) -> TriangleMesh:
    if breast.back is None:
        raise MeasureError(
            "measured wall",
            found="no wall.ply in the session",
            expected="the wall as a mesh in the session's world frame, mm",
            remedy="Add it, or choose --set measure.wall=default",
        )
    return breast.back


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
