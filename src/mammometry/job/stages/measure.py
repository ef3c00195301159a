"""Measurement stage: from the repaired surface to boundaries, volumes and lengths."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from mammometry.base.errors import MeasureError
from mammometry.base.notices.words import maybe_words
from mammometry.geometry.arrays import Array, Float64
from mammometry.job.inputs import CameraSet, FinishedSurface, Inputs, earlier_errors
from mammometry.job.products import Context, product
from mammometry.settings import Settings

if TYPE_CHECKING:  # the stages import compilers and image libraries, which a plan does not need
    from mammometry.calibration.adjust.calibrated import Calibration
    from mammometry.matching.foreground.foreground import Foreground
    from mammometry.measure.boundary.boundary import Boundary, TorsoSides
    from mammometry.measure.boundary.breasts import NoBreast
    from mammometry.measure.boundary.overlap import Overlap
    from mammometry.measure.landmarks.landmarks import Landmark
    from mammometry.measure.shape.anthropometry import Dimensions
    from mammometry.measure.shape.body_size import BodySize
    from mammometry.measure.shape.symmetry import Symmetry
    from mammometry.measure.trunk.body import BodyDirections
    from mammometry.measure.volume.measurement import VolumeDeficit, VolumeMeasurement
    from mammometry.measure.volume.uncertainty import VolumeEvidence
    from mammometry.measure.volume.unseen_space import Bound
    from mammometry.measure.wall.open_breast import OpenBreast
    from mammometry.surface.motion.motion_detection import MotionEstimate
    from mammometry.surface.ranges.dents import ValidPatches
    from mammometry.surface.repair.repair import RepairedSurface
    from mammometry.walk.motion import WalkMotion


def are_breasts_sought(inputs: Inputs, settings: Settings) -> bool:
    """Whether to search for breasts on a torso: not if all are drawn, removed, or given by landmarks."""
    wanted = inputs.automatic or not (inputs.boundaries or inputs.all_removed)
    return inputs.subject_kind == "torso" and settings.measure.boundary != "landmarks" and bool(wanted)


def _frame(cameras: CameraSet, job: Context, body: BodyDirections | None = None) -> Float64[Array, "3 3"]:
    """Unit vectors left, up, ahead (rows), of the body if it is given, else of the cameras."""
    from mammometry.measure.trunk.body import rig_frame

    return rig_frame(cameras.rig, job.inputs.mounting) if body is None else body.frame


@product("measure", version=26, settings="measure", inputs=("subject", "mounting"))
def sides(corrected_cameras: CameraSet, repaired: RepairedSurface, *, job: Context) -> TorsoSides:
    """Breasts found on a torso, and sides without one."""
    from mammometry.measure.boundary.boundary import outline_torso
    from mammometry.measure.shape.body_lengths import size_remarked

    frame = _frame(corrected_cameras, job)
    with size_remarked(repaired, frame):
        return outline_torso(repaired, frame, head_stated=job.inputs.head_stated)


def _boundary_inputs(job: Context) -> dict[str, str]:
    picked = ("landmarks",) if job.settings.measure.boundary == "landmarks" else ()
    return job.inputs.key_part("subject", "boundaries", "mounting", "rim", *picked)


@product("measure", version=19, settings="measure", inputs=_boundary_inputs)
def boundaries(
    corrected_cameras: CameraSet,
    repaired: RepairedSurface,
    sides: TorsoSides | None,  # first, before the large foregrounds are read back
    foregrounds: Mapping[str, Foreground],
    *,
    job: Context,
) -> tuple[Boundary, ...]:
    """One closed curve for each breast: drawn, from landmarks, or found automatically."""
    from mammometry.measure.boundary import boundary
    from mammometry.measure.shape.body_lengths import size_remarked
    from mammometry.measure.volume.volumes import wanted_boundaries

    inputs, settings = job.inputs, job.settings.measure
    given = tuple(
        boundary.given_boundary(
            name,  # type: ignore[arg-type]  # names checked by the session
            points,
            repaired,
            rim_sigma_mm=boundary.DRAWN_RIM_SIGMA_MM,
            how=inputs.attributions[name].method if name in inputs.attributions else None,
        )
        for name, points in inputs.boundaries.items()
    )
    if given and not inputs.automatic:
        return given
    if inputs.all_removed:
        curves: tuple[Boundary, ...] = ()
    elif sides is not None:
        with size_remarked(repaired, _frame(corrected_cameras, job)):
            curves = wanted_boundaries(sides, inputs.removed, required=not inputs.boundaries)
    elif inputs.subject_kind == "torso":
        frame = _frame(corrected_cameras, job)
        curves = boundary.landmark_boundaries(inputs.landmarks, repaired, frame, settings)
    else:
        curves = boundary.find_boundaries(
            repaired,
            foregrounds,
            corrected_cameras.rig,
            inputs.subject_kind,
            settings,
            rim_radius_mm=inputs.rim_radius_mm,
            progress=job.progress,
        )
    if not given:
        return curves
    wanted = (curve for curve in curves if curve.name in inputs.automatic)
    return tuple(sorted((*given, *wanted), key=lambda curve: curve.name))


@product("measure", version=10, settings="measure.thorax", inputs=("mounting",))
def body(
    corrected_cameras: CameraSet,
    repaired: RepairedSurface,
    sides: TorsoSides | None,
    boundaries: tuple[Boundary, ...],
    *,
    job: Context,
) -> BodyDirections:
    """Axes (left, up, ahead) and mid-sagittal plane of a torso, determined without the breasts."""
    from mammometry.measure.trunk.body import find_body

    curves, frame = [curve.points_world for curve in boundaries], _frame(corrected_cameras, job)
    # One curve does not show which end of the trunk is up. The search for the sides has already decided it.
    stated = job.inputs.head_stated or (sides is not None and len(curves) < 2)
    return find_body(repaired, frame, boundaries=curves, stated=stated)


@product("measure", large=True)
def breasts(
    repaired: RepairedSurface, boundaries: tuple[Boundary, ...], body: BodyDirections | None, *, job: Context
) -> tuple[OpenBreast, ...]:
    """Each breast, cut out along its boundary and still open at the back."""
    from mammometry.measure.wall.open_breast import open_breasts

    frame = None if body is None else body.frame
    return open_breasts(boundaries, repaired, job.settings.measure, frame=frame, back=job.inputs.wall)


@product("measure", version=1, settings="measure", threads=1)
def size(repaired: RepairedSurface, breasts: tuple[OpenBreast, ...], body: BodyDirections, *, job: Context) -> BodySize:
    """Lengths of a torso that reveal a wrong scale."""
    from mammometry.measure.shape.body_lengths import find_body_size

    return find_body_size(repaired, breasts, body, job.settings.measure)


@product("measure", version=1, threads=1)
def overlaps(repaired: RepairedSurface, boundaries: tuple[Boundary, ...], *, job: Context) -> tuple[Overlap, ...]:
    """Whether something covers a breast, such as a hand. No volume depends on it."""
    from mammometry.measure.boundary.grooves import find_overlap

    return tuple(find_overlap(boundary, repaired) for boundary in boundaries)


@product("measure", large=True)
def views(
    corrected_cameras: CameraSet, valid_patches: ValidPatches, foregrounds: Mapping[str, Foreground], *, job: Context
) -> tuple[Bound, ...]:
    """Space that each view shows to be outside a cast."""
    from mammometry.measure.volume.unseen_space import bounds

    return bounds(foregrounds, valid_patches.range_images, corrected_cameras.rig)


@product("measure", large=True)
def evidence(
    corrected_cameras: CameraSet,
    views: tuple[Bound, ...] | None,
    calibration: Calibration | None,
    stillness: MotionEstimate | None,
    walk_motion: WalkMotion | None,
    *,
    job: Context,
) -> VolumeEvidence:
    """Results of earlier stages that determine the errors of a volume.

    Views are used for casts only, which are round where no camera sees them. On a patient, folds that no camera sees
    are closed too far outside, and no view shows how deep the skin is (docs/decisions/0043).
    """
    from mammometry.measure.volume.uncertainty import EarlierErrors, VolumeEvidence, movement_of

    scale_std, walk = job.inputs.scale_std, job.inputs.walk
    if walk is not None:
        moved_mm = 0.0 if walk_motion is None else walk_motion.point_std_mm
        earlier = EarlierErrors(scale_std=walk.scale_std, point_std_mm=math.hypot(walk.point_std_mm, moved_mm))
    elif scale_std is not None:
        earlier = EarlierErrors(scale_std=scale_std)
    else:
        earlier = earlier_errors(calibration)
    return VolumeEvidence(
        views=views or (),
        earlier=earlier,
        movement=None if stillness is None else movement_of(stillness, corrected_cameras.rig),
    )


@product(
    "measure",
    version=27,
    name="measurement",
    settings="measure",
    inputs=("wall", "scale", "walk-errors"),
)
def measurements(
    breasts: tuple[OpenBreast, ...],
    size: BodySize | None,
    overlaps: tuple[Overlap, ...] | None,
    evidence: VolumeEvidence,
    *,
    job: Context,
) -> tuple[VolumeMeasurement, ...]:
    """Volume and interval of each breast: ``model``, or the patient's ``left`` and ``right``.

    Raises:
        MeasureError: no breast can be measured, a drawn one cannot (for example, something covers it), or the body's
            size is impossible for an adult.
    """
    from mammometry.measure.shape.body_size import require_adult
    from mammometry.measure.volume.volumes import measured_or_refused

    if size is not None:
        require_adult(size, job.settings.measure)
    remark = maybe_words(size.notice if size is not None and size.is_rare else None)  # a wrong scale may be the cause
    outcomes: dict[str, VolumeMeasurement | MeasureError] = {**_covered(overlaps, job)}
    bare = [breast for breast in breasts if breast.boundary.name not in outcomes]
    results = measured_or_refused(bare, evidence, progress=job.progress)
    outcomes |= {breast.boundary.name: result for breast, result in zip(bare, results, strict=True)}
    measured, refusals = [], []
    for breast in breasts:
        result = outcomes[breast.boundary.name]
        if not isinstance(result, MeasureError):
            measured.append(result)
        elif breast.boundary.name in job.inputs.boundaries:
            raise result.with_remark(remark)  # a drawn breast must not fail silently
        else:
            refusals.append(result)  # the other side may be measured
    if refusals and not measured:
        raise refusals[0].with_remark(remark)
    return tuple(measured)


def _covered(overlaps: tuple[Overlap, ...] | None, job: Context) -> dict[str, MeasureError]:
    """Covered breast → why it is not measured."""
    if job.settings.measure.bare_confirmed:
        return {}
    return {found.name: found.refusal for found in overlaps or () if found.is_covered}


@product("measure", version=4, settings="measure", inputs=("wall",), threads=1)
def absent(
    repaired: RepairedSurface,
    sides: TorsoSides | None,
    breasts: tuple[OpenBreast, ...],
    body: BodyDirections,
    measurements: tuple[VolumeMeasurement, ...],
    overlaps: tuple[Overlap, ...],
    *,
    job: Context,
) -> tuple[NoBreast, ...]:
    """Sides without a volume, each with its reason: no breast, removed, unclear or refused."""
    from mammometry.measure.volume.volumes import refused_side, removed_side

    inputs = job.inputs
    sides_without = () if sides is None else sides.absent
    absent = [side for side in sides_without if side.name not in (*inputs.boundaries, *inputs.removed)]
    absent += [removed_side(name, body, repaired) for name in inputs.removed]
    measured = {measurement.name for measurement in measurements}
    covered = _covered(overlaps, job)
    refused = [breast for breast in breasts if breast.boundary.name not in measured]
    absent += [refused_side(breast, covered.get(breast.boundary.name)) for breast in refused]
    return tuple(absent)


@product("measure", version=4, settings="measure", threads=1)
def lacking(
    repaired: RepairedSurface, measurements: tuple[VolumeMeasurement, ...], body: BodyDirections, *, job: Context
) -> tuple[VolumeDeficit, ...]:
    """Volume deficit of the smaller side of a torso relative to the mirrored larger one."""
    from mammometry.measure.volume.deficit import volume_deficit

    try:
        deficit = volume_deficit(repaired, measurements, body, job.settings.measure)
    except MeasureError:
        return ()
    return () if deficit is None else (deficit,)


@product("measure", version=10, settings="measure", inputs=("landmarks",), threads=1)
def landmarks(
    mesh: FinishedSurface,
    boundaries: tuple[Boundary, ...],
    measurements: tuple[VolumeMeasurement, ...],
    body: BodyDirections | None,
    *,
    job: Context,
) -> tuple[Landmark, ...]:
    """Landmarks picked by the user, and proposals for the others."""
    from mammometry.measure.shape.anthropometry import find_landmarks

    colours, picked, settings = mesh.textured.colours, job.inputs.landmarks, job.settings.measure
    return find_landmarks(mesh.repaired, colours, measurements, picked, body, settings, boundaries=boundaries)


@product("measure", version=5, threads=1)
def symmetry(
    corrected_cameras: CameraSet,
    mesh: FinishedSurface,
    measurements: tuple[VolumeMeasurement, ...],
    body: BodyDirections | None,
    *,
    job: Context,
) -> Symmetry | None:
    """Left breast compared with the mirrored right one. None without a mid-sagittal plane."""
    from mammometry.measure.shape.symmetry import symmetry

    if body is None or body.plane is None:
        return None
    try:
        return symmetry(measurements, body.frame, body.plane)
    except MeasureError:
        return None


@product("measure", version=8, settings="measure", inputs=("mounting",), threads=1)
def dimensions(
    corrected_cameras: CameraSet,
    mesh: FinishedSurface,
    measurements: tuple[VolumeMeasurement, ...],
    body: BodyDirections | None,
    landmarks: tuple[Landmark, ...],
    boundaries: tuple[Boundary, ...],
    *,
    job: Context,
) -> Dimensions:
    """Shape, lengths and ptosis of each breast."""
    from mammometry.measure.shape.anthropometry import dimensions

    frame, plane = _frame(corrected_cameras, job, body), None if body is None else body.plane
    surface, settings = mesh.repaired.mesh, job.settings.measure
    hidden = [boundary.name for boundary in boundaries if boundary.hidden_fold_cm2]
    return dimensions(surface, measurements, landmarks, frame, settings, plane=plane, hidden_folds=hidden)
