"""Photographs that are set aside.

An original that was measured, or could have been, is never deleted: it goes to ``set-aside/`` beside ``capture/`` and
can come back. A firing's pictures lie in ``shots/`` anyhow.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Sequence
from pathlib import Path

from mammometry.clinic.intake.thumbnail import thumbnail_path
from mammometry.clinic.models import Upload
from mammometry.io.durable import sync_folder
from mammometry.io.write import disk_errors

FOLDER = "set-aside"


def set_aside(upload: Upload, folder: Path, *, kept_name: str = "") -> None:
    """Move a placed photograph beside the others, under a name that no other file ever has.

    Args:
        upload: placed.
        folder: the visit's, calibration's or check's.
        kept_name: file that the next photograph is about to take the place of, which is left to it.

    Raises:
        StorageError: the disk is full or refuses.
    """
    place = Path(upload.name)
    pose = [place.parts[1]] if len(place.parts) == 3 else []
    name = Path(FOLDER, *pose, f"{place.stem}-{upload.pk.hex}{place.suffix}")
    if not (folder / name).exists():
        _copy(folder / place, folder / name)
    upload.name, upload.state = name.as_posix(), Upload.State.SET_ASIDE
    upload.save()
    if place.name != kept_name:
        (folder / place).unlink(missing_ok=True)


def clear_place(others: Sequence[Upload], upload: Upload, folder: Path, goal: Path) -> bool:
    """Set aside the photograph in a place, and forget uploads that never came there.

    Args:
        others: the place's uploads, but for this one.
        upload: what comes into the place.
        folder: the visit's, calibration's or check's.
        goal: the file that it becomes.

    Returns:
        Whether the place held another photograph, or none.

    Raises:
        StorageError: the disk is full or refuses.
    """
    changed = True
    for other in others:
        if other.state == Upload.State.PLACED and other.sha256 != upload.sha256:
            set_aside(other, folder, kept_name=goal.name)
            continue
        changed = changed and other.state != Upload.State.PLACED
        thumbnail_path(other).unlink(missing_ok=True)
        other.delete()
    for path in goal.parent.glob(f"{upload.camera}.*"):
        if path != goal:
            path.unlink()
    return changed


def fired_files(folder: Path) -> dict[str, str]:
    """Digest → name below the visit's folder of every picture that was fired, where it lies for good."""
    names: dict[str, str] = {}
    for path in sorted((folder / "shots").glob("[0-9]*/shot.json")):
        try:
            cameras = json.loads(path.read_text(encoding="utf-8"))["cameras"]
            names |= {about["sha256"]: f"shots/{path.parent.name}/{about['file']}" for about in cameras.values()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            continue  # of a firing that failed
    return names


def put_back(upload: Upload, folder: Path, goal: Path) -> None:
    """Put the file of a photograph that was set aside into its place.

    It stays where it was set aside until its row says that it is back.

    Raises:
        StorageError: the disk is full or refuses.
    """
    _copy(folder / upload.name, goal)


def _copy(source: Path, goal: Path) -> None:
    """Link a file, or copy it where the disk has no links, whole or not at all."""
    with disk_errors(goal):
        goal.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        part = goal.with_name(f".{goal.name}.part")
        part.unlink(missing_ok=True)
        try:
            os.link(source, part)
        except OSError:
            shutil.copy2(source, part)
        part.replace(goal)
        part.unlink(missing_ok=True)  # where both were links to one file already
        sync_folder(goal.parent)
