"""Sides that are not measured, and why: their volume was refused, or they are said to have no breast."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, cast

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.measure.boundary.boundary import Boundary, TorsoSides
from mammometry.measure.boundary.breasts import NoBreast
from mammometry.measure.trunk.body import Body
from mammometry.measure.volume.volumes import measure_volume
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.surface.repair.repair import RepairedSurface

_ASIDE_MM = 80.0  # of the midline, where a removed breast is marked; a breast's middle lies so far aside


def refused_side(breast: OpenBreast) -> NoBreast:
    """Why a side of a torso has no volume, by another attempt.

    Args:
        breast: whose volume was refused.

    """
    points = breast.boundary.points_world
    vertices = breast.surface.mesh.vertices
    why = "The errors that the earlier stages left make its volume uncertain by more than half"
    try:
        measure_volume(breast)
    except MeasureError as error:
        why = f"{error.subject}: found {error.found}, expected {error.expected}"
    return NoBreast(
        name=cast(Literal["left", "right"], breast.boundary.name),
        place_world=vertices[np.linalg.norm(vertices - points.mean(axis=0), axis=1).argmin()],
        standing=None,
        why=why,
        unclear=True,
        refused=True,
    )


def wanted_boundaries(sides: TorsoSides, removed: Sequence[str], *, required: bool) -> tuple[Boundary, ...]:
    """Boundaries that were found, but for sides that are said to be removed.

    Args:
        sides: what was found.
        removed: sides that are said to be removed.
        required: whether one must be left.

    Raises:
        MeasureError: neither side has a breast, though nobody said that both were removed.
    """
    wanted = tuple(boundary for boundary in sides.boundaries if boundary.name not in removed)
    if wanted or not required:
        return wanted
    why = "; ".join(f"{side.name}: {side.why}" for side in sides.absent if side.name not in removed)
    raise MeasureError(
        "torso",
        found=f"no breast on either side ({why})",
        expected="one on at least one side, unless both are said to be removed",
        remedy="Draw the boundaries with `mammometry edit`, or say in boundaries.json that a side was removed: "
        '{"boundaries": {"left": {"removed": true}, "right": {"removed": true}}}',
        mesh_remedy="Draw the boundaries with `mammometry edit`, or say in their file that a side was removed",
    )


def removed_side(name: Literal["left", "right"], body: Body, surface: RepairedSurface) -> NoBreast:
    """A side whose breast is said to be removed."""
    aside = body.left if name == "left" else -body.left
    vertices = surface.mesh.vertices
    from_middle = (vertices - body.point_world) @ np.stack([aside, body.up, body.frame[2]], axis=1)
    distance = np.hypot(from_middle[:, 0] - _ASIDE_MM, from_middle[:, 1]) - from_middle[:, 2]
    return NoBreast(name=name, place_world=vertices[np.argmin(distance)], standing=None, why="It is said to be removed")
