"""Photographs that the rig's cameras took. They lie in the visit's folder already, and get their rows."""

from __future__ import annotations

from typing import Any

from django.db import transaction
from PIL import Image

from mammometry.capture.checks.found import Found
from mammometry.capture.loop import CaptureResult
from mammometry.capture.shots import last_record
from mammometry.clinic.intake import uploads
from mammometry.clinic.intake.set_aside import fired_files
from mammometry.clinic.intake.thumbnail import small_picture, thumbnail_path
from mammometry.clinic.models import Person, Upload, Visit
from mammometry.io.photographs.images import FORMATS


def take_in(visit: Visit, fired: CaptureResult, by: Person | None) -> None:
    """Enter an accepted firing as the visit's photographs.

    They take the place of an earlier firing's, which are set aside.

    Args:
        visit: whose session folder it was fired into.
        fired: accepted.
        by: who fired.
    """
    record: dict[str, Any] = last_record(visit.folder) or {}
    with transaction.atomic():
        names = fired_files(visit.folder)
        for old in visit.uploads.exclude(state=Upload.State.SET_ASIDE):
            if old.state == Upload.State.PLACED and old.sha256 in names:
                old.name, old.state = names[old.sha256], Upload.State.SET_ASIDE
                old.save()
            else:
                thumbnail_path(old).unlink(missing_ok=True)
                old.delete()
        for camera, about in record["cameras"].items():
            path = visit.folder / "capture" / about["file"]
            upload = Upload.objects.create(
                visit=visit,
                camera=camera,
                name=f"capture/{path.name}",
                size_bytes=path.stat().st_size,
                received_bytes=path.stat().st_size,
                sha256=about["sha256"],
                state=Upload.State.PLACED,
                checks=_checks(fired, camera, about),
                created_by=by,
            )
            with Image.open(path, formats=FORMATS) as picture:
                small_picture(picture, thumbnail_path(upload))
        uploads.note_ready(visit, changed=True)


def _checks(fired: CaptureResult, camera: str, about: dict[str, Any]) -> list[dict[str, Any]]:
    own = [finding for who, finding in fired.verdict.found if who == camera]
    fact = Found(check="camera", level="ok", sentence="Taken by the rig, from this page.")
    # Times are the verdict's matter, whose clocks are better than EXIF's.
    shared = {"serial": about["serial"], "taken_s": None, "named": None}
    return [{**finding.as_table(), **shared} for finding in (fact, *own)]
