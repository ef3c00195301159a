"""Plan of the measurement: from the repaired surface to boundaries and volumes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mammometry.base.errors import MeasureError
from mammometry.base.progress import Progress
from mammometry.job.inputs import Inputs
from mammometry.job.products import Memo, Parent, Product, Products
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
    from mammometry.surface.stillness import Stillness


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Upstream:
    """Products of the earlier stages from which a breast is measured."""

    cameras: Product[CameraSet]
    """Where they stood at the exposures."""
    calibration: Product[Calibration] | None
    """None where the cameras came ready-made."""
    foregrounds: Mapping[str, Product[Foreground]]
    """Camera → which of its pixels show the subject."""
    valid: Product[ValidPatches]
    """What each pair measured, dents left out."""
    mesh: Product[FinishedSurface]
    """The repaired surface with its colours."""
    repaired: Product[RepairedSurface]
    stillness: Product[Stillness] | None = None
    """What moved between the calibration and the exposures; None where no pair measured."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measured(Products):
    """Plan of the measurement. Empty for an open surface, which has no volume."""

    boundaries: Product[tuple[Boundary, ...]] | None
    """One closed curve for each breast."""
    measurements: Product[tuple[VolumeMeasurement, ...]] | None
    """One for each breast: ``model``, or the patient's ``left`` and ``right``."""
    landmarks: Product[tuple[Landmark, ...]] | None = None
    """Picked landmarks and proposed nipples."""
    symmetry: Product[Symmetry | None] | None = None
    """Left against mirrored right. Its value is None where the trunk shows no mid-sagittal plane."""
    dimensions: Product[Dimensions] | None = None
    """Shape, lengths, ptosis."""


def measure(inputs: Inputs, upstream: Upstream, settings: MeasureSettings, memo: Memo) -> Measured:
    """Plan boundaries, chest walls, volumes and lengths."""
    if inputs.subject_kind == "surface":
        return Measured(boundaries=None, measurements=None)
    boundaries = _boundaries(inputs, upstream, settings, memo)
    measurements = _measurements(inputs, upstream, boundaries, settings, memo)
    landmarks, symmetry, dimensions = _anthropometry(inputs, upstream, measurements, settings, memo)
    return Measured(
        boundaries=boundaries,
        measurements=measurements,
        landmarks=landmarks,
        symmetry=symmetry,
        dimensions=dimensions,
    )


