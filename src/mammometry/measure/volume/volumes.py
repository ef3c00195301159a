"""Volumes of all breasts of one subject, with their intervals, and sides without a volume."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace
from typing import Literal, cast

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.base.machine.cores import available_cores
from mammometry.base.notices import Notice, words_of
from mammometry.base.progress import Progress, no_progress
from mammometry.measure.boundary.boundary import Boundary, TorsoSides
from mammometry.measure.boundary.breasts import NoBreast
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.trunk.body import BodyDirections
from mammometry.measure.volume import boundary_jitter
from mammometry.measure.volume.measurement import (
    MUSCLE_WALL,
    DefinedVolume,
    HalfWidths,
    VolumeMeasurement,
    define,
    other_terms_cc,
)
from mammometry.measure.volume.sources import WALL, WALL_FIT_U95_MM
from mammometry.measure.volume.uncertainty import Uncertainty, VolumeEvidence, interval
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.chest_wall import ChestWall
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.measure.wall.registry import TORSO_WALLS
from mammometry.surface.repair.repair import RepairedSurface

_WIDEST = 0.5  # largest half-width, as a share of the volume


def measure(
    boundary: Boundary,
    wall: ChestWall,
    settings: MeasureSettings = MeasureSettings(),
    *,
    alternatives: Sequence[ChestWall] = (),
    evidence: VolumeEvidence = VolumeEvidence(),
) -> VolumeMeasurement:
    """Measurement of the solid between skin and wall, exact for the mesh (divergence theorem).

    Args:
        boundary: curve around the breast, mm, world frame.
        wall: fitted to that boundary.
        settings: uncertainties of boundary and wall.
        alternatives: other walls on the same boundary, for comparison.
        evidence: results of earlier stages, for the interval.

    Raises:
        MeasureError: skin and wall do not form a closed solid, or it has no volume.
    """
    watertight = wall.closed.is_watertight()
    volume_cc = wall.closed.volume_mm3() / 1000
    if not watertight or volume_cc <= 0:
        raise MeasureError(
            f"breast {boundary.name!r}",
            found=f"a solid of {volume_cc:.1f} cc that is {'closed' if watertight else 'not closed'}",
            expected="a closed solid with the skin in front of the wall",
            remedy="Check the boundary in the report's picture, or draw it by hand",
        )
    points = boundary.points_world
    normal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][2]
    heights = (wall.skin.vertices - points.mean(axis=0)) @ normal
    area_cm2 = wall.mesh.area_mm2() / 100
    uncertainty = interval(boundary, wall, volume_cc, settings, evidence)
    _require_known(boundary.name, volume_cc, uncertainty)
    return VolumeMeasurement(
        name=boundary.name,
        volume_cc=volume_cc,
        interval_cc=uncertainty.interval_cc,
        as_defined_cc=uncertainty.as_defined_cc,
        interval_terms_cc=uncertainty.terms_cc,
        common_cc=uncertainty.common_cc,
        interval_note=uncertainty.note,
        closed=wall.closed,
        skin_faces=len(wall.skin.faces),
        watertight=watertight,
        wall_kind=wall.kind,
        wall_definition=wall.definition,
        boundary_world=points,
        boundary_method=boundary.method,
        boundary_remarks=boundary.remarks,
        alternatives_cc={other.kind: other.closed.volume_mm3() / 1000 for other in alternatives},
        base_area_cm2=area_cm2,
        projection_mm=float(np.abs(heights).max()),
        area_cm2=wall.skin.area_mm2() / 100,
        definitions=_definitions(boundary, wall, volume_cc, uncertainty, alternatives, settings),
    )


def _require_known(name: str, volume_cc: float, uncertainty: Uncertainty) -> None:
    """Raise a MeasureError if a torso's volume in front of its wall is uncertain by more than half.

    The position of the chest behind the wall does not count: it is unknown for every small breast.
    """
    if uncertainty.as_defined_cc is None:
        return
    low, high = uncertainty.as_defined_cc
    half = max(high - volume_cc, volume_cc - low)
    if half <= _WIDEST * volume_cc:
        return
    largest = sorted(uncertainty.terms_cc.items(), key=lambda term: -term[1])[:2]
    causes = " and ".join(f"{cause} ± {term:.0f} cc" for cause, term in largest)
    raise MeasureError(
        f"breast {name!r}",
        found=f"a volume of {volume_cc:.0f} ± {half:.0f} cc ({causes})",
        expected=f"an uncertainty of at most ± {100 * _WIDEST:.0f} %",
        remedy="Check the boundary in the picture, or draw it with `mammometry edit`",
    )


def _definitions(
    boundary: Boundary,
    wall: ChestWall,
    volume_cc: float,
    uncertainty: Uncertainty,
    alternatives: Sequence[ChestWall],
    settings: MeasureSettings,
) -> tuple[DefinedVolume, ...]:
    if boundary.name == "model" or uncertainty.interval_cc is None:
        return ()
    chest_cc = uncertainty.terms_cc[WALL]
    cylinder = next((candidate for candidate in (wall, *alternatives) if candidate.kind == MUSCLE_WALL), None)
    return define(
        boundary.name,
        wall=wall.kind,
        volume_cc=volume_cc,
        measured_wall=TORSO_WALLS[wall.kind].measured,
        errors=HalfWidths(
            chest_cc=chest_cc,
            fit_cc=min(chest_cc, WALL_FIT_U95_MM * wall.mesh.area_mm2() / 1000),
            other_cc=other_terms_cc(uncertainty.terms_cc, WALL),
        ),
        cylinder=None if cylinder is None else (cylinder.closed.volume_mm3() / 1000, cylinder.mesh.area_mm2() / 100),
        settings=settings.layer,
    )


def measure_volumes(
    breasts: Sequence[OpenBreast], evidence: VolumeEvidence = VolumeEvidence(), *, progress: Progress = no_progress
) -> tuple[VolumeMeasurement, ...]:
    """Measurements of all breasts, each with every wall that fits.

    Args:
        breasts: breasts of one subject (`open_breasts`).
        evidence: results of earlier stages, without surface and boundary jitter, which are found for each breast.
        progress: called with the fraction done.

    Raises:
        MeasureError: the selected wall does not fit, or skin and wall do not form a closed solid.
    """
    measured = measured_or_refused(breasts, evidence, progress=progress)
    for outcome in measured:
        if isinstance(outcome, MeasureError):
            raise outcome
    return tuple(outcome for outcome in measured if not isinstance(outcome, MeasureError))


def measured_or_refused(
    breasts: Sequence[OpenBreast], evidence: VolumeEvidence = VolumeEvidence(), *, progress: Progress = no_progress
) -> list[VolumeMeasurement | MeasureError]:
    """For each breast its measurement or the error that refused it (see `measure_volumes`)."""

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


def measure_volume(breast: OpenBreast, evidence: VolumeEvidence = VolumeEvidence()) -> VolumeMeasurement:
    """Measurement of one breast, with every wall that fits.

    Raises:
        MeasureError: the selected wall does not fit, or skin and wall do not form a closed solid.
    """
    wall, *others = chest_wall.fit_all(breast)
    std_cc = None if breast.is_cast else boundary_jitter.boundary_std_cc(breast, wall)
    own = replace(evidence, surface=breast.surface, boundary_std_cc=std_cc, axis_assumed=_assumed(breast, wall.kind))
    return measure(breast.boundary, wall, breast.settings, alternatives=others, evidence=own)


def _assumed(breast: OpenBreast, kind: str) -> bool:
    """Whether a wall depends on a trunk whose axis is assumed."""
    return not breast.is_cast and breast.walls[kind].sees_the_chest and breast.trunk.assumed


_ASIDE_MM = 80.0  # distance from the midline at which a removed breast is marked: that of a breast's centre


def refused_side(breast: OpenBreast, refusal: MeasureError | None = None) -> NoBreast:
    """A side of a torso without a volume, with the reason.

    Args:
        breast: the breast whose volume was refused.
        refusal: the error. None: the measurement is tried again to find it.
    """
    points = breast.boundary.points_world
    vertices = breast.surface.mesh.vertices
    name = cast(Literal["left", "right"], breast.boundary.name)
    reason = Notice(code="volume-uncertain", about=(name,))
    if refusal is None:
        try:
            measure_volume(breast)
        except MeasureError as error:
            refusal = error
    if refusal is not None:
        values = {"subject": refusal.subject, "found": refusal.found, "expected": refusal.expected}
        reason = Notice(code="volume-refused", about=(name,), values=values)
    return NoBreast(
        name=name,
        place_world=vertices[np.linalg.norm(vertices - points.mean(axis=0), axis=1).argmin()],
        prominence=None,
        reason=reason,
        unclear=True,
        refused=True,
    )


def wanted_boundaries(sides: TorsoSides, removed: Sequence[str], *, required: bool) -> tuple[Boundary, ...]:
    """Boundaries that were found, except on sides recorded as removed.

    Args:
        sides: boundaries and absent breasts.
        removed: sides recorded as removed.
        required: whether at least one boundary must remain.

    Raises:
        MeasureError: neither side has a breast, and not both are recorded as removed.
    """
    wanted = tuple(boundary for boundary in sides.boundaries if boundary.name not in removed)
    if wanted or not required:
        return wanted
    error = MeasureError(
        "torso",
        found="no breast on either side",
        expected="one on at least one side, unless both are recorded as removed",
        remedy="Draw the boundaries with `mammometry edit`, or state in boundaries.json that a side was removed: "
        '{"boundaries": {"left": {"removed": true}, "right": {"removed": true}}}',
        mesh_remedy="Draw the boundaries with `mammometry edit`, or state in their file that a side was removed",
    )
    error.details = tuple(words_of(side.reason) for side in sides.absent if side.name not in removed)
    raise error


def removed_side(name: Literal["left", "right"], body: BodyDirections, surface: RepairedSurface) -> NoBreast:
    """A side whose breast is recorded as removed."""
    aside = body.left if name == "left" else -body.left
    vertices = surface.mesh.vertices
    from_middle = (vertices - body.point_world) @ np.stack([aside, body.up, body.frame[2]], axis=1)
    distance = np.hypot(from_middle[:, 0] - _ASIDE_MM, from_middle[:, 1]) - from_middle[:, 2]
    reason = Notice(code="breast-removed", level="note", about=(name,))
    return NoBreast(name=name, place_world=vertices[np.argmin(distance)], prominence=None, reason=reason)
