"""Interface for all kinds of cameras: pictures, states, settings."""

from __future__ import annotations

import getpass
import hashlib
import importlib
import tempfile
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, Protocol, TypeAlias

from filelock import FileLock, Timeout

from mammometry.base.errors import CaptureError, SettingsError
from mammometry.base.photograph import Photograph
from mammometry.base.registry import Registry

Clock: TypeAlias = Literal["ptp", "host", "exif", "none"]
"""Clock of a picture's time: one shared by all cameras, this computer's at arrival, each camera's own in EXIF, or none.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraSettings:
    """Exposure settings of all cameras. None keeps the cameras' own setting."""

    exposure_ms: float | None = None
    """Exposure time, the same for all cameras, so that each exposure includes the flash. None: as set on the
    cameras."""
    gain_db: float | None = None
    """Gain of the sensor, as low as the light allows, because it also amplifies noise. None: as set on the cameras."""
    trigger: Literal["wire", "software"] = "wire"
    """``wire``: an external pulse exposes all cameras at once. ``software``: one command per camera, for tests and
    set-up."""

    def __post_init__(self) -> None:
        if self.exposure_ms is not None and not 0.01 <= self.exposure_ms <= 10_000:
            raise ValueError(f"exposure_ms must be between 0.01 and 10000, found {self.exposure_ms:g}")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """One picture as delivered by a camera."""

    camera: str
    content: bytes | Photograph
    """A complete JPEG, PNG or TIFF from the camera, or pixels."""
    taken_s: float | None = None
    """Time of the exposure by its clock, seconds."""
    clock: Clock = "none"
    number: int | None = None
    """The camera's picture counter."""
    serial: str = ""
    """Serial number of the camera, if known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Health:
    """State of one camera."""

    fault: str = ""
    """The fault in one sentence. Empty if there is none."""
    model: str = ""
    serial: str = ""
    size_wh: tuple[int, int] | None = None
    """Width and height of its pictures, px."""
    temperature_c: float | None = None

    def as_table(self) -> dict[str, Any]:
        """The state as JSON."""
        return {
            "fault": self.fault,
            "model": self.model,
            "serial": self.serial,
            "size_wh": None if self.size_wh is None else list(self.size_wh),
            "temperature_c": self.temperature_c,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Devices:
    """The cameras that a back-end opens."""

    cameras: tuple[str, ...]
    """Names of the cameras in the rig."""
    ids: Mapping[str, str]
    """Camera → serial number, address or port in the back-end. May be incomplete."""
    options: Mapping[str, Any]
    """Options of the back-end, from the rig's file."""


class Backend(Protocol):
    """All cameras of a rig, opened.

    A back-end is created from `Devices`, which opens the cameras. If one camera fails, `fetch` raises a `CaptureError`
    or `health` reports a fault, and the others continue. `fetch` and `live` are called for several cameras in parallel.
    """

    def settings(self, wanted: CameraSettings) -> None:
        """Set all cameras.

        Raises:
            CaptureError: a camera refuses.
        """

    def arm(self) -> None:
        """Make all cameras wait for the trigger. Earlier pictures are dropped."""

    def fire(self) -> float:
        """Trigger the exposure, unless a wire does.

        Returns:
            Time of the exposure (``time.time()``).
        """

    def fetch(self, camera: str, timeout_s: float) -> Frame:
        """Return the picture of the last exposure.

        Raises:
            CaptureError: it is missing or damaged.
        """

    def live(self, camera: str) -> Photograph:
        """Return a live picture, small if the camera supports it.

        Raises:
            CaptureError: there is none.
        """

    def health(self, camera: str) -> Health:
        """Report the state of a camera."""

    def close(self) -> None:
        """Release the cameras."""


def failed(camera: str, found: str, remedy: str, *, expected: str = "one picture of this firing") -> CaptureError:
    """Return the error for one camera."""
    return CaptureError(camera, found=found, expected=expected, remedy=remedy)


class Holds:
    """Locks on the cameras of a rig, held until `release` or the end of the process."""

    def __init__(self, rig: str, backend: str, ids: Mapping[str, str]) -> None:
        """Lock all cameras, or none if one is in use.

        Args:
            rig: name of the rig, for messages of other rigs.
            backend: kind of cameras.
            ids: camera → serial number, address or port.

        Raises:
            CaptureError: another rig is using one of them.
        """
        self._locks: list[FileLock] = []
        folder = Path(tempfile.gettempdir()) / f"mammometry-cameras-{getpass.getuser()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        for camera, device in ids.items():
            name = hashlib.sha256(f"{backend}\n{device}".encode()).hexdigest()[:24]
            lock, about = FileLock(folder / f"{name}.lock"), folder / f"{name}.txt"
            try:
                lock.acquire(timeout=0)
            except Timeout:
                self.release()
                holder = about.read_text(encoding="utf-8") if about.is_file() else "another program"
                raise CaptureError(
                    camera, found=f"a camera ({device}) that {holder} uses: two rigs on one bus",
                    expected="a camera of this rig alone",
                    remedy="Close the other rig's page or command, or correct the serial numbers in the rigs' files",
                ) from None  # fmt: skip
            about.write_text(f"rig {rig} as camera {camera}", encoding="utf-8")
            self._locks.append(lock)

    def release(self) -> None:
        """Release the locks."""
        for lock in self._locks:
            lock.release()
        self._locks.clear()


Opener: TypeAlias = Callable[[Devices], Backend]
BACKENDS: Registry[Opener] = Registry("back-end", package="mammometry.capture.backends")


def library(name: str) -> ModuleType:
    """Import a camera maker's library.

    Libraries made with SWIG warn on import, which would end the program if warnings are errors.

    Raises:
        ImportError: it is not installed.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return importlib.import_module(name)


def missing(backend: str, what: str, remedy: str) -> SettingsError:
    """Return the error for a back-end whose program or package is not installed."""
    return SettingsError(f"back-end {backend}", found=f"no {what}", expected="it installed", remedy=remedy)
