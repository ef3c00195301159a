"""Cameras that later stages may rely on: of a calibration that was judged, or as they were imported."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mammometry.base.errors import CalibrationError
from mammometry.geometry.camera import Rig
from mammometry.job.inputs import Inputs
from mammometry.job.stage_values import CameraSet

if TYPE_CHECKING:  # The stages bring compilers and image libraries, which a plan alone need not wait for.
    from mammometry.calibration.adjust.bundle import Calibration
    from mammometry.calibration.settings import CalibrateSettings


def trusted_cameras(calibration: Calibration, inputs: Inputs, settings: CalibrateSettings) -> CameraSet:
    """Take the cameras of a calibration that is fit to measure with.

    Raises:
        CalibrationError: a pair's sides or the target's size are wrong, or its quality does not suffice.
    """
    from mammometry.calibration.judge import quality, scale, sides

    sides.require_sides(calibration.rig, inputs.upside_down)
    scale.require_scale(calibration, inputs.subject_kind)
    assessed = quality.assess(calibration, settings.quality)
    if assessed.verdict == "refuse":
        raise CalibrationError(
            "calibration",
            found=f"that {assessed.reasons[0].rstrip('.')}",
            expected="a calibration fit to measure with",
            remedy="Retake the calibration photographs, or set the suspect ones aside, and run it again",
        )
    return CameraSet(
        rig=calibration.rig,
        std={name: dict(values) for name, values in calibration.parameter_std.items()},
        world=calibration.world,
        rms_px=float(calibration.rms_px),
        verdict=assessed.verdict,
        reasons=assessed.reasons,
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
