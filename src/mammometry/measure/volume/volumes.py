"""All breasts of one subject, from boundaries to volumes with intervals, and sides that have none."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace
from typing import Literal, cast

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.base.machine.cores import available_cores
from mammometry.base.progress import Progress, no_progress
from mammometry.measure.boundary.boundary import Boundary, TorsoSides
from mammometry.measure.boundary.breasts import NoBreast
from mammometry.measure.trunk.body import Body
from mammometry.measure.volume import boundary_jitter, volume
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.measure.volume.uncertainty import Evidence
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.surface.repair.repair import RepairedSurface


def measure_volumes(
    breasts: Sequence[OpenBreast], evidence: Evidence = Evidence(), *, progress: Progress = no_progress
) -> tuple[VolumeMeasurement, ...]:
    """Close every breast with every fitting wall, and measure it. The wanted wall comes first.

    Args:
        breasts: of one subject (`open_breasts`).
        evidence: what earlier stages know about the errors. The surface and the boundary's jitter are each breast's
            own and need not be given.
        progress: called with the fraction done.

    Raises:
        MeasureError: the wanted wall does not fit, or skin and wall do not make a closed solid.
    """
    measured = measured_or_refused(breasts, evidence, progress=progress)
    for outcome in measured:
        if isinstance(outcome, MeasureError):
            raise outcome
    return tuple(outcome for outcome in measured if not isinstance(outcome, MeasureError))


def measured_or_refused(
    breasts: Sequence[OpenBreast], evidence: Evidence = Evidence(), *, progress: Progress = no_progress
) -> list[VolumeMeasurement | MeasureError]:
    """Measure every breast, side by side, or say why it is refused.

    Args and order as of `measure_volumes`. One side does not stop the other.
    """

    def measured(breast: OpenBreast) -> VolumeMeasurement | MeasureError:
        try:
            return measure_volume(breast, evidence)
        except MeasureError as error:
            return error

    with ThreadPoolExecutor(max(1, min(len(breasts), available_cores()))) as pool:
        waiting = [pool.submit(measured, breast) for breast in breasts]
        for number, _ in enumerate(as_completed(waiting), 1):
            progress(number / len(breasts))
    return [future.result() for future in waiting]


def measure_volume(breast: OpenBreast, evidence: Evidence = Evidence()) -> VolumeMeasurement:
    """Close one breast with every fitting wall, and measure it. The wanted wall comes first.

    Raises:
        MeasureError: the wanted wall does not fit, or skin and wall do not make a closed solid.
    """
    wall, *others = chest_wall.fit_all(breast)
    std_cc = None if breast.is_cast else boundary_jitter.boundary_std_cc(breast, wall)
    own = replace(evidence, surface=breast.surface, boundary_std_cc=std_cc, axis_assumed=_assumed(breast, wall.kind))
    return volume.measure(breast.boundary, wall, breast.settings, alternatives=others, evidence=own)


def _assumed(breast: OpenBreast, kind: str) -> bool:
    """Whether a wall stands on a trunk whose axis is assumed."""
    return not breast.is_cast and breast.walls[kind].sees_the_chest and breast.trunk.assumed


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
