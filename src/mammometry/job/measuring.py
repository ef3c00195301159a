"""Plan of the measurement: from the repaired surface to boundaries and volumes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from mammometry.base.errors import MeasureError
from mammometry.base.progress import Progress
from mammometry.geometry.arrays import Array, Float64
from mammometry.job.inputs import Inputs
from mammometry.job.products import Memo, Parent, Product, Products
from mammometry.job.stage_values import CameraSet, FinishedSurface, earlier_errors

if TYPE_CHECKING:  # The stages bring compilers and image libraries, which a plan alone need not wait for.
    from mammometry.calibration.adjust.calibrated import Calibration
    from mammometry.matching.foreground.foreground import Foreground
    from mammometry.measure.boundary.boundary import Boundary, TorsoSides
    from mammometry.measure.boundary.breasts import NoBreast
    from mammometry.measure.landmarks.landmarks import Landmark
    from mammometry.measure.settings import MeasureSettings
    from mammometry.measure.shape.anthropometry import Dimensions
    from mammometry.measure.shape.symmetry import Symmetry
    from mammometry.measure.trunk.body import Body
    from mammometry.measure.volume.measurement import Lacking, VolumeMeasurement
    from mammometry.measure.volume.uncertainty import Evidence
    from mammometry.surface.motion.motion_test import Stillness
    from mammometry.surface.ranges.dents import ValidPatches
    from mammometry.surface.repair.repair import RepairedSurface


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
    """Motion between calibration and exposures. None if no pair was measured."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measured(Products):
    """Plan of the measurement. Empty for an open surface, without volume."""

    side_by_side: ClassVar[tuple[tuple[str, ...], ...]] = (
        ("dimensions", "symmetry", "lacking", "landmarks", "absent", "sides", "body"),
    )

    boundaries: Product[tuple[Boundary, ...]] | None
    """One closed curve for each breast."""
    measurements: Product[tuple[VolumeMeasurement, ...]] | None
    """One for each breast: ``model``, or the patient's ``left`` and ``right``."""
    sides: Product[TorsoSides] | None = None
    """Breasts found on a torso, and sides without one. None if all boundaries are given."""
    absent: Product[tuple[NoBreast, ...]] | None = None
    """Sides of a torso not measured: without a breast, unclear or refused. None for a cast."""
    body: Product[Body] | None = None
    """A torso's own axes (left, up, ahead) and mid-sagittal plane. None for a cast."""
    lacking: Product[tuple[Lacking, ...]] | None = None
    """What one side of a torso lacks to the mirrored other one."""
    landmarks: Product[tuple[Landmark, ...]] | None = None
    """Picked landmarks and proposed nipples."""
    symmetry: Product[Symmetry | None] | None = None
    """Left against mirrored right. The value is None if the trunk shows no mid-sagittal plane."""
    dimensions: Product[Dimensions] | None = None
    """Shape, lengths, ptosis."""
    evidence: Product[Evidence] | None = None
    """What earlier stages know of a volume's errors. Passing: nothing of it is stored."""


def measure(inputs: Inputs, upstream: Upstream, settings: MeasureSettings, memo: Memo) -> Measured:
    """Plan boundaries, chest walls, volumes and lengths."""
    if inputs.subject_kind == "surface":
        return Measured(boundaries=None, measurements=None)
    sides = _sides(inputs, upstream, settings, memo)
    boundaries = _boundaries(inputs, upstream, sides, settings, memo)
    body = _body(inputs, upstream, boundaries, settings, memo)
    evidence = _evidence(inputs, upstream, settings)
    measurements = _measurements(inputs, upstream, boundaries, body, evidence, settings, memo)
    landmarks, symmetry, dimensions = _anthropometry(inputs, upstream, measurements, body, settings, memo)
    plan = Measured(
        sides=sides,
        boundaries=boundaries,
        body=body,
        measurements=measurements,
        lacking=None if body is None else _lacking(upstream, measurements, body, settings, memo),
        landmarks=landmarks,
        symmetry=symmetry,
        dimensions=dimensions,
        evidence=evidence,
    )
    return replace(plan, absent=_absent(inputs, upstream, plan, settings, memo))


