"""Interface of all kinds of cameras: pictures, states, settings."""

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
"""Whose time a picture carries: one clock shared by all cameras, this computer's when the picture came, each camera's
own as EXIF has it, or nobody's."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraSettings:
    """Exposure settings of all cameras. None leaves what the camera has."""

    exposure_ms: float | None = None
    """Length of the exposure; all cameras alike, so that the flash lies in all. None: as the cameras are set."""
    gain_db: float | None = None
    """Gain of the sensor; as low as the light allows, since it raises noise too. None: as the cameras are set."""
    trigger: Literal["wire", "software"] = "wire"
    """``wire``: a pulse from outside exposes all at once. ``software``: a command each, for tests and set-up."""

    def __post_init__(self) -> None:
        if self.exposure_ms is not None and not 0.01 <= self.exposure_ms <= 10_000:
            raise ValueError(f"exposure_ms must lie between 0.01 and 10000, found {self.exposure_ms:g}")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """One picture of one camera, as it was delivered."""

    camera: str
    content: bytes | Photograph
    """A whole JPEG, PNG or TIFF as the camera wrote it, or bare pixels."""
    taken_s: float | None = None
    """When it was exposed, seconds on its clock."""
    clock: Clock = "none"
    number: int | None = None
    """The camera's own count of its pictures."""
    serial: str = ""
    """Serial number of the body that took it, where it says."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Health:
    """State of one camera."""

    fault: str = ""
    """What is wrong, in a sentence. Empty where all is well."""
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
    """The cameras that a back-end is to open."""

    cameras: tuple[str, ...]
    """Names in the rig."""
    ids: Mapping[str, str]
    """Camera → serial number, address or port by which the back-end knows it. May lack cameras."""
    options: Mapping[str, Any]
    """The back-end's own options, from the rig's file."""


class Backend(Protocol):
    """All cameras of a rig, opened.

    A back-end is made from `Devices`; that opens the cameras. One camera's failure is a `CaptureError` of `fetch` or a
    fault of `health`, so that the others go on. `fetch` and `live` are called for several cameras at once.
    """

    def settings(self, wanted: CameraSettings) -> None:
        """Set all cameras.

        Raises:
            CaptureError: a camera refuses.
        """

    def arm(self) -> None:
        """Make all cameras wait for the pulse. What they took before is dropped."""

    def fire(self) -> float:
        """Expose. With a wire, somebody's button does.

        Returns:
            When, by ``time.time()``.
        """

    def fetch(self, camera: str, timeout_s: float) -> Frame:
        """The picture of the last fire.

        Raises:
            CaptureError: it did not come, or is spoilt.
        """

    def live(self, camera: str) -> Photograph:
        """A picture for the screen, small if the camera can.

        Raises:
            CaptureError: the camera gives none.
        """

    def health(self, camera: str) -> Health:
        """State of a camera."""

    def close(self) -> None:
        """Release the cameras."""


def failed(camera: str, found: str, remedy: str, *, expected: str = "one picture of this firing") -> CaptureError:
    """The error of one camera."""
    return CaptureError(camera, found=found, expected=expected, remedy=remedy)


class Holds:
    """The cameras that a rig holds. Until `release`, or the end of the process."""

    def __init__(self, rig: str, backend: str, ids: Mapping[str, str]) -> None:
        """Lock all cameras, or none.

        Args:
            rig: its name, for whoever wants the same camera.
            backend: kind of cameras.
            ids: camera → serial number, address or port.

        Raises:
            CaptureError: another rig holds one of them.
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
                    camera, found=f"a camera ({device}) that {holder} holds: two rigs on one bus",
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
    """Import a maker's library.

    Those that SWIG made warn when they are imported, and end the whole program where warnings are errors.

    Raises:
        ImportError: it is not installed.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return importlib.import_module(name)


def missing(backend: str, what: str, remedy: str) -> SettingsError:
    """The error of a back-end whose program or package is not installed."""
    return SettingsError(f"back-end {backend}", found=f"no {what}", expected="it installed", remedy=remedy)
