"""Assign photographs to other cameras: correct swapped ones, and change the user's choices."""

import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from django.db import transaction

from mammometry.capture import camera_checks
from mammometry.capture.checks import Finding
from mammometry.clinic.intake.photographs import known_cameras
from mammometry.clinic.intake.places import Target, UploadError, folder_of, place_of, pose_of, uploads_of
from mammometry.clinic.models import DailyCheck, Upload
from mammometry.io.photographs.images import read_header
from mammometry.io.photographs.tags import PhotographTags
from mammometry.io.write import disk_errors, sync_folder


def reassign(target: Target, sources: Mapping[str, str], why: str, pose: str = "") -> None:
    """Assign photographs to other cameras.

    Args:
        target: their visit, calibration or check.
        sources: camera → camera under which its photograph is stored now.
        why: new sentence for the photographs' checks.
        pose: pose, for a calibration.

    Raises:
        UploadError: a photograph is missing, is from another camera by its serial number, or differs in size from those
        of the calibration.
        StorageError: the disk is full or refuses.
    """
    folder = folder_of(target)
    with transaction.atomic():
        type(target)._default_manager.select_for_update().get(pk=target.pk)
        placed = uploads_of(target).filter(state=Upload.State.PLACED)
        rows = {row.camera: row for row in placed if pose_of(row) == pose}
        if not set(sources.values()) <= set(rows) or set(sources) & set(rows) - set(sources.values()):
            raise UploadError("The photographs have changed. Reload the page.")
        moves = {camera: rows[source] for camera, source in sources.items()}
        for camera, row in moves.items():
            _require_fitting(target, camera, row, folder)
        goals = {
            camera: folder / f"{place_of(target, pose, camera)}{Path(row.name).suffix}" for camera, row in moves.items()
        }
        _move_files({folder / moves[camera].name: goal for camera, goal in goals.items()})
        for camera, row in moves.items():
            row.camera, row.name = camera, goals[camera].relative_to(folder).as_posix()
            row.checks = _checks(row, why)
            row.save()


def _require_fitting(target: Target, camera: str, row: Upload, folder: Path) -> None:
    known = known_cameras(target)
    header = read_header(folder / row.name, "The photograph")
    serial = row.checks[0].get("serial", "") if row.checks else ""
    for finding in (
        camera_checks.right_camera(camera, PhotographTags(serial=serial), None, known),
        camera_checks.right_size(camera, header.stored_wh, header.orientation, known),
    ):
        if finding.level == "refuse":
            raise UploadError(finding.sentence)


def _checks(row: Upload, why: str) -> list[dict[str, Any]]:
    """A photograph's data, with a new reason for its camera."""
    others = [check for check in row.checks if check.get("check") not in ("camera", "name")]
    names = ("serial", "taken_s", "pixels", "file")
    facts = {name: row.checks[0].get(name) for name in names if row.checks and name in row.checks[0]}
    return [{**Finding("camera", "ok", why).as_table(), **facts, "named": None}, *others]


def _move_files(goals: Mapping[Path, Path]) -> None:
    """Swap files.

    Each file has a second name before the first one is replaced. After an interruption, one photograph may be stored
    twice, which is refused and reported.
    """
    parts = {goal: goal.with_name(f".{goal.name}.part") for goal in goals.values()}
    for source, goal in goals.items():
        with disk_errors(goal):
            parts[goal].unlink(missing_ok=True)
            try:
                os.link(source, parts[goal])
            except OSError:  # a disk without hard links
                shutil.copy2(source, parts[goal])
    for goal, part in parts.items():
        with disk_errors(goal):
            part.replace(goal)
            part.unlink(missing_ok=True)
    for source in goals:
        if source not in parts:
            source.unlink(missing_ok=True)
        sync_folder(source.parent)


def exchange_of_check(check: DailyCheck) -> list[tuple[Upload, Upload]]:
    """Present and correct photograph of each camera of a check whose photographs are swapped."""
    cameras = check.result.exchanged if check.result else ()
    placed = {row.camera: row for row in uploads_of(check).filter(state=Upload.State.PLACED)}
    if len(cameras) != 2 or not set(cameras) <= set(placed):
        return []
    one, other = (placed[name] for name in cameras)
    return [(one, other), (other, one)]


@transaction.atomic
def put_check_right(check: DailyCheck) -> None:
    """Swap back a check's photographs that were found swapped. It must then be evaluated again.

    Raises:
        UploadError: no photographs are swapped any more.
        StorageError: the disk is full or refuses.
    """
    locked = DailyCheck.objects.select_for_update().get(pk=check.pk)
    pairs = exchange_of_check(locked)
    if not pairs:
        raise UploadError("Nothing of this check is exchanged any more.")
    sources = {is_now.camera: belongs.camera for is_now, belongs in pairs}
    reassign(locked, sources, "By the calibration, this camera took it.")
    locked.figures, locked.verdict, locked.passed = {}, "", None
    locked.save(update_fields=["figures", "verdict", "passed"])
