"""Checks which camera took each photograph, and whether all are from one exposure."""

from __future__ import annotations

import re
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mammometry.capture.checks import Finding
from mammometry.io.photographs.tags import PhotographTags

_TOGETHER_S = 20.0
"""Largest difference in time within one exposure, if the clocks' differences are unknown. Clocks are set by hand to a
second or two. Two exposures of one visit are further apart."""
_TOGETHER_KNOWN_S = 2.5  # the same if the differences are known: EXIF has whole seconds, and clocks drift


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownCamera:
    """Facts about one camera of a rig, from its calibration photographs."""

    stored_wh: tuple[int, int] | None = None
    """Width and height of its files, px."""
    orientation: int = 1
    """EXIF orientation of its files."""
    serial: str = ""
    clock_s: float | None = None
    """How far its clock is ahead of the rig's median clock, s."""

    def as_table(self) -> dict[str, Any]:
        """These facts as JSON."""
        size = None if self.stored_wh is None else list(self.stored_wh)
        return {"stored_wh": size, "orientation": self.orientation, "serial": self.serial, "clock_s": self.clock_s}

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> KnownCamera:
        """Read these facts from JSON."""
        size = table.get("stored_wh")
        return cls(
            stored_wh=None if size is None else (int(size[0]), int(size[1])),
            orientation=int(table.get("orientation", 1)),
            serial=str(table.get("serial", "")),
            clock_s=table.get("clock_s"),
        )


def clocks(taken: Mapping[tuple[str, str], float]) -> dict[str, float]:
    """How far each camera's clock is ahead of the others, from simultaneous exposures.

    Args:
        taken: (pose, camera) → time by the camera's own clock, s.

    Returns:
        Camera → median over the poses of the difference to the median of the pose, s.
    """
    poses: dict[str, dict[str, float]] = {}
    for (pose, camera), moment in taken.items():
        poses.setdefault(pose, {})[camera] = moment
    ahead: dict[str, list[float]] = {}
    for seen in poses.values():
        middle = statistics.median(seen.values())
        for camera, moment in seen.items():
            ahead.setdefault(camera, []).append(moment - middle)
    return {camera: statistics.median(values) for camera, values in ahead.items()}


def camera_of_name(name: str, cameras: Sequence[str]) -> str | None:
    """The camera whose name is a whole word in a file's name. None if there is none, or several."""
    stem = re.sub(r"\.[A-Za-z]+$", "", name).lower()
    named = [camera for camera in cameras if re.search(rf"(?<![a-z0-9]){re.escape(camera.lower())}(?![a-z0-9])", stem)]
    longest = [camera for camera in named if not any(camera != other and camera in other for other in named)]
    return longest[0] if len(longest) == 1 else None


def camera_of_serial(serial: str, known: Mapping[str, KnownCamera]) -> str | None:
    """The only camera with this serial number. None if there is none, or several."""
    matching = [camera for camera, about in known.items() if serial and about.serial == serial]
    return matching[0] if len(matching) == 1 else None


def right_camera(camera: str, exposure: PhotographTags, named: str | None, known: Mapping[str, KnownCamera]) -> Finding:
    """Check that a photograph is assigned to the right camera.

    Args:
        camera: the camera that it is assigned to.
        exposure: metadata of its file.
        named: the camera in the file's name, if any.
        known: camera → facts from the calibration.
    """
    wanted = known.get(camera, KnownCamera()).serial
    if exposure.serial and wanted:
        if exposure.serial == wanted:
            return Finding("camera", "ok", f"Taken by {camera}, by its serial number.")
        other = camera_of_serial(exposure.serial, known)
        by = f"by {other}" if other else "by a camera that is not in the calibration"
        remedy = "File it under that camera" if other else f"Use the photograph of {camera}, or calibrate again"
        return Finding("camera", "refuse", f"This photograph was taken {by}. {remedy}.")
    if named is not None and named != camera:
        return Finding(
            "camera",
            "refuse",
            f"The file is named {named}, but is filed under {camera}. File it under {named}.",
        )
    if named == camera:
        return Finding("camera", "ok", f"The file is named {camera}.")
    return Finding("camera", "unknown", "The file does not say which camera took it.")


def right_size(camera: str, stored_wh: tuple[int, int], orientation: int, known: Mapping[str, KnownCamera]) -> Finding:
    """Check that a photograph has the size and orientation of the calibration's photographs."""
    about = known.get(camera, KnownCamera())
    if about.stored_wh is None:
        return Finding("size", "unknown", "Its expected size is unknown without a calibration.")
    if stored_wh != about.stored_wh:
        (width, height), (right_width, right_height) = stored_wh, about.stored_wh
        return Finding(
            "size",
            "refuse",
            f"The photograph has {width} × {height} pixels. {camera} was calibrated with {right_width} × "
            f"{right_height}. Send the original file, not cropped, rotated or resized.",
        )
    if orientation != about.orientation:
        return Finding(
            "size",
            "refuse",
            f"The photograph is rotated differently from the calibration of {camera}. Turn off the camera's "
            "automatic rotation, and send the original file.",
        )
    return Finding("size", "ok", f"{stored_wh[0]} × {stored_wh[1]} pixels, as at the calibration.")


def together(taken: Mapping[str, float], clock_s: Mapping[str, float]) -> Finding:
    """Check that all photographs are from one exposure.

    Args:
        taken: camera → time by its own clock, s.
        clock_s: camera → how far its clock is ahead, if known.
    """
    if len(taken) < 2:
        return Finding("times", "unknown", "The files have no time.")
    known = set(taken) <= set(clock_s)
    limit = _TOGETHER_KNOWN_S if known else _TOGETHER_S
    moments = {camera: moment - (clock_s[camera] if known else 0.0) for camera, moment in taken.items()}
    middle = statistics.median(moments.values())
    apart = {camera: moment - middle for camera, moment in moments.items() if abs(moment - middle) > limit}
    if not apart:
        return Finding("times", "ok", "All photographs were taken together.")
    worst = max(apart, key=lambda camera: abs(apart[camera]))
    how = "before" if apart[worst] < 0 else "after"
    others = f" So were {len(apart) - 1} more." if len(apart) > 1 else ""
    return Finding(
        "times",
        "warn",
        f"{worst} was taken {_duration(abs(apart[worst]))} {how} the others.{others} Use the photograph of the "
        "same exposure, or set the camera's clock.",
    )


def twice(digests: Mapping[str, str]) -> list[Finding]:
    """Refuse the same file for two cameras.

    Args:
        digests: camera → SHA-256 of its file.
    """
    first: dict[str, str] = {}
    findings = []
    for camera, digest in digests.items():
        other = first.setdefault(digest, camera)
        if other != camera:
            sentence = f"{other} and {camera} are the same photograph. Use each camera's own."
            findings.append(Finding("twice", "refuse", sentence))
    return findings


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.0f} h"
