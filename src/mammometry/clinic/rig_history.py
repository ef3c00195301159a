"""A rig's calibrations and checks from the database, and whether the rig may be used today."""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias

from django.db.models import Min
from django.utils import timezone

from mammometry.api.acceptance import device_tests
from mammometry.capture.sessions import make_session, manifest_text
from mammometry.clinic.models import Calibration, Comparison, DailyCheck, Job, Rig, Upload, Visit
from mammometry.clinic.rig_results import CheckResult
from mammometry.clinic.site import the_clinic
from mammometry.io.drift import DriftEntry
from mammometry.study.acceptance.tables import PastTest

Answer: TypeAlias = Literal["yes", "care", "no"]
_OLD_DAYS = 90
"""Age in days above which a calibration is reported as old: screws settle and rooms change. Not measured; the daily
check finds moved cameras."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Today:
    """Whether a rig is ready today."""

    verdict: Answer
    """``care``: the rig may be used, but the reasons should be read."""
    sentence: str
    reasons: tuple[str, ...] = ()
    remedy: str = ""
    """What to do first. Empty if nothing."""

    def as_table(self) -> dict[str, Any]:
        """The verdict as JSON."""
        return {
            "verdict": self.verdict, "sentence": self.sentence, "reasons": list(self.reasons), "remedy": self.remedy,
        }  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibrated:
    """The calibration in use."""

    on: datetime.date
    verdict: str | None
    """``pass`` or ``warn``. None for cameras that were calibrated elsewhere."""
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class LatestCheck:
    """The newest daily check against that calibration."""

    on: datetime.date
    result: CheckResult | None
    """None: not evaluated yet."""


def judge(day: datetime.date, calibrated: Calibrated | None, checked: LatestCheck | None) -> Today:
    """Decide whether a rig may be used today.

    Args:
        day: today in the clinic's time zone.
        calibrated: the calibration in use; None if there is none.
        checked: the newest check against it; None if there is none.
    """
    if calibrated is None:
        return Today(
            verdict="no",
            sentence="No: this rig is not calibrated.",
            remedy="Photograph the board in several poses and calibrate.",
        )
    result = None if checked is None else checked.result
    if result is not None and result.exchanged:
        return Today(
            verdict="no",
            sentence="No: photographs of the last check are exchanged.",
            remedy="Open the check and press “Put them right”, or check again.",
        )
    if result is not None and result.verdict == "refuse":
        return Today(
            verdict="no",
            sentence="No: a camera has moved since the calibration.",
            reasons=result.reasons,
            remedy="Calibrate the rig again. If the board was bent or not still, repeat the check first.",
        )
    reasons: list[str] = []
    remedy = "Calibrate the rig again when there is time."
    fresh = calibrated.on == day  # a calibration also serves as the check of its day
    if not fresh and (checked is None or checked.on != day or result is None):
        last = "was never checked" if checked is None else f"was last checked on {checked.on.isoformat()}"
        if checked is not None and result is None:
            last = "has a check that has not been evaluated yet"
        return Today(
            verdict="care",
            sentence="Not checked today.",
            reasons=(f"The rig {last}. A camera may have been touched since.",),
            remedy="Take one photograph of the board with every camera.",
        )
    if result is not None and result.verdict == "moved":
        reasons.append(f"A camera moved a little: measured points are off by {result.effect_mm:.2f} mm.")
        reasons += result.reasons
    if calibrated.verdict == "warn":
        reasons += calibrated.reasons[:1]
    if (age := (day - calibrated.on).days) > _OLD_DAYS:
        reasons.append(f"The calibration is {age} days old.")
    if checked is not None and result is not None and result.unseen and checked.on == day:
        if not reasons:
            remedy = "Photograph the board again, where these cameras see it."
        reasons.insert(0, f"Not checked, because they did not see the board: {', '.join(result.unseen)}.")
        if not fresh:
            return Today(verdict="care", sentence="Not all cameras are checked.", reasons=tuple(reasons), remedy=remedy)
    if reasons:
        return Today(verdict="care", sentence="Yes, with care: read why.", reasons=tuple(reasons), remedy=remedy)
    how = "it was calibrated today" if fresh else "no camera has moved"
    return Today(verdict="yes", sentence=f"Yes: {how}.")


def with_acceptance(answer: Today, day: datetime.date, last: PastTest | None, every_days: int) -> Today:
    """Add the results of acceptance tests to a rig's readiness.

    Args:
        answer: readiness without them.
        day: today in the clinic's time zone.
        last: the newest test; None if there is none.
        every_days: days after which a new test is due; 0: never.
    """
    reasons = []
    if last is not None and last.decision == "reject":
        reasons.append(f"The acceptance test of {last.date.isoformat()} rejected this rig.")
    elif last is not None and last.decision == "undecided":
        reasons.append(f"The acceptance test of {last.date.isoformat()} is undecided.")
    if every_days and last is None:
        reasons.append("This rig has had no acceptance test.")
    elif every_days and last is not None and (day - last.date).days > every_days:
        reasons.append(f"The last acceptance test is {(day - last.date).days} days old.")
    if not reasons:
        return answer
    calm = answer.verdict == "yes"
    return replace(
        answer,
        verdict="care" if calm else answer.verdict,
        sentence="Yes, with care: read why." if calm else answer.sentence,
        reasons=(*answer.reasons, *reasons),
        remedy=answer.remedy or "Test the rig with the artefacts.",
    )


def acceptance_tests(rig: Rig) -> list[PastTest]:
    """Acceptance tests in the clinic's folder whose device has the rig's name, oldest first."""
    return device_tests(the_clinic().folder / "acceptance", rig.name)


_OF_A_DAY = 20  # number of newest checks that are searched for those of one day
_SHOWN = 60  # number of newest checks on the chart: two months of daily checks


def current(rig: Rig) -> Calibration | None:
    """The calibration that new visits use."""
    return rig.calibrations.filter(current=True).first()


def today(rig: Rig) -> Today:
    """Whether a rig may be used today."""
    last = next(reversed(acceptance_tests(rig)), None)
    return with_acceptance(_by_checks(rig), timezone.localdate(), last, the_clinic().rigs.acceptance_days)


def _by_checks(rig: Rig) -> Today:
    day = timezone.localdate()
    calibration = current(rig)
    if calibration is None:
        return judge(day, None, None)
    found = calibration.result
    on = timezone.localdate(photographed_at(calibration))
    known = Calibrated(on=on, verdict=found.verdict, reasons=found.reasons)
    newest = rig.checks.filter(calibration=calibration).order_by("-taken_at").first()
    checked = None
    if newest is not None:
        on = timezone.localdate(newest.taken_at)
        # A camera that did not see the board in one photograph may have seen it in another one of the same day.
        others = rig.checks.filter(calibration=calibration).exclude(figures={}).exclude(pk=newest.pk)[:_OF_A_DAY]
        same_day = [other.result for other in others if timezone.localdate(other.taken_at) == on]
        seen = {name for one in same_day if one is not None and one.verdict != "refuse" for name in one.cameras}
        result = newest.result
        if result is not None:
            result = replace(result, unseen=tuple(name for name in result.unseen if name not in seen))
        checked = LatestCheck(on=on, result=result)
    return judge(day, known, checked)


def photographed_at(calibration: Calibration) -> datetime.datetime:
    """Upload time of the oldest photograph of a calibration.

    If photographs of an earlier calibration are sent again, they keep their time.
    """
    own = calibration.uploads.filter(state=Upload.State.PLACED).exclude(sha256="").values("sha256")
    first = Upload.objects.filter(sha256__in=own).aggregate(first=Min("created"))["first"]
    return calibration.taken_at if first is None else min(first, calibration.taken_at)


def entries(rig: Rig) -> list[DriftEntry]:
    """The newest evaluated checks for the drift chart, oldest first."""
    checks = rig.checks.exclude(figures={}).select_related("calibration").order_by("-taken_at")[:_SHOWN]
    return [_entry(check) for check in reversed(checks)]


def drift_rows(rig: Rig) -> Iterator[dict[str, Any]]:
    """The newest evaluated checks as a table: one row per check, newest first."""
    for entry in reversed(entries(rig)):
        yield {
            "when": entry.when,
            "verdict": entry.verdict,
            "effect_mm": entry.effect_mm,
            "reasons": entry.reasons,
            "moved": [name for name, camera in entry.cameras.items() if camera.moved],
            "cameras": {name: {"px": camera.shift_px, "mm": camera.shift_mm} for name, camera in entry.cameras.items()},
        }


def new_calibration(rig: Rig, by: Any) -> Calibration:
    """Create a calibration without photographs, and its folder."""
    made = Calibration(rig=rig, taken_at=timezone.now(), created_by=by)
    made.folder = f"rigs/{rig.pk}/calibrations/{made.pk}"
    make_session(the_clinic().folder / made.folder, manifest_text(rig.definition, "torso"))
    made.save()
    return made


def new_check(rig: Rig, by: Any) -> DailyCheck | None:
    """Create a daily check without photographs. None if the rig is not calibrated."""
    calibration = current(rig)
    if calibration is None:
        return None
    made = DailyCheck(rig=rig, calibration=calibration, taken_at=timezone.now(), by=by)
    made.folder = f"rigs/{rig.pk}/checks/{made.pk}"
    made.save()
    return made


def may_queue(target: Visit | Calibration | DailyCheck | Comparison, *, anyway: bool = False) -> str | None:
    """Reason why something cannot be computed now, in one sentence. None if it can be.

    A visit uses the calibration that was current when it was first queued, and keeps it.
    """
    from mammometry.clinic.intake.uploads import state_of
    from mammometry.clinic.records.comparing import may_compare
    from mammometry.clinic.records.search import elsewhere, same_photographs
    from mammometry.io.meshes.scans import is_scan

    if isinstance(target, Comparison):
        ready = may_compare(target.before, target.after)
        return None if ready else "One of the visits has unmeasured changes. Measure it first."
    if Job.objects.filter(_about(target), state__in=(Job.State.QUEUED, Job.State.RUNNING)).exists():
        return None  # the response is the job that is already open
    if isinstance(target, Visit) and target.is_scan:
        return None if is_scan(target.folder) else "This visit has no scan. Start a new visit."
    if isinstance(target, Visit) and target.rig is not None:
        if target.calibration is None:
            target.calibration = current(target.rig)
            if target.calibration is None:
                return "This rig is not calibrated. Calibrate it first."
            target.save(update_fields=["calibration"])
        if target.calibration.state != Calibration.State.DONE:
            return "The calibration of this visit has no result yet. Wait for it, or calibrate again."
        answer = today(target.rig)
        same_day = timezone.localdate(target.taken_at) == timezone.localdate()
        if answer.verdict == "no" and same_day and not anyway:
            return f"{answer.sentence} {answer.remedy}"
    state = state_of(target)
    if not state["ready"]:
        sentences = [finding["sentence"] for finding in state["together"] if finding["level"] == "refuse"]
        missing = f"Photographs are missing: {', '.join(state['missing'])}." if state["missing"] else ""
        why = " ".join(filter(None, [missing, state.get("needed"), *sentences]))
        return why or "This rig has no cameras. Describe it first."
    if isinstance(target, Visit) and not anyway:
        return " ".join(elsewhere(other, cameras) for other, cameras in same_photographs(target)) or None
    return None


def _about(target: Visit | Calibration | DailyCheck) -> Any:
    from django.db.models import Q

    if isinstance(target, Visit):
        return Q(visit=target)
    return Q(calibration=target) if isinstance(target, Calibration) else Q(check_of_day=target)


def _entry(check: DailyCheck) -> DriftEntry:
    result = CheckResult.from_table(check.figures)
    return DriftEntry(
        when=timezone.localtime(check.taken_at).isoformat(timespec="minutes"),
        image_set=str(check.pk),
        calibration=result.calibration or str(check.calibration_id),
        verdict=result.verdict,
        effect_mm=result.effect_mm,
        reasons=result.reasons,
        cameras=result.cameras,
    )
