"""Plan of the measurement: from the repaired surface to boundaries and volumes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mammometry.base.errors import MeasureError
from mammometry.base.progress import Progress
from mammometry.job.inputs import Inputs
from mammometry.job.products import Memo, Product, Products
from mammometry.job.stage_values import CameraSet, FinishedSurface

if TYPE_CHECKING:  # The stages bring compilers and image libraries, which a plan alone need not wait for.
    from mammometry.calibration.adjust.calibrated import Calibration
    from mammometry.matching.foreground import Foreground
    from mammometry.measure.boundary.boundary import Boundary
    from mammometry.measure.landmarks.landmarks import Landmark
    from mammometry.measure.settings import MeasureSettings
    from mammometry.measure.shape.anthropometry import Dimensions
    from mammometry.measure.shape.symmetry import Symmetry
    from mammometry.measure.volume.uncertainty import EarlierErrors
    from mammometry.measure.volume.volume import VolumeMeasurement
    from mammometry.surface.dents import ValidPatches
    from mammometry.surface.repair import RepairedSurface


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measured(Products):
    """Plan of the measurement; empty for an open surface, which has no volume."""

    boundaries: Product[tuple[Boundary, ...]] | None
    """One closed curve a breast."""
    measurements: Product[tuple[VolumeMeasurement, ...]] | None
    """One a breast: ``model``, or the patient's ``left`` and ``right``."""
    landmarks: Product[tuple[Landmark, ...]] | None = None
    """Those that were picked, and proposed nipples."""
    symmetry: Product[Symmetry | None] | None = None
    """Left against mirrored right; its value is None where the trunk does not show a mid-sagittal plane."""
    dimensions: Product[Dimensions] | None = None
    """Shape, lengths, ptosis."""


def measure(
    inputs: Inputs,
    cameras: Product[CameraSet],
    calibration: Product[Calibration] | None,
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
        calibrated: CameraSet, repaired: RepairedSurface, *seen: Foreground, progress: Progress
    ) -> tuple[Boundary, ...]:
        from mammometry.measure.boundary import boundary

        given = tuple(
            boundary.given_boundary(
                name,  # type: ignore[arg-type]  # names checked by the session
                points,
                repaired,
                rim_sigma_mm=settings.drawn_rim_sigma_mm,
                how=inputs.attributions[name].method if name in inputs.attributions else None,
            )
            for name, points in inputs.boundaries.items()
        )
        if not given:
            return find(calibrated, repaired, *seen, progress=progress)
        if not inputs.automatic:
            return given
        found = find(calibrated, repaired, *seen, progress=progress)
        return tuple(
            sorted((*given, *(each for each in found if each.name in inputs.automatic)), key=lambda each: each.name)
        )

    def find(
        calibrated: CameraSet, repaired: RepairedSurface, *seen: Foreground, progress: Progress
    ) -> tuple[Boundary, ...]:
        from mammometry.measure.boundary import boundary
        from mammometry.measure.trunk.thorax import frame_from_rig

        if settings.boundary == "landmarks" and inputs.subject_kind == "torso":
            return boundary.landmark_boundaries(inputs.landmarks, repaired, frame_from_rig(calibrated.rig), settings)
        silhouettes = {foreground.camera: foreground for foreground in seen}
        return boundary.find_boundaries(
            repaired,
            silhouettes,
            calibrated.rig,
            inputs.subject_kind,
            settings,
            rim_radius_mm=inputs.rim_radius_mm,
            progress=progress,
        )

    def integrate(
        calibrated: CameraSet,
        repaired: RepairedSurface,
        boundaries: tuple[Boundary, ...],
        data: ValidPatches,
        *others: Any,
        progress: Progress,
    ) -> tuple[VolumeMeasurement, ...]:
        from mammometry.measure.volume.uncertainty import EarlierErrors
        from mammometry.measure.volume.unseen_space import bounds
        from mammometry.measure.volume.volumes import measure_volumes

        seen, adjusted = others[: len(foregrounds)], others[len(foregrounds) :]
        silhouettes = {foreground.camera: foreground for foreground in seen}

        return measure_volumes(
            boundaries,
            repaired,
            settings,
            rig=calibrated.rig,
            back=inputs.wall,
            views=bounds(silhouettes, data.range_images, calibrated.rig, settings),
            earlier=earlier_errors(*adjusted)
            if inputs.scale_std is None
            else EarlierErrors(scale_std=inputs.scale_std),
            progress=progress,
        )

    told = ("subject", "boundaries", *(("landmarks",) if settings.boundary == "landmarks" else ()))
    given = {name: inputs.digests[name] for name in told}
    if inputs.rim_radius_mm is not None:
        given["rim"] = repr(inputs.rim_radius_mm)
    boundaries: Product[tuple[Boundary, ...]] = Product(
        memo,
        "measure",
        "boundaries",
        bound,
        cameras,
        repaired,
        *foregrounds.values(),
        settings=settings,
        inputs=given,
    )
    measurements: Product[tuple[VolumeMeasurement, ...]] = Product(
        memo,
        "measure",
        "measurement",
        integrate,
        cameras,
        repaired,
        boundaries,
        valid,
        *foregrounds.values(),
        *([] if calibration is None else [calibration]),
        settings=settings,
        inputs=_beside(inputs),
    )
    landmarks, symmetry, dimensions = _anthropometry(inputs, cameras, mesh, measurements, settings, memo)
    return Measured(
        boundaries=boundaries,
        measurements=measurements,
        landmarks=landmarks,
        symmetry=symmetry,
        dimensions=dimensions,
    )


