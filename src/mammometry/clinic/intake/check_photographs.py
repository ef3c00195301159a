"""Tests that a daily check's photograph is new: a new file, new pixels, a later time."""

import datetime
from collections.abc import Iterator

from django.db.models import QuerySet
from django.utils import timezone

from mammometry.capture.checks import Finding
from mammometry.clinic.models import DailyCheck, Upload

_REMEDY = "Photograph the board now with every camera, and send those photographs."
_ARRIVED = (Upload.State.PLACED, Upload.State.SET_ASIDE)


def known_photograph(upload: Upload, check: DailyCheck, pixels: str, taken_s: float | None) -> list[Finding]:
    """Refuse a photograph that was sent before, or that is older than the last one of its camera.

    Args:
        upload: its digest and, if known, its camera are set.
        check: the daily check.
        pixels: digest of its pixels.
        taken_s: time on its camera's own clock; None: unknown.
    """
    others = Upload.objects.filter(state__in=_ARRIVED).exclude(pk=upload.pk).exclude(check_of_day=check)
    others = others.select_related("calibration", "check_of_day", "visit").order_by("created")
    same_file = others.filter(sha256=upload.sha256)
    same_pixels = others.filter(visit=None, checks__0__pixels=pixels) if pixels else others.none()
    for known, what in ((same_file, "is"), (same_pixels, "has the same pixels as")):
        other = next((row for row in known if _counts(row, check)), None)
        if other is not None:
            return [Finding("known", "refuse", f"This photograph {what} {_described(other)}. {_REMEDY}")]
    return list(_age(upload, check, others, taken_s))


def _counts(other: Upload, check: DailyCheck) -> bool:
    """Whether an earlier use of a photograph excludes it from a check.

    A check that was never evaluated does not count. Nor does a check of the same day against another calibration: after
    calibrating again without a poor picture, nothing must be photographed again.
    """
    earlier = other.check_of_day
    if earlier is None:
        return True
    if not earlier.figures:
        return False
    same_day = timezone.localdate(earlier.taken_at) == timezone.localdate(check.taken_at)
    return earlier.calibration_id == check.calibration_id or not same_day


def _age(upload: Upload, check: DailyCheck, others: QuerySet[Upload], taken_s: float | None) -> Iterator[Finding]:
    """Refuse a photograph that is not newer than its camera's last one in the calibration and its checks."""
    if taken_s is None or not upload.camera or check.calibration is None:
        return
    of_camera = others.filter(camera=upload.camera)
    judged = of_camera.filter(check_of_day__calibration=check.calibration).exclude(check_of_day__figures={})
    rows = [*of_camera.filter(calibration=check.calibration), *judged]
    known = [(row.checks[0]["taken_s"], row) for row in rows if row.checks and row.checks[0].get("taken_s") is not None]
    newest_s, newest = max(known, key=lambda one: one[0], default=(None, None))
    if newest_s is None or newest is None or taken_s > newest_s:
        return
    yield Finding(
        "age",
        "refuse",
        f"By the camera's clock this photograph was taken on {_moment(taken_s)}, and {_described(newest)} on "
        f"{_moment(newest_s)}. {_REMEDY} If the camera's clock was set back, calibrate the rig again.",
    )


def _described(upload: Upload) -> str:
    """Where a photograph is used. Of a visit only the day: people who check rigs may not see patients."""
    camera = upload.camera.replace("_", " ")
    if upload.calibration is not None:
        pose = upload.name.split("/")[1]
        return f"the photograph of {camera} in pose {pose} of the calibration of {_day(upload.calibration.taken_at)}"
    if upload.check_of_day is not None:
        return f"the photograph of {camera} of the check of {_day(upload.check_of_day.taken_at, time=True)}"
    assert upload.visit is not None
    return f"a photograph of the visit of {_day(upload.visit.taken_at)}"


def _day(at: datetime.datetime, *, time: bool = False) -> str:
    local = timezone.localtime(at)
    return f"{local.day} {local:%b %Y}" + (f", {local:%H:%M}" if time else "")


def _moment(taken_s: float) -> str:
    """Time on the camera's own clock, whose zone is unknown."""
    at = datetime.datetime.fromtimestamp(taken_s, datetime.UTC)
    return f"{at.day} {at:%b %Y, %H:%M:%S}"
