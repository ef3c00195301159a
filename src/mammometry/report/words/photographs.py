"""Photographs that a sentence names, and warnings of the calibration's."""

import re
from collections.abc import Mapping

from mammometry.base.notices import Notice
from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.calibration.judge.quality import CalibrationQuality
from mammometry.report.content import sentence as whole_sentence


def named_photographs(sentence: str, photographs: Mapping[str, str]) -> dict[str, str]:
    """Those photographs that a sentence names, by pose and camera, or as a camera's photograph."""

    def names(word: str) -> bool:
        return re.search(rf"(?<![\w.-]){re.escape(word)}(?![\w-])", sentence, re.IGNORECASE) is not None

    found = {}
    for name, address in photographs.items():
        place, *pose, camera = name.split("/")
        matches = names(f"pose {pose[0]}") if pose else " photograph" in sentence and not names("pose")
        if place in ("capture", "calibration") and matches and names(camera):
            found[name] = address
    return found


def rig_doubts(quality: CalibrationQuality | None, calibration: Calibration | None) -> list[str]:
    """Warnings of a calibration that name none of its photographs."""
    doubts = () if quality is None else quality.doubts
    return [doubt for doubt in doubts if not named_photographs(doubt, _names(calibration))]


def photograph_doubts(quality: CalibrationQuality | None, calibration: Calibration | None) -> tuple[Notice, ...]:
    """Warnings of single photographs of a calibration, which a technician may leave out."""
    doubts = () if quality is None else quality.doubts
    of_photographs = [
        Notice(code="board-photograph-doubtful", level="note", values={"text": whole_sentence(doubt)})
        for doubt in doubts
        if named_photographs(doubt, _names(calibration))
    ]
    for away in calibration.set_aside if calibration is not None else ():
        of_photographs.append(
            Notice(
                code="board-photograph-left-out",
                level="note",
                about=(away.camera,),
                values={"pose": away.pose, "px": away.residual_px},
            )
        )
    return tuple(of_photographs)


def _names(calibration: Calibration | None) -> dict[str, str]:
    if calibration is None:
        return {}
    seen = calibration.observations
    shots = [(view.pose, view.camera) for view in seen.detections]
    shots += [(view.pose, view.camera) for view in seen.missed]
    shots += [(view.pose, view.camera) for view in calibration.set_aside]
    return {f"calibration/{pose}/{camera}": "" for pose, camera in shots}
