"""Plan of the measurement: from the repaired surface to boundaries and volumes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mammometry.handed_on import CameraSet, FinishedSurface
from mammometry.inputs import Inputs
from mammometry.products import Memo, Product, Products
from mammometry.progress import Progress

if TYPE_CHECKING:  # The stages bring compilers and image libraries, which a plan alone need not wait for.
    from mammometry.matching.foreground import Foreground
    from mammometry.measure.boundary import Boundary
    from mammometry.measure.settings import MeasureSettings
    from mammometry.measure.volume import VolumeMeasurement
    from mammometry.surface.dents import ValidPatches
    from mammometry.surface.repair import RepairedSurface


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measured(Products):
    """Plan of the measurement; empty for an open surface, which has no volume."""

    boundaries: Product[tuple[Boundary, ...]] | None
    """One closed curve a breast."""
    measurements: Product[tuple[VolumeMeasurement, ...]] | None
    """One a breast: ``model``, or the patient's ``left`` and ``right``."""


def measure(
    inputs: Inputs,
    cameras: Product[CameraSet],
    foregrounds: Mapping[str, Product[Foreground]],
    valid: Product[ValidPatches],
    mesh: Product[FinishedSurface],
    repaired: Product[RepairedSurface],
    settings: MeasureSettings,
    memo: Memo,
) -> Measured:
    """Cut the breast out along its boundary, close it with a chest wall, integrate its volume."""
    if inputs.subject_kind == "surface":
        return Measured(boundaries=None, measurements=None)

    def bound(
        calibrated: CameraSet, repaired: RepairedSurface, data: ValidPatches, *seen: Foreground, progress: Progress
    ) -> tuple[Boundary, ...]:
        from mammometry.measure import boundary

        if inputs.boundaries:
            return tuple(
                boundary.given_boundary(name, points, repaired)  # type: ignore[arg-type]  # names checked by the session
                for name, points in inputs.boundaries.items()
            )
        silhouettes = {foreground.camera: foreground for foreground in seen}
        return boundary.find_boundaries(
            repaired,
            data.range_images,
            silhouettes,
            calibrated.rig,
            inputs.subject_kind,
            settings,
            progress=progress,
        )

    def integrate(
        calibrated: CameraSet, repaired: RepairedSurface, boundaries: tuple[Boundary, ...], *, progress: Progress
    ) -> tuple[VolumeMeasurement, ...]:
        from mammometry.measure import chest_wall, volume

        measured = []
        for number, boundary in enumerate(boundaries):
            wall, *others = chest_wall.fit_all(boundary, repaired, settings, boundaries=boundaries, rig=calibrated.rig)
            measured.append(volume.measure(boundary, wall, settings, alternatives=others))
            progress((number + 1) / len(boundaries))
        return tuple(measured)

    given = {name: inputs.digests[name] for name in ("subject", "boundaries")}
    boundaries: Product[tuple[Boundary, ...]] = Product(
        memo,
        "measure",
        "boundaries",
        bound,
        cameras,
        repaired,
        valid,
        *foregrounds.values(),
        settings=settings,
        inputs=given,
    )
    measurements: Product[tuple[VolumeMeasurement, ...]] = Product(
        memo, "measure", "measurement", integrate, cameras, repaired, boundaries, settings=settings
    )
    return Measured(boundaries=boundaries, measurements=measurements)