def _beside(inputs: Inputs) -> dict[str, str]:
    """What a volume depends on beside the surface, the boundaries and the settings."""
    beside = {} if inputs.wall is None else {"wall": inputs.digests["wall"]}
    return beside if inputs.scale_std is None else {**beside, "scale": repr(inputs.scale_std)}


def _anthropometry(
    inputs: Inputs,
    cameras: Product[CameraSet],
    mesh: Product[FinishedSurface],
    measurements: Product[tuple[VolumeMeasurement, ...]],
    settings: MeasureSettings,
    memo: Memo,
) -> tuple[Product[tuple[Landmark, ...]], Product[Symmetry | None], Product[Dimensions]]:
    """What is measured beside the volume; upright and ahead are the cameras'."""

    def mark(
        calibrated: CameraSet,
        finished: FinishedSurface,
        measured: tuple[VolumeMeasurement, ...],
        *,
        progress: Progress,
    ) -> tuple[Landmark, ...]:
        from mammometry.measure.shape.anthropometry import find_landmarks
        from mammometry.measure.trunk.thorax import frame_from_rig

        frame = frame_from_rig(calibrated.rig)
        textured = finished.textured
        return find_landmarks(textured.mesh, textured.colours, measured, inputs.landmarks, frame, settings)

    def mirror(
        calibrated: CameraSet,
        finished: FinishedSurface,
        measured: tuple[VolumeMeasurement, ...],
        *,
        progress: Progress,
    ) -> Symmetry | None:
        from mammometry.measure.shape.symmetry import symmetry
        from mammometry.measure.trunk.thorax import frame_from_rig

        try:
            return symmetry(finished.repaired, measured, frame_from_rig(calibrated.rig))
        except MeasureError:
            return None  # volumes do not depend on it; the report says that there is none

    def extend(
        calibrated: CameraSet,
        finished: FinishedSurface,
        measured: tuple[VolumeMeasurement, ...],
        marked: tuple[Landmark, ...],
        mirrored: Symmetry | None,
        *,
        progress: Progress,
    ) -> Dimensions:
        from mammometry.measure.shape.anthropometry import dimensions
        from mammometry.measure.trunk.thorax import frame_from_rig

        frame = frame_from_rig(calibrated.rig)
        return dimensions(finished.repaired.mesh, measured, marked, frame, settings, symmetry=mirrored)

    made = (cameras, mesh, measurements)
    picked = {"landmarks": inputs.digests["landmarks"]}
    marks: Product[tuple[Landmark, ...]] = Product(
        memo, "measure", "landmarks", mark, *made, settings=settings, inputs=picked
    )
    sides: Product[Symmetry | None] = Product(memo, "measure", "symmetry", mirror, *made)
    sizes: Product[Dimensions] = Product(memo, "measure", "dimensions", extend, *made, marks, sides, settings=settings)
    return marks, sides, sizes


def earlier_errors(*calibrations: Calibration) -> EarlierErrors:
    """What a calibration, where there was one, says of its own errors."""
    import numpy as np

    from mammometry.calibration.judge.expected_error import expected_error
    from mammometry.measure.volume.uncertainty import EarlierErrors

    for calibration in calibrations:
        expected = np.concatenate(list(expected_error(calibration).std_mm.values()))
        seen = np.isfinite(expected)
        point_std_mm = float(np.sqrt(np.mean(expected[seen] ** 2))) if seen.any() else None
        return EarlierErrors(scale_std=calibration.scale_std, point_std_mm=point_std_mm)
    return EarlierErrors()
