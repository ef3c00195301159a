"""Changes by jobs to rows other than their own.

These are states of visits, calibrations, comparisons and deliveries, and measurements.

They are made in the transaction that changes the job's row.
"""

import datetime
from collections.abc import Mapping, Sequence
from typing import Any

from django.db.models import F
from django.utils import timezone

from mammometry.clinic.intake.walks import discard_prepared
from mammometry.clinic.models import Calibration, Comparison, DailyCheck, Delivery, Job, Measurement, Visit, Volume
from mammometry.clinic.records.comparing import measured_digests, refusal_of
from mammometry.clinic.records.confirmations import settled_state
from mammometry.clinic.records.results import add_volumes
from mammometry.clinic.rig_results import CheckResult

Target = Visit | Calibration | DailyCheck | Comparison
"""Records that computations belong to."""

_VERDICTS = {
    "unmoved": "No camera has moved.",
    "moved": "A camera moved, too little to matter.",
    "refuse": "A camera moved. Calibrate the rig again before measuring.",
}
_LONGEST = 500  # characters of a verdict


def queued(target: Target | Delivery) -> None:
    """Mark a job's target as waiting."""
    if isinstance(target, Visit):
        target.state = Visit.State.QUEUED
        target.save(update_fields=["state"])
    elif isinstance(target, Calibration):
        target.state = Calibration.State.QUEUED
        target.save(update_fields=["state"])
    elif isinstance(target, Comparison):
        target.state = Comparison.State.QUEUED
        target.save(update_fields=["state"])
    elif isinstance(target, Delivery):
        Delivery.objects.filter(pk=target.pk).update(state=Delivery.State.QUEUED, message="", ended=None)


def begun(target: Target | Delivery | None) -> None:
    """Mark a job's target as running."""
    if isinstance(target, Calibration):
        target.state = Calibration.State.RUNNING
        target.save(update_fields=["state"])
    elif isinstance(target, Comparison):
        target.of = measured_digests(target.before, target.after)
        target.save(update_fields=["of"])


def cancelled(target: Target) -> None:
    """Reset the target of a cancelled job."""
    if isinstance(target, Visit):
        discard_prepared(target)
        target.state = settled_state(target)
        target.save(update_fields=["state"])
    elif isinstance(target, Calibration):
        target.state = Calibration.State.UPLOADING
        target.save(update_fields=["state"])
    elif isinstance(target, Comparison):
        _refuse(target, measured_digests(target.before, target.after), "The comparison was cancelled.")


def failed(target: Target | Delivery | None, message: str) -> None:
    """Record at a job's target that the job failed for good, and why."""
    if isinstance(target, Visit):
        discard_prepared(target)
        target.state = Visit.State.CHANGED if target.has_unmeasured_drawing else Visit.State.REFUSED
        target.save(update_fields=["state"])
    elif isinstance(target, Calibration):
        target.state, target.verdict = Calibration.State.FAILED, message[:_LONGEST]
        target.save(update_fields=["state", "verdict"])
    elif isinstance(target, Comparison):
        _refuse(target, target.of, message)
    elif isinstance(target, Delivery):
        now = timezone.now()
        Delivery.objects.filter(pk=target.pk).update(state=Delivery.State.FAILED, message=message[:1500], ended=now)
    elif isinstance(target, DailyCheck):
        target.verdict, target.passed = message[:_LONGEST], None
        target.save(update_fields=["verdict", "passed"])


def enter(job: Job, answer: Mapping[str, Any]) -> None:
    """Store the result of a job."""
    if job.visit is not None:
        discard_prepared(job.visit)
        _measured(job, job.visit, answer)
    elif job.calibration is not None:
        _calibrated(job.calibration, answer["figures"])
    elif job.check_of_day is not None:
        _checked(job.check_of_day, answer["figures"])
    elif job.comparison is not None:
        _compared(job.comparison, answer)
    elif job.delivery is not None:
        ended = {"state": Delivery.State.SENT, "ended": timezone.now(), "sent": F("sent") + answer["sent"]}
        Delivery.objects.filter(pk=job.delivery.pk).update(**ended, kept=answer["kept"], message=answer["message"])


def _compared(comparison: Comparison, answer: Mapping[str, Any]) -> None:
    comparison.of, comparison.table = answer["of"], dict(answer["table"])
    comparison.state, comparison.message, comparison.made_at = Comparison.State.DONE, "", timezone.now()
    comparison.save()


def _refuse(comparison: Comparison, digests: str, message: str) -> None:
    comparison.state, comparison.message, comparison.made_at = Comparison.State.REFUSED, message[:1500], timezone.now()
    comparison.of = refusal_of(digests)
    comparison.save()


def _measured(job: Job, visit: Visit, answer: Mapping[str, Any]) -> None:
    """Add a measurement, unless the visit's newest one is equal, whose confirmation then stays valid."""
    Visit.objects.select_for_update().get(pk=visit.pk)  # waits for a drawing that is being saved, or makes it wait
    newest = visit.measurements.order_by("-made_at").first()
    if newest is None or newest.digest != answer["digest"]:
        made_at = datetime.datetime.fromisoformat(answer["made_at"]) if answer.get("made_at") else timezone.now()
        measurement = Measurement.objects.create(
            visit=visit, job=job, digest=answer["digest"], made_at=made_at, software=answer["software"],
            curves=answer.get("curves", {}), how=answer.get("how", {}), quantities=answer.get("quantities", []),
        )  # fmt: skip
        add_volumes(measurement, [Volume(**row) for row in answer["volumes"]])
    elif not newest.how and answer.get("how"):  # from a version that did not record it
        newest.how = answer["how"]
        newest.save(update_fields=["how"])
    visit.state = settled_state(visit)
    visit.save(update_fields=["state"])


def _calibrated(calibration: Calibration, figures: Mapping[str, Any]) -> None:
    """Make it the rig's current calibration, unless a later one is."""
    calibration.figures = dict(figures)
    calibration.state = Calibration.State.DONE
    result = calibration.result
    words = "May be used, but check it. " if result.verdict == "warn" else "May be used. "
    calibration.verdict = f"{words}{_first_sentence(result.reasons)}".strip()[:_LONGEST]
    earlier = Calibration.objects.filter(rig=calibration.rig, current=True).exclude(pk=calibration.pk)
    if not earlier.filter(taken_at__gt=calibration.taken_at).exists():
        earlier.update(current=False)
        calibration.current = True
    calibration.save(update_fields=["figures", "state", "verdict", "current"])


def _checked(check: DailyCheck, figures: Mapping[str, Any]) -> None:
    check.figures = dict(figures)
    result = CheckResult.from_table(figures)
    unseen = result.unseen
    words = f"{_VERDICTS.get(result.verdict, result.verdict)} {_first_sentence(result.reasons)}".strip()
    if exchanged := [name.replace("_", " ") for name in result.exchanged]:
        words = f"The photographs of {' and '.join(exchanged)} are exchanged: correct them, and check again."
    elif unseen:
        which = f"Camera {unseen[0]}" if len(unseen) == 1 else f"Cameras {', '.join(unseen)}"
        words = f"{which} did not see the board: photograph it again, where every camera sees it. {words}"
    check.verdict = words[:_LONGEST]
    check.passed = result.verdict != "refuse" and not unseen
    check.save(update_fields=["figures", "verdict", "passed"])


def _first_sentence(reasons: Sequence[str]) -> str:
    """The first reason as a complete sentence."""
    reason = next(iter(reasons), "")
    return f"{reason[0].upper()}{reason[1:].rstrip('.')}." if reason else ""
