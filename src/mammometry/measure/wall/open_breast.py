"""A breast cut out along its boundary, with the inputs of its walls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.base.registry import Registry
from mammometry.geometry import Array, Bool, Float64, TriangleMesh
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.boundary.breasts import within_outline
from mammometry.measure.boundary.cast_base import Base, BaseKind, base_through
from mammometry.measure.boundary.trace import check_beside_holes, edge_loop
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.solid.cut import OpenPart, above, check_above_base, check_whole, inside_curve
from mammometry.measure.trunk.thorax import (
    SkinSamples,
    Thorax,
    Trunk,
    find_trunk,
    fit_thorax,
    frame_from_sides,
    seen_skin,
)
from mammometry.measure.wall.registry import CAST_WALLS, TORSO_WALLS, WallModel
from mammometry.surface.repair.repair import Provenance, RepairedSurface


@dataclass(frozen=True, kw_only=True, eq=False)
class OpenBreast:
    """One breast or cast with its boundary. Cut and trunk are computed on first use."""

    boundary: Boundary
    """On the surface, mm, world frame."""
    surface: RepairedSurface
    """The closed, repaired mesh."""
    settings: MeasureSettings = field(default_factory=MeasureSettings)
    """Settings of the measurement, such as the selected wall."""
    boundaries: Sequence[Boundary] = ()
    """Boundaries of all breasts including this one, which separate the trunk's skin from theirs. Empty: this breast is
    the only one."""
    frame: Float64[Array, "3 3"] | None = None
    """Body frame (`measure.trunk.body`), rows: the patient's left, the head, straight ahead. None: it follows from the
    left and right boundaries."""
    back: TriangleMesh | None = None
    """Separately measured wall (wall.ply), mm, world frame; then the default."""
    seen: SkinSamples | None = None
    """Visible skin, if already known."""
    cut: OpenPart | None = None
    """Its skin cut out of the surface, if already known."""

    @property
    def is_cast(self) -> bool:
        """Whether it is a cast, with a base instead of a chest."""
        return self.boundary.name == "model"

    @property
    def walls(self) -> Registry[WallModel]:
        """Walls that can close it."""
        return CAST_WALLS if self.is_cast else TORSO_WALLS

    @cached_property
    def part(self) -> OpenPart:
        """The breast's skin, cut out of the surface. The cut is its only opening.

        Raises:
            MeasureError: the boundary cannot be followed on the surface, or does not enclose a complete breast.
        """
        name, mesh = self.boundary.name, self.surface.mesh
        if self.is_cast:
            return self.above(self.own_base)
        part = self.cut
        if part is None:
            part = inside_curve(mesh, edge_loop(name, self.boundary.points_world, mesh))
        check_whole(name, part)
        check_beside_holes(name, self.boundary.points_world, part, mesh)
        return part

    def above(self, base: Base) -> OpenPart:
        """A cast's skin above a base, with the base as the only opening.

        Raises:
            MeasureError: there is a hole above the base.
        """
        part = above(self.surface.mesh, base.height)
        check_above_base(part, base.height)
        return part

    @cached_property
    def own_base(self) -> Base:
        """A cast's base, plane or convex cylinder, depending on its rim."""
        return self._base_through(None)

    def base_as(self, kind: BaseKind) -> Base:
        """A cast's base as a plane, or as a convex cylinder. A cylinder through a flat rim is a plane."""
        return self.own_base if self.own_base.kind == kind else self._base_through(kind)

    def _base_through(self, kind: BaseKind | None) -> Base:
        points = self.boundary.points_world
        measured = self.surface.provenance == Provenance.MEASURED
        skin = self.surface.mesh.vertices[measured] if measured.any() else self.surface.mesh.vertices
        return base_through(points, skin.mean(axis=0) - points.mean(axis=0), kind=kind)

    @cached_property
    def skin(self) -> SkinSamples:
        """Visible skin of the whole subject."""
        return seen_skin(self.surface) if self.seen is None else self.seen

    @cached_property
    def body_frame(self) -> Float64[Array, "3 3"] | None:
        """Body frame, as given or from a boundary on each side. None if unknown."""
        if self.frame is not None:
            return self.frame
        curves = {boundary.name: boundary.points_world for boundary in self._all_boundaries()}
        if not {"left", "right"} <= curves.keys():
            return None
        return frame_from_sides(curves["left"], curves["right"], self.skin)

    @cached_property
    def trunk(self) -> Trunk:
        """The trunk's axis at the height of this breast.

        Raises:
            MeasureError: the body frame is unknown, or no skin of the sides is visible.
        """
        frame = self.body_frame
        if frame is None:
            raise MeasureError(
                "chest wall",
                found="no boundary on each side",
                expected="both, or the body's directions, to find the patient's left, right, head and foot",
                remedy="Give both boundaries, or choose --set measure.wall=membrane",
            )
        height_of = self.boundary.points_world.mean(axis=0)
        return find_trunk(self.skin, frame, height_of=height_of)

    @cached_property
    def beside(self) -> Float64[Array, "n 3"]:
        """Visible skin outside every breast, mm, world frame."""
        return self._skin_beside.points_world

    @cached_property
    def _skin_beside(self) -> SkinSamples:
        return self.skin.chosen(_outside(self.skin.points_world, self._all_boundaries(), self.trunk))

    @cached_property
    def thorax(self) -> Thorax:
        """Smooth radius of the trunk without breasts."""
        return fit_thorax(self.trunk, self._skin_beside)

    def _all_boundaries(self) -> tuple[Boundary, ...]:
        return tuple(self.boundaries) or (self.boundary,)


def open_breasts(
    boundaries: Sequence[Boundary],
    surface: RepairedSurface,
    settings: MeasureSettings = MeasureSettings(),
    *,
    frame: Float64[Array, "3 3"] | None = None,
    back: TriangleMesh | None = None,
) -> tuple[OpenBreast, ...]:
    """All breasts of one subject, which share the visible skin.

    Args:
        boundaries: one for each breast.
        surface: the closed, repaired mesh, mm, world frame.
        settings: settings of the measurement.
        frame: body frame, rows: the patient's left, the head, straight ahead.
        back: separately measured wall, mm, world frame.
    """
    seen = None if all(boundary.name == "model" for boundary in boundaries) else seen_skin(surface)
    return tuple(
        OpenBreast(
            boundary=boundary,
            surface=surface,
            settings=settings,
            boundaries=tuple(boundaries),
            frame=frame,
            back=back,
            seen=seen,
        )
        for boundary in boundaries
    )


def _outside(points: Float64[Array, "n 3"], boundaries: Sequence[Boundary], trunk: Trunk) -> Bool[Array, " n"]:
    """Points outside every boundary on the flattened trunk."""
    flat = trunk.cylindrical(points)[:, :2]
    keep = np.ones(len(points), dtype=bool)
    for boundary in boundaries:
        keep &= ~within_outline(flat, trunk.cylindrical(boundary.points_world)[:, :2])
    return keep
