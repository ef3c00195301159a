"""A rig's history out of the database. Its calibrations, its checks, and today's answer."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from django.utils import timezone

from mammometry.capture.sessions import make_session, manifest_text
from mammometry.clinic.models import Calibration, Comparison, DailyCheck, Job, Rig, Visit
from mammometry.clinic.rigs.today import Calibrated, Checked, Today, judge
from mammometry.clinic.site import the_clinic
from mammometry.io.drift import CameraDrift, Entry

_OF_A_DAY = 20  # newest checks among which those of one day are
_SHOWN = 60  # newest checks of the chart: two months of days


def current(rig: Rig) -> Calibration | None:
    """The calibration that new visits use."""
    return rig.calibrations.filter(current=True).first()


def today(rig: Rig) -> Today:
    """May we measure with this rig today?"""
    day = timezone.localdate()
    calibration = current(rig)
    if calibration is None:
        return judge(day, None, None)
    figures = calibration.figures
    known = Calibrated(
        on=timezone.localdate(calibration.taken_at),
        verdict=figures.get("verdict"),
        reasons=tuple(figures.get("reasons", ())),
    )
    newest = rig.checks.filter(calibration=calibration).order_by("-taken_at").first()
    checked = None
    if newest is not None:
        on = timezone.localdate(newest.taken_at)
        # A camera that missed the board in one photograph may have seen it in another of the same day.
        others = rig.checks.filter(calibration=calibration).exclude(figures={}).exclude(pk=newest.pk)[:_OF_A_DAY]
        seen = {
            name
            for other in others
            if timezone.localdate(other.taken_at) == on and other.figures.get("verdict") != "refuse"
            for name in other.figures.get("cameras", {})
        }
        unseen = [name for name in newest.figures.get("unseen", ()) if name not in seen]
        checked = Checked.of(on, {**newest.figures, "unseen": unseen})
    return judge(day, known, checked)


def entries(rig: Rig) -> list[Entry]:
    """The newest judged checks, the oldest first. As the drift chart takes them."""
    found = rig.checks.exclude(figures={}).select_related("calibration").order_by("-taken_at")[:_SHOWN]
    return [_entry(check) for check in reversed(found)]


def drift_rows(rig: Rig) -> Iterator[dict[str, Any]]:
    """The same as a table: a row a check, the newest first."""
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
    """A calibration without photographs yet, and its folder."""
    made = Calibration(rig=rig, taken_at=timezone.now(), created_by=by)
    made.folder = f"rigs/{rig.pk}/calibrations/{made.pk}"
    make_session(the_clinic().folder / made.folder, manifest_text(rig.definition, "torso"))
    made.save()
    return made


def new_check(rig: Rig, by: Any) -> DailyCheck | None:
    """A daily check without photographs yet. None where the rig is not calibrated."""
    calibration = current(rig)
    if calibration is None:
        return None
    made = DailyCheck(rig=rig, calibration=calibration, taken_at=timezone.now(), by=by)
    made.folder = f"rigs/{rig.pk}/checks/{made.pk}"
    made.save()
    return made


def may_queue(target: Visit | Calibration | DailyCheck | Comparison, *, anyway: bool = False) -> str | None:
    """Why something cannot be computed now, in a sentence. None where it can.

    A visit takes its rig's current calibration when it is queued first, and keeps it.
    """
    from mammometry.clinic.intake.uploads import state_of
    from mammometry.clinic.records.duplicates import elsewhere, same_photographs
    from mammometry.clinic.study.comparing import may_compare
    from mammometry.io.meshes.scans import is_scan

    if isinstance(target, Comparison):
        ready = may_compare(target.before, target.after)
        return None if ready else "One of both visits is not measured as it stands. Measure it first."
    if Job.objects.filter(_about(target), state__in=(Job.State.QUEUED, Job.State.RUNNING)).exists():
        return None  # the one that is open is answered
    if isinstance(target, Visit):
        if target.rig is None:
            return None if is_scan(target.folder) else "This visit has no scan. Begin a new one."
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


def _entry(check: DailyCheck) -> Entry:
    figures = check.figures
    names = ("shift_mm", "turn_deg", "shift_px", "sigma")
    return Entry(
        when=timezone.localtime(check.taken_at).isoformat(timespec="minutes"),
        image_set=str(check.pk),
        calibration=str(figures.get("calibration", check.calibration_id)),
        verdict=str(figures.get("verdict")),
        effect_mm=float(figures.get("effect_mm") or 0.0),
        reasons=tuple(figures.get("reasons", ())),
        cameras={
            name: CameraDrift(moved=bool(drift.get("moved")), **{name: float(drift.get(name) or 0.0) for name in names})
            for name, drift in figures.get("cameras", {}).items()
        },
    )
