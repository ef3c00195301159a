"""Check of the postures of two dates: volumes in different postures must not be compared."""

from __future__ import annotations

from collections.abc import Iterator

from mammometry.api.job import Job
from mammometry.base.errors import SessionError
from mammometry.base.notices import Notice


def check_posture(before: Job, after: Job) -> None:
    """Raise a SessionError if two dates have different postures."""
    if before.posture and after.posture and before.posture != after.posture:
        raise SessionError(
            f"{before.folder}, {after.folder}",
            found=f"the patient {before.posture} at one date and {after.posture} at the other",
            expected="one posture, because volumes in different postures must not be compared",
            remedy="Compare dates of one posture, or add --set compare.other_posture=true",
        )


def posture_warnings(before: Job, after: Job) -> Iterator[Notice]:
    """Yield a warning if the postures differ, or only one is known."""
    if before.posture != after.posture:
        earlier, later = (posture or "in a posture that was not given" for posture in (before.posture, after.posture))
        yield Notice(code="postures-differ", values={"before": earlier, "after": later})
