"""Pictures of each firing, written whole or not at all.

``SESSION/shots/001/`` holds what the first firing gave, with ``shot.json`` beside the pictures: also when a camera
failed, so that the others' pictures are kept. A firing that may be measured is then also ``SESSION/capture``, by links
to the same files. Pictures come in a hidden folder that is renamed at the end; ``capture`` is put in place of another
firing's by two renames, which the next firing completes if a power cut came between.
"""

from __future__ import annotations

import io
import json
import os
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tifffile
from PIL import Image

from mammometry.base.errors import SessionError
from mammometry.base.photograph import Photograph
from mammometry.capture.camera import Frame
from mammometry.io.durable import sync_folder, sync_tree, write_new
from mammometry.io.photographs.images import EXTENSIONS
from mammometry.io.write import disk_errors, file_digest

_SHOTS, _CAPTURE, _RECORD = "shots", "capture", "shot.json"
_TAKING, _NEW, _OLD, _POSE = ".taking", ".capture-new", ".capture-old", ".pose-new"
_NUMBER = re.compile(r"\d{3,}")
_QUALITY = 95  # of JPEGs made here: errors of 1 grey level, below the sensor's noise; as `simulate` writes them
_BEGIN = {b"\xff\xd8\xff": ".jpg", b"\x89PNG": ".png", b"II*\x00": ".tif", b"MM\x00*": ".tif"}


class Shot:
    """One firing that is being written."""

    def __init__(self, session: Path, *, suffix: str = "jpg") -> None:
        """Begin.

        Raises:
            StorageError: the disk is full or refuses.
        """
        self._session, self._suffix = session, suffix
        self.folder = session / _SHOTS / _TAKING
        with disk_errors(session):
            shutil.rmtree(self.folder, ignore_errors=True)  # of a firing that was killed
            self.folder.mkdir(parents=True)

    def keep(self, frame: Frame) -> Path:
        """Write one camera's picture and wait until it is on the disk.

        Raises:
            StorageError: the disk is full or refuses. Nothing of the picture stays.
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
        """Give the firing its number.

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
        """Remove what was written: nothing of it came."""
        shutil.rmtree(self.folder, ignore_errors=True)


def last_record(session: Path) -> dict[str, Any] | None:
    """What the last firing's shot.json says. None where there is none."""
    number = _last(session)
    path = session / _SHOTS / f"{number:03d}" / _RECORD
    try:
        table = json.loads(path.read_text(encoding="utf-8")) if number else None
    except (OSError, ValueError, RecursionError):
        return None
    return table if isinstance(table, dict) else None


def require_replaceable(session: Path) -> None:
    """Refuse a session whose photographs came from elsewhere.

    Raises:
        SessionError: a file in ``capture`` is no firing's.
    """
    _recover(session)
    taken = {file_digest(path) for path in _pictures(session / _SHOTS, "*/*")}
    for path in _pictures(session / _CAPTURE, "*"):
        if file_digest(path) not in taken:
            raise SessionError(
                f"{_CAPTURE}/{path.name}",
                found="a photograph that was not taken by this command",
                expected="an empty capture, or one that this command filled",
                remedy="Name a new session folder: nothing that is there is replaced",
            )


def add_pose(session: Path, shot: Path) -> str:
    """Make a firing the next pose of the session's calibration.

    Returns:
        The pose's name.

    Raises:
        StorageError: the disk is full or refuses; the poses are then as they were.
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
    """Make a firing the session's capture.

    Raises:
        StorageError: the disk is full or refuses; ``capture`` is then as it was.
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
        except OSError:  # a disk without links
            shutil.copy2(path, folder / path.name)
    sync_tree(folder)


def _recover(session: Path) -> None:
    """End what a power cut interrupted."""
    old, new, capture = session / _OLD, session / _NEW, session / _CAPTURE
    if old.is_dir() and not capture.exists():
        (new if new.is_dir() else old).rename(capture)
    shutil.rmtree(old, ignore_errors=True)
    shutil.rmtree(new, ignore_errors=True)


def _pictures(folder: Path, pattern: str) -> list[Path]:
    return [path for path in sorted(folder.glob(pattern)) if path.suffix.lower() in EXTENSIONS and path.is_file()]


def _last(session: Path) -> int:
    folder = session / _SHOTS
    names = [path.name for path in folder.iterdir()] if folder.is_dir() else []
    return max((int(name) for name in names if _NUMBER.fullmatch(name)), default=0)


def _encoded(content: bytes | Photograph, suffix: str) -> tuple[bytes, str]:
    """A picture's file and its ending. A camera's own file is kept as it is."""
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
