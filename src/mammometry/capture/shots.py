"""Expose all cameras once, and write their pictures atomically."""

import io
import json
import os
import re
import shutil
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tifffile
from PIL import Image

from mammometry.base.errors import CaptureError, MammometryError, SessionError
from mammometry.base.listing import is_hidden
from mammometry.base.photograph import Photograph
from mammometry.base.value import value
from mammometry.calibration.features.keypoints import Keypoints, keypoints
from mammometry.capture.camera import Backend, Frame
from mammometry.capture.checks import QUICK_PX, Seen, look
from mammometry.io.photographs.images import EXTENSIONS, read_photograph
from mammometry.io.write import disk_errors, file_digest, sync_folder, sync_tree, write_new

_SHOTS, _CAPTURE, _RECORD = "shots", "capture", "shot.json"
_TAKING, _NEW, _OLD, _POSE = ".taking", ".capture-new", ".capture-old", ".pose-new"
_NUMBER = re.compile(r"\d{3,}")
_QUALITY = 95  # quality of JPEGs written here: errors of 1 grey level, below the sensor's noise; as in `simulate`
_BEGIN = {b"\xff\xd8\xff": ".jpg", b"\x89PNG": ".png", b"II*\x00": ".tif", b"MM\x00*": ".tif"}


class PendingShot:
    """A capture while it is being written."""

    def __init__(self, session: Path, *, suffix: str = "jpg") -> None:
        """Create the folder of a capture.

        Raises:
            StorageError: the disk is full or refuses.
        """
        self._session, self._suffix = session, suffix
        self.folder = session / _SHOTS / _TAKING
        with disk_errors(session):
            shutil.rmtree(self.folder, ignore_errors=True)  # left by a capture that was killed
            self.folder.mkdir(parents=True)

    def keep(self, frame: Frame) -> Path:
        """Write one camera's picture and wait until it is on the disk.

        Raises:
            StorageError: the disk is full or refuses. Nothing of the picture remains.
        """
        data, suffix = _encoded(frame.content, self._suffix)
        path = self.folder / f"{frame.camera}{suffix}"
        with disk_errors(path):
            try:
                write_new(path, data)
            except OSError:
                path.unlink(missing_ok=True)
                raise
        return path

    def finish(self, record: Mapping[str, Any]) -> Path:
        """Give the capture its number.

        Raises:
            StorageError: the disk is full or refuses.
        """
        with disk_errors(self.folder):
            write_new(self.folder / _RECORD, (json.dumps(record, indent=1) + "\n").encode())
            sync_folder(self.folder)
            done = self._session / _SHOTS / f"{_last(self._session) + 1:03d}"
            self.folder.rename(done)
            sync_folder(done.parent)
        return done

    def drop(self) -> None:
        """Remove the folder, because no picture was delivered."""
        shutil.rmtree(self.folder, ignore_errors=True)


def last_record(session: Path) -> dict[str, Any] | None:
    """Content of shot.json of the last capture. None if there is none."""
    number = _last(session)
    path = session / _SHOTS / f"{number:03d}" / _RECORD
    try:
        table = json.loads(path.read_text(encoding="utf-8")) if number else None
    except (OSError, ValueError, RecursionError):
        return None
    return table if isinstance(table, dict) else None


def require_replaceable(session: Path) -> None:
    """Refuse a session whose photographs are from another source.

    Raises:
        SessionError: a file in ``capture`` is not from one of our captures.
    """
    _recover(session)
    taken = {file_digest(path) for path in _pictures(session / _SHOTS, "*/*")}
    for path in _pictures(session / _CAPTURE, "*"):
        if file_digest(path) not in taken:
            raise SessionError(
                f"{_CAPTURE}/{path.name}",
                found="a photograph that was not taken by this command",
                expected="an empty capture, or one from this command",
                remedy="Name a new session folder: existing photographs are not replaced",
            )


def add_pose(session: Path, shot: Path) -> str:
    """Use a capture as the next pose of the session's calibration.

    Returns:
        Name of the pose.

    Raises:
        StorageError: the disk is full or refuses; the poses are then unchanged.
    """
    folder = session / "calibration"
    with disk_errors(folder):
        new = folder / _POSE
        shutil.rmtree(new, ignore_errors=True)
        new.mkdir(parents=True)
        _link(shot, new)
        taken = [int(path.name) for path in folder.iterdir() if path.name.isdecimal()]
        name = f"{max(taken, default=-1) + 1:02d}"
        new.rename(folder / name)
        sync_folder(folder)
    return name


def accept(session: Path, shot: Path) -> None:
    """Use a capture as the session's capture.

    Raises:
        StorageError: the disk is full or refuses; ``capture`` is then unchanged.
    """
    with disk_errors(session):
        _recover(session)
        new = session / _NEW
        shutil.rmtree(new, ignore_errors=True)
        new.mkdir()
        _link(shot, new)
        if (session / _CAPTURE).is_dir():
            (session / _CAPTURE).rename(session / _OLD)
        new.rename(session / _CAPTURE)
        sync_folder(session)
        shutil.rmtree(session / _OLD, ignore_errors=True)


