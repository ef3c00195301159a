"""One video of a walk, instead of photographs. It is kept and deleted like photographs (`walks`)."""

from __future__ import annotations

from typing import Any

from mammometry.base.child_process import CallError
from mammometry.base.errors import ImageError
from mammometry.base.limited_call import limited_call
from mammometry.base.parse import LimitSettings
from mammometry.calibration.targets.table import target_from_table
from mammometry.capture.checks import Finding
from mammometry.clinic.intake.photographs import write_thumbnail
from mammometry.clinic.intake.places import UploadError, uploads_of
from mammometry.clinic.models import Upload, Visit
from mammometry.clinic.site import the_clinic
from mammometry.io.photographs.video_look import look_at_video
from mammometry.walk.region import TELEPHONE_BOARD

_NAME = "The video"
_LONGEST_S = 120.0  # three frames of a 4K video take 18 s on a machine with eight busy processes on two cores
_MOST_BYTES = 8 << 30  # address space; a 4K video takes 0.4 GB of memory


def is_of_video(upload: Upload) -> bool:
    """Whether an upload was announced as a video, or has arrived and is one."""
    return bool(upload.checks and upload.checks[0].get("video"))


def require_one_kind(visit: Visit, upload: Upload | None, *, is_video: bool) -> None:
    """Refuse a video next to other files, and a photograph next to a video.

    Args:
        visit: a visit with a telephone.
        upload: the new one, if it has a row.
        is_video: whether it is a video.

    Raises:
        UploadError: the visit has other files already.
    """
    others = uploads_of(visit).filter(state__in=(Upload.State.RECEIVING, Upload.State.PLACED))
    rows = [row for row in others if upload is None or row.pk != upload.pk]
    if any(is_of_video(row) for row in rows):
        words = "another video" if is_video else "photographs"
        raise UploadError(f"There is a video already. Take it away before you send {words}.")
    if is_video and rows:
        many = "is a photograph" if len(rows) == 1 else f"are {len(rows)} photographs"
        raise UploadError(f"There {many} already. Take all of them away before you send a video.")


def look_at_sent_video(upload: Upload) -> tuple[list[Finding], dict[str, Any]]:
    """Checks of a video that has arrived, and the stored data of its file.

    It is decoded in a child process, because a damaged file may crash the decoder.
    """
    limits = LimitSettings(megapixels=float(the_clinic().limits.photograph_megapixels))
    arguments = (upload.path, _NAME, target_from_table(TELEPHONE_BOARD), limits)
    try:
        seen = limited_call(look_at_video, arguments, longest_s=_LONGEST_S, most_bytes=_MOST_BYTES)
    except ImageError as error:
        return [Finding("format", "refuse", str(error))], {}
    except CallError:
        sentence = "The video cannot be decoded. Send the telephone's original file again."
        return [Finding("format", "refuse", sentence)], {}
    width, height = seen.size_wh
    length = f" of {seen.seconds:.0f} s" if seen.seconds else ""
    findings = [Finding("format", "ok", f"A video{length}, {width} × {height} pixels.")]
    if seen.with_board:
        findings.append(
            Finding("board", "ok", f"The board is in {seen.with_board} of {seen.looked_at} frames that were checked.")
        )
    else:
        sentence = f"The board is in none of {seen.looked_at} frames that were checked. Was it in view, and in focus?"
        findings.append(Finding("board", "warn", sentence))
    write_thumbnail(upload, seen.frame)
    return findings, {"video": True, "seconds": round(seen.seconds, 1)}
