"""Warnings of the calibration and of its photographs."""

from mammometry.base.notices import Notice
from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.calibration.judge.quality import CalibrationQuality
from mammometry.report.content import sentence


def rig_doubts(quality: CalibrationQuality | None) -> list[str]:
    """Warnings of a whole calibration."""
    return [] if quality is None else [doubt.sentence for doubt in quality.doubts if not doubt.shots]


def photograph_doubts(quality: CalibrationQuality | None, calibration: Calibration | None) -> tuple[Notice, ...]:
    """Warnings about single photographs of a calibration, which a technician may leave out."""
    doubts = () if quality is None else quality.doubts
    left_out = () if calibration is None else calibration.set_aside
    return (
        *(
            Notice(
                code="board-photograph-doubtful",
                level="note",
                about=tuple(dict.fromkeys(shot.camera for shot in doubt.shots)),
                photographs=tuple(f"calibration/{shot.pose}/{shot.camera}" for shot in doubt.shots),
                values={"text": sentence(doubt.sentence)},
            )
            for doubt in doubts
            if doubt.shots
        ),
        *(
            Notice(
                code="board-photograph-left-out",
                level="note",
                about=(away.camera,),
                photographs=(f"calibration/{away.pose}/{away.camera}",),
                values={"pose": away.pose, "px": away.residual_px},
            )
            for away in left_out
        ),
    )
