"""The wall that closes a breast at its back. Every result states its name and definition."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from mammometry.base.errors import CrossingError, MeasureError
from mammometry.geometry import TriangleMesh, mesh_kernels
from mammometry.geometry.nearest import point_tree
from mammometry.measure.solid.cut import OpenPart
from mammometry.measure.solid.patch import Closed
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.measure.wall.registry import DEFAULT, in_order
from mammometry.surface.repair.repair import Provenance

_MAX_OFFSET_MM = 40.0
"""Largest plausible mean distance of a wall from a straight one through the boundary, mm. 145 breasts of real women
have 15 ± 4 mm in the middle, and half of it on average."""
_MUCH_UNSEEN = 0.1  # share of a boundary on unmeasured skin from which that explains a crossing; not critical


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChestWall:
    """A triangulated surface that closes a breast."""

    kind: str
    """Its name in the registry (`wall.registry`)."""
    definition: str
    """What surface it is, in one sentence that every result contains."""
    mesh: TriangleMesh
    """The wall within the boundary, open, normals pointing away from the breast, mm, world frame."""
    skin: TriangleMesh
    """The breast's own surface up to the wall, open, mm, world frame."""
    closed: TriangleMesh
    """Skin and wall joined, mm, world frame."""


def fit(breast: OpenBreast, kind: str | None = None) -> ChestWall:
    """One breast or cast closed by a wall.

    Args:
        breast: the breast or cast with its boundary, mm, world frame.
        kind: name of the wall; None: that of the settings.

    Raises:
        MeasureError: the wall does not fit the subject, does not cut the surface, or crosses itself.
    """
    return _close_first(breast, _wanted(breast, kind or breast.settings.wall))


def fit_all(breast: OpenBreast) -> tuple[ChestWall, ...]:
    """A breast or cast closed by each wall that fits, the selected wall first.

    The surface is cut once. Walls other than the selected one are for comparison, and are omitted if they do not fit.

    Raises:
        MeasureError: the selected wall does not fit.
    """
    walls = [fit(breast)]
    for kind in in_order(breast.walls):
        if kind != walls[0].kind:
            with suppress(MeasureError):
                wall = _close(breast, kind)
                # A cylinder through a flat rim is a plane. A wall in front of the skin encloses nothing.
                walls += [wall] if wall.kind == kind and wall.closed.volume_mm3() > 0 else []
    return tuple(walls)


def _wanted(breast: OpenBreast, wanted: str) -> str:
    """Name of the selected wall. Default: a separately measured one, else the subject's."""
    names = in_order(breast.walls)
    if wanted != DEFAULT and wanted not in names:
        raise MeasureError(
            "measure.wall",
            found=wanted,
            expected=f"one of {', '.join((DEFAULT, *names))} for the boundary {breast.boundary.name!r}",
            remedy="Change it with --set measure.wall=default",
        )
    if wanted != DEFAULT:
        return wanted
    if breast.back is not None:
        return next(name for name in names if breast.walls[name].measured)
    return breast.own_base.kind if breast.is_cast else names[0]


def _close_first(breast: OpenBreast, kind: str) -> ChestWall:
    """The selected wall. If the boundary crosses itself on unmeasured skin, the error mentions it."""
    try:
        return _close(breast, kind)
    except CrossingError as error:
        nearest = point_tree(breast.surface.mesh.vertices).query(breast.boundary.points_world, workers=1)[1]
        unseen = float((breast.surface.provenance[nearest] != Provenance.MEASURED).mean())
        if unseen < _MUCH_UNSEEN:
            raise
        raise CrossingError(
            f"boundary {breast.boundary.name!r}",
            found=f"{error.found}; {100 * unseen:.0f} % of it is on unmeasured skin",
            expected=error.expected,
            remedy="Photograph it with more pairs of cameras, from the front or from below, or draw the boundary with "
            "`mammometry edit`, away from unmeasured skin",
            mesh_remedy="Scan it again without holes there, or draw the boundary around them with `mammometry edit`",
        ) from error


def _close(breast: OpenBreast, kind: str) -> ChestWall:
    model = breast.walls[kind]
    closed = model.close(breast)
    if not breast.is_cast:
        _check_plausible(closed, breast.part, kind)
    return ChestWall(
        kind=closed.kind or kind,
        definition=closed.definition or model.definition,
        mesh=closed.wall,
        skin=closed.skin,
        closed=closed.solid,
    )


def _check_plausible(closed: Closed, part: OpenPart, kind: str) -> None:
    """Raise a MeasureError if a wall is too far from a straight one to be a chest."""
    rim = part.mesh.vertices[np.concatenate(part.loops)]
    volume_mm3, area_mm2 = closed.solid.volume_mm3(), closed.wall.area_mm2()
    straight_mm3 = mesh_kernels.volume(closed.skin.vertices, closed.skin.faces, rim.mean(axis=0))
    offset_mm = abs(volume_mm3 - straight_mm3) / max(area_mm2, 1e-9)
    if offset_mm > _MAX_OFFSET_MM:
        raise MeasureError(
            f"{kind} wall",
            found=f"{offset_mm:.0f} mm on average from a straight wall, {volume_mm3 / 1000:.0f} cc in front of it",
            expected=f"at most {_MAX_OFFSET_MM:.0f} mm",
            remedy="Check the boundary in the report's picture, or choose --set measure.wall=default",
        )