def _sides(inputs: Inputs, upstream: Upstream, settings: MeasureSettings, memo: Memo) -> Product[TorsoSides] | None:
    """A torso's breasts as they are found, or that there is none."""
    wanted = inputs.automatic or not (inputs.boundaries or inputs.all_removed)
    if inputs.subject_kind != "torso" or settings.boundary == "landmarks" or not wanted:
        return None

    def outline(cameras: CameraSet, repaired: RepairedSurface, *, progress: Progress) -> TorsoSides:
        from mammometry.measure.boundary.boundary import outline_torso
        from mammometry.measure.trunk.body import rig_frame

        frame = rig_frame(cameras.rig, inputs.mounting)
        return outline_torso(repaired, frame, settings, head_stated=inputs.head_stated)

    return Product(
        memo,
        "measure",
        "sides",
        outline,
        parents={"cameras": upstream.cameras, "repaired": upstream.repaired},
        settings=settings,
        inputs={"subject": inputs.digests["subject"], **inputs.mounting_digest},
    )


def _boundaries(
    inputs: Inputs,
    upstream: Upstream,
    sides: Product[TorsoSides] | None,
    settings: MeasureSettings,
    memo: Memo,
) -> Product[tuple[Boundary, ...]]:
    """One closed curve for each breast: drawn, by picked landmarks, or found."""

    def bound(
        cameras: CameraSet,
        repaired: RepairedSurface,
        foregrounds: Mapping[str, Foreground],
        sides: TorsoSides | None,
        *,
        progress: Progress,
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
        found = find(cameras, repaired, foregrounds, sides, progress)
        if not given:
            return found
        return tuple(sorted((*given, *(each for each in found if each.name in inputs.automatic)), key=lambda b: b.name))

    def find(
        cameras: CameraSet,
        repaired: RepairedSurface,
        foregrounds: Mapping[str, Foreground],
        sides: TorsoSides | None,
        progress: Progress,
    ) -> tuple[Boundary, ...]:
        from mammometry.measure.boundary import boundary
        from mammometry.measure.trunk.body import rig_frame
        from mammometry.measure.volume.refused import wanted_boundaries

        if inputs.all_removed:
            return ()
        if sides is not None:
            return wanted_boundaries(sides, inputs.removed, required=not inputs.boundaries)
        if inputs.subject_kind == "torso":
            frame = rig_frame(cameras.rig, inputs.mounting)
            return boundary.landmark_boundaries(inputs.landmarks, repaired, frame, settings)
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
    digests = {name: inputs.digests[name] for name in names} | inputs.mounting_digest
    if inputs.rim_radius_mm is not None:
        digests["rim"] = repr(inputs.rim_radius_mm)
    return Product(
        memo,
        "measure",
        "boundaries",
        bound,
        parents={
            "cameras": upstream.cameras,
            "repaired": upstream.repaired,
            "sides": sides,  # made before the foregrounds, which are large, are read back
            "foregrounds": upstream.foregrounds,
        },
        settings=settings,
        inputs=digests,
    )


def _body(
    inputs: Inputs,
    upstream: Upstream,
    boundaries: Product[tuple[Boundary, ...]],
    settings: MeasureSettings,
    memo: Memo,
) -> Product[Body] | None:
    """A torso's own directions and its mid-sagittal plane, the breasts left out."""
    if inputs.subject_kind != "torso":
        return None

    def find(
        cameras: CameraSet, repaired: RepairedSurface, boundaries: tuple[Boundary, ...], *, progress: Progress
    ) -> Body:
        from mammometry.measure.trunk.body import find_body, rig_frame

        curves, frame = [each.points_world for each in boundaries], rig_frame(cameras.rig, inputs.mounting)
        return find_body(repaired, frame, settings.thorax, boundaries=curves, stated=inputs.head_stated)

    return Product(
        memo,
        "measure",
        "body",
        find,
        parents={"cameras": upstream.cameras, "repaired": upstream.repaired, "boundaries": boundaries},
        settings=settings.thorax,
        inputs=inputs.mounting_digest,
    )


def _evidence(inputs: Inputs, upstream: Upstream, settings: MeasureSettings) -> Product[Evidence]:
    """What the earlier stages know of a volume's errors."""

    def collect(
        cameras: CameraSet,
        valid: ValidPatches,
        foregrounds: Mapping[str, Foreground],
        calibration: Calibration | None,
        stillness: Stillness | None,
        *,
        progress: Progress,
    ) -> Evidence:
        from mammometry.measure.volume.movement import movement_of
        from mammometry.measure.volume.uncertainty import EarlierErrors, Evidence
        from mammometry.measure.volume.unseen_space import bounds

        return Evidence(
            views=bounds(foregrounds, valid.range_images, cameras.rig, settings),
            earlier=earlier_errors(calibration)
            if inputs.scale_std is None
            else EarlierErrors(scale_std=inputs.scale_std),
            movement=None if stillness is None else movement_of(stillness, cameras.rig),
        )

    return Product(
        None,
        "measure",
        "evidence",
        collect,
        parents={
            "cameras": upstream.cameras,
            "valid": upstream.valid,
            "foregrounds": upstream.foregrounds,
            "calibration": upstream.calibration,
            "stillness": upstream.stillness,
        },
    ).letting_go(upstream.valid, *upstream.foregrounds.values())


def _measurements(
    inputs: Inputs,
    upstream: Upstream,
    boundaries: Product[tuple[Boundary, ...]],
    body: Product[Body] | None,
    evidence: Product[Evidence],
    settings: MeasureSettings,
    memo: Memo,
) -> Product[tuple[VolumeMeasurement, ...]]:
    """The volume of each breast with its interval."""

    def integrate(
        repaired: RepairedSurface,
        boundaries: tuple[Boundary, ...],
        body: Body | None,
        evidence: Evidence,
        *,
        progress: Progress,
    ) -> tuple[VolumeMeasurement, ...]:
        from mammometry.measure.volume.volumes import measured_or_refused
        from mammometry.measure.wall.open_breast import open_breasts

        frame = None if body is None else body.frame
        breasts = open_breasts(boundaries, repaired, settings, frame=frame, back=inputs.wall)
        measured, refusals = [], []
        for breast, each in zip(breasts, measured_or_refused(breasts, evidence, progress=progress), strict=True):
            if not isinstance(each, MeasureError):
                measured.append(each)
            elif breast.boundary.name in inputs.boundaries:
                raise each  # who drew it waits to hear
            else:
                refusals.append(each)  # of this side alone
        if refusals and not measured:
            raise refusals[0]
        return tuple(measured)

    digests = {} if inputs.wall is None else {"wall": inputs.digests["wall"]}
    if inputs.scale_std is not None:
        digests["scale"] = repr(inputs.scale_std)
    return Product(
        memo,
        "measure",
        "measurement",
        integrate,
        parents={"repaired": upstream.repaired, "boundaries": boundaries, "body": body, "evidence": evidence},
        settings=settings,
        inputs=digests,
    )


def _absent(
    inputs: Inputs,
    upstream: Upstream,
    plan: Measured,
    settings: MeasureSettings,
    memo: Memo,
) -> Product[tuple[NoBreast, ...]] | None:
    """Unmeasured sides with reasons. One side does not stop the other."""
    if inputs.subject_kind != "torso":
        return None

    def gather(
        repaired: RepairedSurface,
        sides: TorsoSides | None,
        boundaries: tuple[Boundary, ...],
        body: Body | None,
        measurements: tuple[VolumeMeasurement, ...],
        *,
        progress: Progress,
    ) -> tuple[NoBreast, ...]:
        from mammometry.measure.volume.refused import refused_side, removed_side
        from mammometry.measure.wall.open_breast import open_breasts

        found = () if sides is None else sides.absent
        absent = [side for side in found if side.name not in (*inputs.boundaries, *inputs.removed)]
        if body is not None:
            absent += [removed_side(name, body, repaired) for name in inputs.removed]
        measured = {each.name for each in measurements}
        if any(each.name not in measured for each in boundaries):
            frame = None if body is None else body.frame
            for breast in open_breasts(boundaries, repaired, settings, frame=frame, back=inputs.wall):
                if breast.boundary.name not in measured:
                    absent.append(refused_side(breast))
        return tuple(absent)

    return Product(
        memo,
        "measure",
        "absent",
        gather,
        parents={
            "repaired": upstream.repaired,
            "sides": plan.sides,
            "boundaries": plan.boundaries,
            "body": plan.body,
            "measurements": plan.measurements,
        },
        settings=settings,
        inputs={} if inputs.wall is None else {"wall": inputs.digests["wall"]},
    )


def _lacking(
    upstream: Upstream,
    measurements: Product[tuple[VolumeMeasurement, ...]],
    body: Product[Body],
    settings: MeasureSettings,
    memo: Memo,
) -> Product[tuple[Lacking, ...]]:
    """What the smaller side of a torso lacks to the mirrored larger."""

    def compare(
        repaired: RepairedSurface, measurements: tuple[VolumeMeasurement, ...], body: Body, *, progress: Progress
    ) -> tuple[Lacking, ...]:
        from mammometry.measure.volume.lacking import lacking

        try:
            found = lacking(repaired, measurements, body, settings)
        except MeasureError:
            return ()  # volumes do not depend on it
        return () if found is None else (found,)

    return Product(
        memo,
        "measure",
        "lacking",
        compare,
        parents={"repaired": upstream.repaired, "measurements": measurements, "body": body},
        settings=settings,
    )


def _anthropometry(
    inputs: Inputs,
    upstream: Upstream,
    measurements: Product[tuple[VolumeMeasurement, ...]],
    body: Product[Body] | None,
    settings: MeasureSettings,
    memo: Memo,
) -> tuple[Product[tuple[Landmark, ...]], Product[Symmetry | None], Product[Dimensions]]:
    """Landmarks, symmetry and lengths, in the body's or a cast's camera frame."""

    def frame_of(cameras: CameraSet, body: Body | None) -> Float64[Array, "3 3"]:
        from mammometry.measure.trunk.body import rig_frame

        return rig_frame(cameras.rig, inputs.mounting) if body is None else body.frame

    def mark(
        cameras: CameraSet,
        mesh: FinishedSurface,
        measurements: tuple[VolumeMeasurement, ...],
        body: Body | None,
        *,
        progress: Progress,
    ) -> tuple[Landmark, ...]:
        from mammometry.measure.shape.anthropometry import find_landmarks

        textured = mesh.textured
        frame = frame_of(cameras, body)
        plane = None if body is None else body.plane
        return find_landmarks(
            textured.mesh, textured.colours, measurements, inputs.landmarks, frame, settings, plane=plane
        )

    def mirror(
        cameras: CameraSet,
        mesh: FinishedSurface,
        measurements: tuple[VolumeMeasurement, ...],
        body: Body | None,
        *,
        progress: Progress,
    ) -> Symmetry | None:
        from mammometry.measure.shape.symmetry import symmetry

        if body is None or body.plane is None:
            return None  # volumes do not depend on it; the report says that there is none
        try:
            return symmetry(measurements, body.frame, body.plane)
        except MeasureError:
            return None

    def extend(
        cameras: CameraSet,
        mesh: FinishedSurface,
        measurements: tuple[VolumeMeasurement, ...],
        body: Body | None,
        landmarks: tuple[Landmark, ...],
        *,
        progress: Progress,
    ) -> Dimensions:
        from mammometry.measure.shape.anthropometry import dimensions

        frame, plane = frame_of(cameras, body), None if body is None else body.plane
        return dimensions(mesh.repaired.mesh, measurements, landmarks, frame, settings, plane=plane)

    measured: dict[str, Parent] = {
        "cameras": upstream.cameras,
        "mesh": upstream.mesh,
        "measurements": measurements,
        "body": body,
    }
    picked = {"landmarks": inputs.digests["landmarks"], **inputs.mounting_digest}
    landmarks: Product[tuple[Landmark, ...]] = Product(
        memo, "measure", "landmarks", mark, parents=measured, settings=settings, inputs=picked
    )
    symmetry: Product[Symmetry | None] = Product(memo, "measure", "symmetry", mirror, parents=measured)
    dimensions: Product[Dimensions] = Product(
        memo,
        "measure",
        "dimensions",
        extend,
        parents={**measured, "landmarks": landmarks},
        settings=settings,
        inputs=inputs.mounting_digest,
    )
    return landmarks, symmetry, dimensions
