"""Which camera took a photograph. And whether it fits what the calibration knows of that camera."""

from __future__ import annotations

import re
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mammometry.capture.checks.found import Found
from mammometry.io.photographs.exposure import Exposure

_TOGETHER_S = 20.0
"""Cameras are released together; their clocks are set by hand, and read to a second or two where no calibration tells
how they differ. Two exposures of one visit lie further apart. Chosen by eye."""
_TOGETHER_KNOWN_S = 2.5  # where the calibration tells how the clocks differ: EXIF counts whole seconds, clocks drift


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownCamera:
    """One camera of a rig, as its calibration's photographs show it."""

    stored_wh: tuple[int, int] | None = None
    """Width and height of its files, px."""
    orientation: int = 1
    """EXIF orientation of its files."""
    serial: str = ""
    clock_s: float | None = None
    """How far its clock is ahead of the rig's median clock, s."""

    def as_table(self) -> dict[str, Any]:
        """As JSON."""
        size = None if self.stored_wh is None else list(self.stored_wh)
        return {"stored_wh": size, "orientation": self.orientation, "serial": self.serial, "clock_s": self.clock_s}

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> KnownCamera:
        """Back from JSON."""
        size = table.get("stored_wh")
        return cls(
            stored_wh=None if size is None else (int(size[0]), int(size[1])),
            orientation=int(table.get("orientation", 1)),
            serial=str(table.get("serial", "")),
            clock_s=table.get("clock_s"),
        )


def clocks(taken: Mapping[tuple[str, str], float]) -> dict[str, float]:
    """How far each camera's clock is ahead of the others. By exposures that were made together.

    Args:
        taken: (pose, camera) → moment by the camera's own clock, s.

    Returns:
        Camera → median over the poses of its difference to the pose's median, s.
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
    """The one camera that a file's name names as a whole word. None if none or several do."""
    stem = re.sub(r"\.[A-Za-z]+$", "", name).lower()
    found = [camera for camera in cameras if re.search(rf"(?<![a-z0-9]){re.escape(camera.lower())}(?![a-z0-9])", stem)]
    longest = [camera for camera in found if not any(camera != other and camera in other for other in found)]
    return longest[0] if len(longest) == 1 else None


def camera_of_serial(serial: str, known: Mapping[str, KnownCamera]) -> str | None:
    """The one camera that has this serial number."""
    found = [camera for camera, about in known.items() if serial and about.serial == serial]
    return found[0] if len(found) == 1 else None


def right_camera(camera: str, exposure: Exposure, named: str | None, known: Mapping[str, KnownCamera]) -> Found:
    """Whether the photograph lies under the right camera.

    Args:
        camera: in whose place it was put.
        exposure: what its file says.
        named: the camera that the file's name names, if it does.
        known: camera → what the calibration knows.
    """
    wanted = known.get(camera, KnownCamera()).serial
    if exposure.serial and wanted:
        if exposure.serial == wanted:
            return Found(check="camera", level="ok", sentence=f"Taken by {camera}, by its serial number.")
        other = camera_of_serial(exposure.serial, known)
        by = f"by {other}" if other else "by a camera that was not there at the calibration"
        remedy = "Put it in that camera's place" if other else f"Take the photograph of {camera}, or calibrate again"
        return Found(check="camera", level="refuse", sentence=f"This photograph was taken {by}. {remedy}.")
    if named is not None and named != camera:
        return Found(
            check="camera",
            level="refuse",
            sentence=f"The file is called {named}, and this is the place of {camera}. Put it in the place of {named}.",
        )
    if named == camera:
        return Found(check="camera", level="ok", sentence=f"The file is called {camera}.")
    return Found(check="camera", level="unknown", sentence="The file does not say which camera took it.")


def right_size(camera: str, stored_wh: tuple[int, int], orientation: int, known: Mapping[str, KnownCamera]) -> Found:
    """Whether a photograph is as large as the calibration's, and turned alike."""
    about = known.get(camera, KnownCamera())
    if about.stored_wh is None:
        return Found(check="size", level="unknown", sentence="No calibration says how large it should be.")
    if stored_wh != about.stored_wh:
        (width, height), (right_width, right_height) = stored_wh, about.stored_wh
        return Found(
            check="size",
            level="refuse",
            sentence=f"The photograph has {width} × {height} pixels. {camera} was calibrated with {right_width} × "
            f"{right_height}. Send the file as the camera wrote it, not cut, turned or made smaller.",
        )
    if orientation != about.orientation:
        return Found(
            check="size",
            level="refuse",
            sentence=f"The photograph is turned otherwise than at the calibration of {camera}. Switch off the "
            "camera's automatic rotation, and send the file as the camera wrote it.",
        )
    return Found(check="size", level="ok", sentence=f"{stored_wh[0]} × {stored_wh[1]} pixels, as at the calibration.")


def together(taken: Mapping[str, float], clock_s: Mapping[str, float]) -> Found:
    """Whether all photographs are of one exposure.

    Args:
        taken: camera → moment by its own clock, s.
        clock_s: camera → how far its clock is ahead, where that is known.
    """
    if len(taken) < 2:
        return Found(check="times", level="unknown", sentence="The files do not say when they were taken.")
    known = set(taken) <= set(clock_s)
    limit = _TOGETHER_KNOWN_S if known else _TOGETHER_S
    moments = {camera: moment - (clock_s[camera] if known else 0.0) for camera, moment in taken.items()}
    middle = statistics.median(moments.values())
    apart = {camera: moment - middle for camera, moment in moments.items() if abs(moment - middle) > limit}
    if not apart:
        return Found(check="times", level="ok", sentence="All photographs were taken together.")
    worst = max(apart, key=lambda camera: abs(apart[camera]))
    how = "before" if apart[worst] < 0 else "after"
    others = f" {len(apart) - 1} more are apart, too." if len(apart) > 1 else ""
    return Found(
        check="times",
        level="warn",
        sentence=f"{worst} was taken {_duration(abs(apart[worst]))} {how} the others.{others} Send the photograph of "
        "the same exposure, or set the camera's clock.",
    )


def twice(digests: Mapping[str, str]) -> list[Found]:
    """Refuse one file in two cameras' places.

    Args:
        digests: camera → SHA-256 of its file.
    """
    first: dict[str, str] = {}
    found = []
    for camera, digest in digests.items():
        other = first.setdefault(digest, camera)
        if other != camera:
            sentence = f"{other} and {camera} are the same photograph. Send each camera's own."
            found.append(Found(check="twice", level="refuse", sentence=sentence))
    return found


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.0f} h"
