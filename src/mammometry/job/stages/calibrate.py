"""Calibration stage: from photographs of the target to calibrated cameras. Paper 2.2."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from mammometry.base.errors import CalibrationError
from mammometry.base.photograph import Photograph
from mammometry.base.progress import Progress, no_progress
from mammometry.geometry.camera import Rig
from mammometry.job.inputs import CameraSet, Inputs
from mammometry.job.products import Context, product, product_of_each

if TYPE_CHECKING:  # the stages import compilers and image libraries, which a plan does not need
    from mammometry.calibration.adjust.calibrated import Calibration
    from mammometry.calibration.detection.detect import Observations
    from mammometry.calibration.judge.suspects import Recalibrate
    from mammometry.calibration.settings import CalibrateSettings
    from mammometry.calibration.targets.target import Target


def _pose_inputs(job: Context) -> dict[str, str]:
    """Digests of a pose's photographs, of points given for them, and of the target."""
    shots = [shot for shot in job.inputs.calibration_photographs if shot[0] == job.item]
    names = {f"{pose}/{camera}": f"calibration/{pose}/{camera}" for pose, camera in shots}
    points = [f"points/{pose}/{camera}" for pose, camera in shots if (pose, camera) in job.inputs.measured_points]
    return job.inputs.key_part("target", *points) | {name: job.inputs.digests[full] for name, full in names.items()}


@product_of_each(
    "calibrate",
    version=9,
    name="observations/{item}",
    settings="calibration.detect",
    inputs=_pose_inputs,
)
def observation(*, job: Context) -> Observations:
    """Points of the target found in the photographs of one pose."""
    shots = _OnePose(job.inputs.calibration_photographs, job.item)
    assert job.inputs.target is not None
    return _detect(shots, job.inputs.target, job)


def _lens_inputs(job: Context) -> dict[str, str]:
    exposures = [exposure for exposure, _ in job.inputs.intrinsics_photographs[job.item]]
    digests = {exposure: job.inputs.digests[f"intrinsics/{job.item}/{exposure}"] for exposure in exposures}
    return digests | {"target": job.inputs.digests["intrinsics-target"]}


@product_of_each(
    "calibrate",
    version=9,
    name="observations/intrinsics-{item}",
    settings="calibration.detect",
    inputs=_lens_inputs,
)
def lens_observation(*, job: Context) -> Observations:
    """Points of the intrinsics target found in one camera's photographs of it."""
    assert job.inputs.intrinsics_target is not None
    return _detect(job.inputs.intrinsics_photographs[job.item], job.inputs.intrinsics_target, job)


def _detect(shots: Mapping[tuple[str, str], Photograph], target: Target, job: Context) -> Observations:
    from mammometry.calibration.detection import detect

    measured = {shot: job.inputs.measured_points[shot] for shot in shots if shot in job.inputs.measured_points}
    return detect.detect(shots, target, measured=measured, progress=job.progress)


def _judged_settings(job: Context) -> object:
    return job.settings.calibration.bundle, job.settings.calibration.quality


@product(
    "calibrate",
    version=7,
    settings=_judged_settings,
    inputs=("rig", "subject", "prior", "mounting"),
)
def calibration(
    observations: Mapping[str, Observations], lens_observations: Mapping[str, Observations], *, job: Context
) -> Calibration:
    """The bundle adjustment's result. A photograph that contradicts all others is left out.

    Raises:
        CalibrationError: no photograph shows the target, cameras cannot be adjusted, or the result contradicts what
            the session states about its rig.
    """
    from mammometry.calibration.detection.detect import merged, set_duplicates_aside
    from mammometry.calibration.judge import no_target, quality, suspects
    from mammometry.calibration.judge.scale import require_scale, require_sides

    inputs, settings = job.inputs, job.settings.calibration
    assert inputs.target is not None
    poses, photographs = tuple(observations.values()), inputs.calibration_photographs
    if not any(pose.detections for pose in poses):
        raise no_target.no_target(inputs.target, poses, photographs)
    usable = set_duplicates_aside(merged(poses))
    try:
        adjusted = _adjusted(inputs, usable, lens_observations, settings, job.progress)
    except CalibrationError as error:
        seen = (usable, *lens_observations.values())
        raise no_target.with_causes(error, seen, photographs) from None
    require_sides(adjusted.rig, inputs.upside_down)
    require_scale(adjusted, inputs.subject_kind)
    judged = quality.assess(adjusted, settings.quality)
    if judged.verdict != "refuse":
        return adjusted
    spared = suspects.spared_photograph(adjusted, judged, _recalibration(adjusted, job), settings.quality)
    return adjusted if spared is None else spared[0]