def _link(shot: Path, folder: Path) -> None:
    for path in _pictures(shot, "*"):
        try:
            os.link(path, folder / path.name)
        except OSError:  # a disk without hard links
            shutil.copy2(path, folder / path.name)
    sync_tree(folder)


def _recover(session: Path) -> None:
    """Finish a replacement that a power failure interrupted."""
    old, new, capture = session / _OLD, session / _NEW, session / _CAPTURE
    if old.is_dir() and not capture.exists():
        (new if new.is_dir() else old).rename(capture)
    shutil.rmtree(old, ignore_errors=True)
    shutil.rmtree(new, ignore_errors=True)


def _pictures(folder: Path, pattern: str) -> list[Path]:
    found = (path for path in sorted(folder.glob(pattern)) if not is_hidden(path.name))
    return [path for path in found if path.suffix.lower() in EXTENSIONS and path.is_file()]


def _last(session: Path) -> int:
    folder = session / _SHOTS
    names = [path.name for path in folder.iterdir()] if folder.is_dir() else []
    return max((int(name) for name in names if _NUMBER.fullmatch(name)), default=0)


def _encoded(content: bytes | Photograph, suffix: str) -> tuple[bytes, str]:
    """File of a picture, and its suffix. A camera's own file is kept unchanged."""
    if isinstance(content, bytes):
        return content, next((end for begin, end in _BEGIN.items() if content.startswith(begin)), ".bin")
    file = io.BytesIO()
    if suffix == "tif":
        tifffile.imwrite(file, content.pixels, metadata=None)
    elif suffix == "png":
        Image.fromarray(content.pixels).save(file, format="PNG", compress_level=1)
    else:
        pixels = content.pixels if content.pixels.dtype == "uint8" else (content.pixels >> 8).astype("uint8")
        Image.fromarray(pixels).save(file, format="JPEG", quality=_QUALITY, subsampling=0)
    return file.getvalue(), f".{suffix}"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Delivered:
    """One camera's picture on the disk, and its figures."""

    path: Path
    size_wh: tuple[int, int]
    sha256: str
    taken_s: float | None
    clock: str
    number: int | None
    serial: str
    seen: Seen
    features: Keypoints | None
    """None without a calibration to compare with."""
    seconds: float
    """Time from the pulse until the picture is on the disk."""


@value(eq=False)
class Firing:
    """The pictures of all cameras from one exposure, and failures."""

    fired_s: float
    """Time of the exposure (``time.time()``)."""
    frames: Mapping[str, Delivered]
    """Camera → its picture. Read-only."""
    faults: Mapping[str, MammometryError]
    """Camera → its failure. Read-only."""
    seconds: float
    """Time from the pulse until all pictures are on the disk and analysed."""


def take(
    backend: Backend, cameras: tuple[str, ...], shot: PendingShot, *, timeout_s: float, features: bool = True
) -> Firing:
    """Arm and expose all cameras, and fetch their pictures.

    If one camera or its file fails, the pictures of the others are still written.

    Args:
        backend: the open cameras.
        cameras: names of the rig's cameras.
        shot: folder for the pictures.
        timeout_s: time limit for one picture, from the pulse until it is on this computer.
        features: whether to find the features by which pairs are compared.
    """
    backend.arm()
    fired_s = backend.fire()
    begun = time.monotonic()

    def one(camera: str) -> Delivered | MammometryError:
        try:
            frame = backend.fetch(camera, timeout_s)
            path = shot.keep(frame)
            seconds = time.monotonic() - begun
            return _looked_at(frame, path, seconds, features)
        except MammometryError as error:
            return error

    # Waiting for a slow camera blocks its thread but must not delay the others.
    with ThreadPoolExecutor(max(1, len(cameras))) as pool:
        got = dict(zip(cameras, pool.map(one, cameras), strict=True))
    return Firing(
        fired_s=fired_s,
        frames={name: outcome for name, outcome in got.items() if isinstance(outcome, Delivered)},
        faults={name: outcome for name, outcome in got.items() if isinstance(outcome, MammometryError)},
        seconds=time.monotonic() - begun,
    )


def _looked_at(frame: Frame, path: Path, seconds: float, features: bool) -> Delivered:
    photograph = frame.content
    if isinstance(photograph, bytes):
        try:
            photograph = read_photograph(path, frame.camera)
        except MammometryError as error:
            path.unlink(missing_ok=True)
            raise CaptureError(
                frame.camera, found=error.found, expected="a complete photograph", remedy="Fire again; change the cable"
            ) from None
    return Delivered(
        path=path,
        size_wh=photograph.size_wh,
        sha256=file_digest(path),
        taken_s=frame.taken_s,
        clock=frame.clock,
        number=frame.number,
        serial=frame.serial,
        seen=look(photograph, looked_at_px=QUICK_PX),
        features=keypoints(photograph) if features else None,
        seconds=seconds,
    )
