"""A folder into which other software writes photographs.

Tethering programs write each camera's photographs into a folder. Only a complete set is accepted: one new file from
every camera, identified by name or serial number, whose EXIF times show a single exposure.
"""

import threading
import time
from dataclasses import dataclass
from pathlib import Path

from mammometry.base.errors import MammometryError, SettingsError
from mammometry.base.listing import visible
from mammometry.base.photograph import Photograph
from mammometry.capture.camera import BACKENDS, CameraSettings, Clock, Devices, Frame, Health, failed
from mammometry.capture.camera_checks import camera_of_name
from mammometry.io.photographs.images import EXTENSIONS, UNREAD_ENDINGS, read_header, read_photograph
from mammometry.io.photographs.tags import read_exposure

_TOGETHER_S = 20.0
"""Largest difference of EXIF times within a set. Unsynchronised clocks differ by seconds; `capture.checks` has the same
limit."""
_LOOK_S = 0.05  # time between two checks of the folder
_STILL_S = 0.2  # a file that has not grown for this long is complete


@dataclass(frozen=True, slots=True, kw_only=True)
class _File:
    path: Path
    camera: str
    taken_s: float | None
    serial: str


@BACKENDS.add("folder")
class WatchedFolder:
    """Photographs that other software writes into a folder. Options: ``path``, ``together_s``."""

    def __init__(self, devices: Devices) -> None:
        self._folder = Path(str(devices.options.get("path", "")))
        if not devices.options.get("path") or not self._folder.is_dir():
            raise SettingsError(
                "[capture.options] path",
                found=str(devices.options.get("path") or "nothing"),
                expected="the folder where the other software writes",
                remedy="Make the folder, and let the tethering program write there",
            )
        self._together_s = float(devices.options.get("together_s", _TOGETHER_S))
        self._cameras, self._ids = devices.cameras, devices.ids
        self._by_serial = {serial: name for name, serial in devices.ids.items()}
        self._known: dict[Path, tuple[int, int]] = {}
        self._sizes: dict[Path, tuple[int, float]] = {}
        self._read: dict[tuple[Path, int], _File | None] = {}
        self._taken: dict[str, _File] | None = None
        self._lock = threading.Lock()

    def settings(self, wanted: CameraSettings) -> None:
        """Do nothing: exposure is set in the other software."""

    def arm(self) -> None:
        """Treat all files that are in the folder now as old."""
        with self._lock:
            self._known = {path: _stamp(path) for path in self._files()}
            self._taken = None

    def fire(self) -> float:
        """Do nothing: the user starts the exposure in the other software."""
        return time.time()

    def fetch(self, camera: str, timeout_s: float) -> Frame:
        """Return this camera's file in the first complete set."""
        end = time.monotonic() + timeout_s
        while True:
            with self._lock:
                chosen = self._complete()
                if chosen is None and time.monotonic() >= end:
                    chosen = self._best()
            if chosen is not None or time.monotonic() >= end:
                break
            time.sleep(_LOOK_S)
        file = (chosen or {}).get(camera)
        if file is None:
            found = f"no new photograph in {self._folder.name} within {timeout_s:g} s"
            if unread := self._unread(camera):
                raise failed(
                    camera, f"{found}, but {unread}", "Set camera or program to write JPEG, with the raw or alone"
                )
            remedy = f"Check that the tethering program received it; its name must contain {camera}"
            raise failed(camera, found, remedy)
        clock: Clock = "none" if file.taken_s is None else "exif"
        return Frame(
            camera=camera, content=file.path.read_bytes(), taken_s=file.taken_s, clock=clock, serial=file.serial
        )  # fmt: skip

    def live(self, camera: str) -> Photograph:
        """Return the newest photograph of the camera."""
        mine = [file for file in self._all() if file.camera == camera]
        if not mine:
            raise failed(camera, "no photograph yet", "Take one with the tethering program")
        return read_photograph(max(mine, key=lambda arrival: arrival.path.stat().st_mtime_ns).path, camera)

    def health(self, camera: str) -> Health:
        """Report whether the folder exists."""
        fault = "" if self._folder.is_dir() else f"The folder {self._folder.name} no longer exists."
        return Health(fault=fault, model="a watched folder", serial=self._ids.get(camera, ""))

    def close(self) -> None:
        """Do nothing: a folder need not be released."""

    def _files(self) -> list[Path]:
        try:
            return sorted(
                path for path in visible(self._folder) if path.suffix.lower() in EXTENSIONS and path.is_file()
            )
        except OSError:
            return []

    def _unread(self, camera: str) -> str:
        """Name of a camera's picture in an unsupported format, such as NEF. Empty if there is none."""
        names = [path.name for path in visible(self._folder) if path.suffix.lower() in UNREAD_ENDINGS]
        return next((name for name in names if camera_of_name(name, self._cameras) == camera), "")

    def _all(self) -> list[_File]:
        """Complete files of known cameras."""
        files = []
        for path in self._files():
            try:
                stamp = _stamp(path)
                if self._known.get(path) == stamp or not self._is_still(path, stamp[0]):
                    continue
                key = (path, stamp[1])
                if key not in self._read:
                    self._read[key] = self._about(path)
                files.append(self._read[key])
            except OSError:
                continue  # it was removed in the meantime
        return [name for name in files if name is not None]

    def _about(self, path: Path) -> _File | None:
        exposure = read_exposure(path)
        camera = self._by_serial.get(exposure.serial) or camera_of_name(path.name, self._cameras)
        return None if camera is None else _File(
            path=path, camera=camera, taken_s=exposure.taken_s, serial=exposure.serial
        )  # fmt: skip

    def _is_still(self, path: Path, size: int) -> bool:
        now = time.monotonic()
        if self._sizes.get(path, (-1, 0.0))[0] != size:
            self._sizes[path] = (size, now)
            return False
        if now - self._sizes[path][1] < _STILL_S:
            return False
        try:
            read_header(path, path.name)
        except MammometryError:
            return False
        return True

    def _complete(self) -> dict[str, _File] | None:
        """The earliest complete set, which is kept until the next `arm`."""
        if self._taken is None:
            best = self._best()
            self._taken = best if len(best) == len(self._cameras) else None
        return self._taken

    def _best(self) -> dict[str, _File]:
        """The set of one exposure with most cameras, and of several the earliest."""
        files = self._all()
        best: dict[str, _File] = {}
        for anchor in sorted(files, key=_when):
            chosen: dict[str, _File] = {}
            for file in sorted(files, key=lambda arrival: abs(_when(arrival) - _when(anchor))):
                if abs(_when(file) - _when(anchor)) <= self._together_s:
                    chosen.setdefault(file.camera, file)
            if len(chosen) > len(best):
                best = chosen
        return best


def _when(file: _File) -> float:
    return file.path.stat().st_mtime if file.taken_s is None else file.taken_s


def _stamp(path: Path) -> tuple[int, int]:
    status = path.stat()
    return status.st_size, status.st_mtime_ns
