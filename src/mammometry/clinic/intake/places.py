"""Where photographs are stored: the record of each, and its path below the record's folder."""

import re
from pathlib import Path

from django.db.models import QuerySet

from mammometry.base.errors import MammometryError
from mammometry.clinic.models import Calibration, DailyCheck, Job, Rig, Upload, Visit
from mammometry.clinic.site import the_clinic

Target = Visit | Calibration | DailyCheck
_POSE = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,31}")


class UploadError(MammometryError):
    """An upload is refused.

    Args:
        sentence: the reason and the remedy.
        status: status of the HTTP response.
    """

    exit_code = 4
    code = "upload"

    def __init__(self, sentence: str, status: int = 409) -> None:
        Exception.__init__(self, sentence)
        self.status = status


def require_open(target: Target) -> None:
    """Refuse changes during a computation.

    Raises:
        UploadError: a job for the record is waiting or running.
    """
    if Job.objects.filter(**{field_of(target): target}, state__in=Job.OPEN).exists():
        raise UploadError("This is being measured. Wait until it is done, or cancel it first.")


def target_of(upload: Upload) -> Target:
    """The record that an upload belongs to."""
    target = upload.visit or upload.calibration or upload.check_of_day
    assert target is not None
    return target


def rig_of(target: Target) -> Rig:
    """The rig that takes the record's photographs.

    Raises:
        UploadError: the visit has a scan of another device or a telephone's photographs, and no cameras.
    """
    if target.rig is None:
        by_telephone = isinstance(target, Visit) and target.is_walk
        what = "photographs by a telephone" if by_telephone else "a scan of another device"
        raise UploadError(f"This visit has {what}. Start a new visit for photographs by a rig.")
    return target.rig


def folder_of(target: Target) -> Path:
    """Folder that contains a record's photographs."""
    return target.folder if isinstance(target, Visit) else the_clinic().folder / target.folder


def uploads_of(target: Target) -> QuerySet[Upload]:
    """Uploads of a record, the oldest first."""
    return Upload.objects.filter(**{field_of(target): target}).order_by("created")


def field_of(target: Target) -> str:
    """Name of the column, in uploads and jobs, that refers to a record of this kind."""
    return {Visit: "visit", Calibration: "calibration", DailyCheck: "check_of_day"}[type(target)]


def place_of(target: Target, pose: str, camera: str) -> str:
    """Path of a camera's photograph below its record's folder, without suffix.

    Raises:
        UploadError: a calibration's photograph without a valid pose.
    """
    if isinstance(target, Visit):
        return f"capture/{camera}"
    if isinstance(target, DailyCheck):
        return camera
    if not _POSE.fullmatch(pose):
        raise UploadError("Enter the pose: letters and digits, such as 01.", 400)
    return f"calibration/{pose}/{camera}"


def pose_of(upload: Upload) -> str:
    """Pose of a calibration's photograph. Empty for others."""
    parts = upload.name.split("/")
    return parts[1] if len(parts) == 3 else ""
