"""Cameras that later stages may rely on: adjusted and judged, or as they were imported."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from mammometry.base.errors import CalibrationError
from mammometry.base.progress import Progress, no_progress
from mammometry.geometry.camera import Rig
from mammometry.job.inputs import Inputs
from mammometry.job.stage_values import CameraSet

if TYPE_CHECKING:  # The stages bring compilers and image libraries, which a plan alone need not wait for.
    from mammometry.calibration.adjust.bundle import Calibration
    from mammometry.calibration.detection.detect import Observations
    from mammometry.calibration.settings import CalibrateSettings


def adjust_rig(
    inputs: Inputs,
    poses: Sequence[Observations],
    lenses: Mapping[str, Observations],
    settings: CalibrateSettings,
    *,
    progress: Progress = no_progress,
) -> Calibration:
    """Adjust the rig to what was seen of the target.

    Args:
        inputs: of the session.
        poses: what all cameras saw of the target, pose by pose.
        lenses: camera → what it saw of the intrinsics target.
        settings: those of the calibration.
        progress: called with the fraction done.

    Raises:
        CalibrationError: no photograph shows the target, cameras cannot be adjusted, or the result contradicts what
            the session says of its rig.
    """
    from mammometry.calibration.detection.detect import merged
    from mammometry.calibration.detection.duplicates import set_duplicates_aside
    from mammometry.calibration.judge import no_target
    from mammometry.calibration.judge.scale import require_scale
    from mammometry.calibration.judge.sides import require_sides

    assert inputs.target is not None
    photographs = inputs.calibration_photographs
    if not any(part.detections for part in poses):
        raise no_target.no_target(inputs.target, poses, photographs)
    usable = set_duplicates_aside(merged(poses))
    try:
        found = _adjusted(inputs, usable, lenses, settings, progress)
    except CalibrationError as error:
        raise no_target.with_causes(error, (usable, *lenses.values()), photographs) from None
    require_sides(found.rig, inputs.upside_down)
    require_scale(found, inputs.subject_kind)
    return found


def trusted_cameras(calibration: Calibration, inputs: Inputs, settings: CalibrateSettings) -> CameraSet:
    """Take the cameras of a calibration that is fit to measure with.

    Raises:
        CalibrationError: its quality does not suffice; names the board or the photographs that spoil it.
    """
    from mammometry.calibration.judge import quality, suspects

    def recalibrate(observations: Observations, target_prior_mm: tuple[float, float, float] | None) -> Calibration:
        bundle = settings.bundle
        if target_prior_mm is not None:
            bundle = replace(bundle, free_target="always", target_prior_mm=target_prior_mm)
        lenses = calibration.intrinsics_observations
        return _adjusted(inputs, observations, lenses, replace(settings, bundle=bundle), no_progress)

    assessed = quality.assess(calibration, settings.quality)
    if assessed.verdict == "refuse":
        raise suspects.refusal(calibration, assessed, recalibrate, settings.quality)
    return CameraSet(
        rig=calibration.rig,
        std={name: dict(values) for name, values in calibration.parameter_std.items()},
        world=calibration.world,
        rms_px=float(calibration.rms_px),
        verdict=assessed.verdict,
        reasons=assessed.reasons,
    )


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


def imported_cameras(inputs: Inputs) -> CameraSet:
    """Take the cameras that came with the session.

    Raises:
        CalibrationError: one of the rig's is missing, or a pair's sides are wrong.
        SessionError: their lengths are in another unit.
    """
    from mammometry.calibration.judge.scale import require_camera_scale
    from mammometry.calibration.judge.sides import require_sides

    assert inputs.cameras is not None
    wanted = sorted({name for pair in inputs.pair_names.values() for name in pair} | set(inputs.photographs))
    missing = [name for name in wanted if name not in inputs.cameras]
    if missing:
        raise CalibrationError(
            "cameras.json",
            found=f"cameras {', '.join(inputs.cameras)}",
            expected=f"also {', '.join(missing)}",
            remedy="Import every camera of the rig, under the names that session.toml uses",
        )
    rig = Rig(
        name=inputs.rig_name, cameras={name: inputs.cameras[name] for name in wanted}, pair_names=inputs.pair_names
    )
    require_sides(rig, inputs.upside_down)
    doubts = require_camera_scale("cameras.json: t", rig, inputs.subject_kind)
    world = "The world frame of the cameras that were imported."
    return CameraSet(rig=rig, std={}, world=world, rms_px=None, reasons=doubts)
