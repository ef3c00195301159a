"""All breasts of one subject, from boundaries to volumes with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace

from mammometry.base.errors import MeasureError
from mammometry.base.machine.cores import available_cores
from mammometry.base.progress import Progress, no_progress
from mammometry.measure.volume import boundary_jitter, volume
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.measure.volume.uncertainty import Evidence
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.open_breast import OpenBreast


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