def _boundaries(
    inputs: Inputs, upstream: Upstream, settings: MeasureSettings, memo: Memo
) -> Product[tuple[Boundary, ...]]:
    """One closed curve for each breast: drawn, by picked landmarks, or found."""

    def bound(
        cameras: CameraSet, repaired: RepairedSurface, foregrounds: Mapping[str, Foreground], *, progress: Progress
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
        if given and not inputs.automatic:
            return given
        found = find(cameras, repaired, foregrounds, progress)
        if not given:
            return found
        return tuple(sorted((*given, *(each for each in found if each.name in inputs.automatic)), key=lambda b: b.name))

    def find(
        cameras: CameraSet, repaired: RepairedSurface, foregrounds: Mapping[str, Foreground], progress: Progress
    ) -> tuple[Boundary, ...]:
        from mammometry.measure.boundary import boundary
        from mammometry.measure.trunk.thorax import frame_from_rig

        if settings.boundary == "landmarks" and inputs.subject_kind == "torso":
            return boundary.landmark_boundaries(inputs.landmarks, repaired, frame_from_rig(cameras.rig), settings)
        return boundary.find_boundaries(
            repaired,
            foregrounds,
            cameras.rig,
            inputs.subject_kind,
            settings,
            rim_radius_mm=inputs.rim_radius_mm,
            progress=progress,
        )

    names = ("subject", "boundaries", *(("landmarks",) if settings.boundary == "landmarks" else ()))
    digests = {name: inputs.digests[name] for name in names}
    if inputs.rim_radius_mm is not None:
        digests["rim"] = repr(inputs.rim_radius_mm)
    return Product(
        memo,
        "measure",
        "boundaries",
        bound,
        parents={"cameras": upstream.cameras, "repaired": upstream.repaired, "foregrounds": upstream.foregrounds},
        settings=settings,
        inputs=digests,
    )


def _measurements(
    inputs: Inputs,
    upstream: Upstream,
    boundaries: Product[tuple[Boundary, ...]],
    settings: MeasureSettings,
    memo: Memo,
) -> Product[tuple[VolumeMeasurement, ...]]:
    """The volume of each breast with its interval."""

    def integrate(
        cameras: CameraSet,
        repaired: RepairedSurface,
        boundaries: tuple[Boundary, ...],
        valid: ValidPatches,
        foregrounds: Mapping[str, Foreground],
        calibration: Calibration | None,
        stillness: Stillness | None,
        *,
        progress: Progress,
    ) -> tuple[VolumeMeasurement, ...]:
        from mammometry.measure.volume.movement import movement_of
        from mammometry.measure.volume.uncertainty import EarlierErrors, Evidence
        from mammometry.measure.volume.unseen_space import bounds
        from mammometry.measure.volume.volumes import measure_volumes
        from mammometry.measure.wall.open_breast import open_breasts

        evidence = Evidence(
            views=bounds(foregrounds, valid.range_images, cameras.rig, settings),
            earlier=earlier_errors(calibration)
            if inputs.scale_std is None
            else EarlierErrors(scale_std=inputs.scale_std),
            movement=None if stillness is None else movement_of(stillness, cameras.rig),
        )
        breasts = open_breasts(boundaries, repaired, settings, rig=cameras.rig, back=inputs.wall)
        return measure_volumes(breasts, evidence, progress=progress)

    digests = {} if inputs.wall is None else {"wall": inputs.digests["wall"]}
    if inputs.scale_std is not None:
        digests["scale"] = repr(inputs.scale_std)
    return Product(
        memo,
        "measure",
        "measurement",
        integrate,
        parents={
            "cameras": upstream.cameras,
            "repaired": upstream.repaired,
            "boundaries": boundaries,
            "valid": upstream.valid,
            "foregrounds": upstream.foregrounds,
            "calibration": upstream.calibration,
            "stillness": upstream.stillness,
        },
        settings=settings,
        inputs=digests,
    )


def _anthropometry(
    inputs: Inputs,
    upstream: Upstream,
    measurements: Product[tuple[VolumeMeasurement, ...]],
    settings: MeasureSettings,
    memo: Memo,
) -> tuple[Product[tuple[Landmark, ...]], Product[Symmetry | None], Product[Dimensions]]:
    """Landmarks, symmetry, lengths. Upright and ahead are the cameras'."""

    def mark(
        cameras: CameraSet,
        mesh: FinishedSurface,
        measurements: tuple[VolumeMeasurement, ...],
        *,
        progress: Progress,
    ) -> tuple[Landmark, ...]:
        from mammometry.measure.shape.anthropometry import find_landmarks
        from mammometry.measure.trunk.thorax import frame_from_rig

        frame = frame_from_rig(cameras.rig)
        textured = mesh.textured
        return find_landmarks(textured.mesh, textured.colours, measurements, inputs.landmarks, frame, settings)

    def mirror(
        cameras: CameraSet,
        mesh: FinishedSurface,
        measurements: tuple[VolumeMeasurement, ...],
        *,
        progress: Progress,
    ) -> Symmetry | None:
        from mammometry.measure.shape.symmetry import symmetry
        from mammometry.measure.trunk.thorax import frame_from_rig

        try:
            return symmetry(mesh.repaired, measurements, frame_from_rig(cameras.rig))
        except MeasureError:
            return None  # volumes do not depend on it; the report says that there is none

    def extend(
        cameras: CameraSet,
        mesh: FinishedSurface,
        measurements: tuple[VolumeMeasurement, ...],
        landmarks: tuple[Landmark, ...],
        symmetry: Symmetry | None,
        *,
        progress: Progress,
    ) -> Dimensions:
        from mammometry.measure.shape.anthropometry import dimensions
        from mammometry.measure.trunk.thorax import frame_from_rig

        frame = frame_from_rig(cameras.rig)
        return dimensions(mesh.repaired.mesh, measurements, landmarks, frame, settings, symmetry=symmetry)

    measured: dict[str, Parent] = {"cameras": upstream.cameras, "mesh": upstream.mesh, "measurements": measurements}
    picked = {"landmarks": inputs.digests["landmarks"]}
    landmarks: Product[tuple[Landmark, ...]] = Product(
        memo, "measure", "landmarks", mark, parents=measured, settings=settings, inputs=picked
    )
    symmetry: Product[Symmetry | None] = Product(memo, "measure", "symmetry", mirror, parents=measured)
    dimensions: Product[Dimensions] = Product(
        memo,
        "measure",
        "dimensions",
        extend,
        parents={**measured, "landmarks": landmarks, "symmetry": symmetry},
        settings=settings,
    )
    return landmarks, symmetry, dimensions


def earlier_errors(calibration: Calibration | None) -> EarlierErrors:
    """What a calibration says of its own errors. Nothing where there is none."""
    import numpy as np

    from mammometry.calibration.judge.expected_error import expected_error
    from mammometry.measure.volume.uncertainty import EarlierErrors

    if calibration is None:
        return EarlierErrors()
    expected = np.concatenate(list(expected_error(calibration).std_mm.values()))
    seen = np.isfinite(expected)
    point_std_mm = float(np.sqrt(np.mean(expected[seen] ** 2))) if seen.any() else None
    return EarlierErrors(scale_std=calibration.scale_std, point_std_mm=point_std_mm)
