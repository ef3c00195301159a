"""Cameras connected to this computer, for the clinic's pages.

clinic.toml names a rig.toml for each rig that is connected here. Cameras are opened when a page first needs them, and
released after a while without requests, so that other programs can use them.
"""

import atexit
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from mammometry.base.errors import CaptureError
from mammometry.capture.loop import OpenRig
from mammometry.capture.page import CameraService
from mammometry.capture.sessions import definition_of, read_rig_file
from mammometry.clinic.models import Calibration, Rig
from mammometry.clinic.site import the_clinic

_IDLE_S = 60.0
"""Seconds without requests after which cameras are released. A live page sends several per second."""


@dataclass(slots=True)
class _Open:
    key: tuple[object, ...]
    service: CameraService
    used_s: float


_one = threading.RLock()
_open: dict[str, _Open] = {}
_timer: threading.Timer | None = None


def rig_file(rig: Rig) -> Path | None:
    """The rig.toml of a rig that is connected to this computer."""
    name = the_clinic().cameras.get(rig.name)
    return None if name is None else the_clinic().folder / name


def service_of(rig: Rig, calibration: Calibration | None) -> CameraService:
    """Return a rig's open cameras.

    They are opened if needed, or if the rig's file or the calibration has changed.

    Args:
        rig: one of the clinic's.
        calibration: to compare with the pictures; None if there is none yet.

    Raises:
        CaptureError: no such cameras are connected, or they do not answer.
        SessionError: the rig's file is invalid or of another rig.
    """
    path = rig_file(rig)
    if path is None:
        remedy = "Ask the administrator; until then, upload the photographs"
        expected = "its rig.toml in clinic.toml"
        raise CaptureError(rig.name, found="no cameras connected to this computer", expected=expected, remedy=remedy)
    folder = None if calibration is None else the_clinic().folder / calibration.folder
    with _one:
        file = read_rig_file(path)
        key = (path, path.stat().st_mtime_ns, folder)
        entry = _open.get(str(rig.pk))
        if entry is not None and entry.key != key:
            _close(str(rig.pk))
            entry = None
        if entry is None:
            if definition_of(file).get("rig", {}).get("pairs") != rig.definition.get("rig", {}).get("pairs"):
                raise CaptureError(
                    f"{path.name}: rig.pairs", found="other cameras or pairs", expected=f"those of {rig.name}",
                    remedy="Correct the file, or name the right one in clinic.toml",
                )  # fmt: skip
            # Visits are measured with the clinic's calibration, so the one in the rig's file is ignored.
            rigged = OpenRig(path, calibration=folder, settings=the_clinic().measuring(), own_calibration=False)
            entry = _open[str(rig.pk)] = _Open(key=key, service=CameraService(rigged), used_s=time.monotonic())
        entry.used_s = time.monotonic()
        _watch()
        return entry.service


def close_idle(*, idle_s: float = 0.0) -> int:
    """Release cameras that no page uses.

    Args:
        idle_s: least time since the last request.

    Returns:
        Number of rigs that are still open.
    """
    with _one:
        for key in [key for key, opened in _open.items() if time.monotonic() - opened.used_s >= idle_s]:
            _close(key)
        return len(_open)


def _close(key: str) -> None:
    _open.pop(key).service.close()


def _watch() -> None:
    global _timer
    if _timer is None:
        _timer = threading.Timer(_IDLE_S, _look_again)
        _timer.daemon = True
        _timer.start()


def _look_again() -> None:
    global _timer
    with _one:
        _timer = None
        if close_idle(idle_s=_IDLE_S):
            _watch()


atexit.register(close_idle)