def _recalibration(calibration: Calibration, job: Context) -> Recalibrate:
    """Function that adjusts other observations of the rig, with or without the board's shape."""
    settings = job.settings.calibration

    def recalibrate(observations: Observations, target_prior_mm: tuple[float, float, float] | None) -> Calibration:
        bundle = settings.bundle
        if target_prior_mm is not None:
            bundle = replace(bundle, free_target="always", target_prior_mm=target_prior_mm)
        lenses = calibration.intrinsics_observations
        return _adjusted(job.inputs, observations, lenses, replace(settings, bundle=bundle), no_progress)

    return recalibrate


def _adjusted(
    inputs: Inputs,
    observations: Observations,
    lenses: Mapping[str, Observations],
    settings: CalibrateSettings,
    progress: Progress,
) -> Calibration:
    from mammometry.calibration.adjust import bundle

    return bundle.calibrate(
        observations,
        inputs.pair_names,
        inputs.rig_name,
        settings,
        intrinsics_observations=lenses or None,
        priors=inputs.priors,
        progress=progress,
    )


@product(
    "calibrate",
    version=6,
    settings=lambda job: job.settings.calibration.quality if job.inputs.calibrates else None,
    inputs=lambda job: {} if job.inputs.calibrates else job.inputs.key_part("cameras", "rig", "subject"),
)
def cameras(calibration: Calibration | None, *, job: Context) -> CameraSet:
    """The calibrated cameras, if the calibration is good enough, or the given ones.

    Raises:
        CalibrationError: the calibration is not good enough (the error names the board or photographs that cause it), a
            camera of the rig is missing, or a pair's sides are exchanged.
        SessionError: the given cameras' lengths are in another unit.
    """
    if calibration is None:
        return _imported(job.inputs)
    from mammometry.calibration.judge import quality, suspects

    settings = job.settings.calibration

    assessed = quality.assess(calibration, settings.quality)
    if assessed.verdict == "refuse":
        raise suspects.refusal(calibration, assessed, _recalibration(calibration, job), settings.quality)
    return CameraSet(
        rig=calibration.rig,
        std={name: dict(values) for name, values in calibration.parameter_std.items()},
        world=calibration.world,
        rms_px=float(calibration.rms_px),
        verdict=assessed.verdict,
        notices=assessed.notices,
    )


def _imported(inputs: Inputs) -> CameraSet:
    """The given cameras, checked."""
    from mammometry.calibration.judge.scale import require_camera_scale, require_sides

    assert inputs.cameras is not None
    wanted = sorted({name for pair in inputs.pair_names.values() for name in pair} | set(inputs.photographs))
    missing = [name for name in wanted if name not in inputs.cameras]
    if missing:
        remedy = "Import every camera of the rig, under the names that session.toml uses"
        expected = f"also {', '.join(missing)}"
        raise CalibrationError(
            "cameras.json", found=f"cameras {', '.join(inputs.cameras)}", expected=expected, remedy=remedy
        )
    rig = Rig(
        name=inputs.rig_name, cameras={name: inputs.cameras[name] for name in wanted}, pair_names=inputs.pair_names
    )
    require_sides(rig, inputs.upside_down)
    doubts = require_camera_scale("cameras.json: t", rig, inputs.subject_kind)
    world = "The world frame of the cameras that were imported."
    if inputs.walk is not None:
        world = "The printed board: x along its rows, y down, z away from the reader."
    return CameraSet(rig=rig, std={}, world=world, rms_px=None, notices=doubts)


class _OnePose(Mapping[tuple[str, str], Photograph]):
    """The calibration photographs of one pose, read when looked up."""

    def __init__(self, photographs: Mapping[tuple[str, str], Photograph], pose: str) -> None:
        self._photographs = photographs
        self._keys = tuple(key for key in photographs if key[0] == pose)

    def __getitem__(self, key: tuple[str, str]) -> Photograph:
        return self._photographs[key]

    def __iter__(self) -> Iterator[tuple[str, str]]:
        return iter(self._keys)

    def __len__(self) -> int:
        return len(self._keys)
