"""First page: today's work, the first steps of a new clinic, and help."""

import datetime
from dataclasses import dataclass
from typing import NamedTuple

from auditlog.models import LogEntry
from django.http import HttpRequest, HttpResponse
from django.shortcuts import redirect, render
from django.urls import reverse
from django.utils import timezone

from mammometry.clinic.jobs import queue
from mammometry.clinic.models import Calibration, Job, Patient, Person, Rig, Visit
from mammometry.clinic.records.results import latest
from mammometry.clinic.rig_history import today as verdict_of
from mammometry.clinic.roles import ADMINISTRATOR, CARE, RIGS, Role
from mammometry.clinic.views.responses import person_of


class Step(NamedTuple):
    """One of the first steps."""

    title: str
    sentence: str
    done: bool
    button: str
    address: str
    """Address that the button opens."""
    roles: frozenset[Role]
    """Roles that may do the step."""

    @property
    def role_words(self) -> str:
        """These roles as text."""
        return " or ".join(role.label.lower() for role in Role if role in self.roles)


def steps() -> list[Step]:
    """Return the steps. Empty when all are done."""
    rig = Rig.objects.filter(active=True).order_by("created").first()
    calibrated = Calibration.objects.filter(current=True).exists()
    has_patient = Patient.objects.exists()
    if rig is not None and calibrated and has_patient:
        return []
    staff = any(not CARE.isdisjoint(person.roles) for person in Person.objects.filter(is_active=True))
    printed = calibrated or LogEntry.objects.filter(additional_data__page="rig-target").exists()
    rig_page = reverse("rigs") if rig is None else reverse("rig", args=[rig.pk])
    return [
        Step(
            "People", "Add at least one technician or clinician, and give them the link for setting a password.",
            staff, "Add a person", reverse("person-new"), ADMINISTRATOR,
        ),
        Step(
            "Rig", "Enter the rig's cameras, and the board for calibrating them.",
            rig is not None, "Enter the rig", reverse("rig-new"), RIGS,
        ),
        Step(
            "Board to print", "Print it at 100 %, fix it to a flat, stiff plate, and measure the ruler below it.",
            rig is not None and printed, "Open the board as PDF",
            rig_page if rig is None else reverse("rig-target", args=[rig.pk]), RIGS,
        ),
        Step(
            "Calibration", "Photograph the board in about twelve poses with all cameras, and calibrate them.",
            calibrated, "To the rig", rig_page, RIGS,
        ),
        Step(
            "First patient", "Add a patient, start a visit, and add its photographs.",
            has_patient, "Enter a patient", reverse("patient-new"), CARE,
        ),
    ]  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class FirstDay:
    """The first steps as shown to one person."""

    steps: list[Step]
    next_step: Step
    may_do: bool
    """Whether this person may do the next step."""


def first_day_of(person: Person) -> FirstDay | None:
    """First steps for this person. None when all are done."""
    all_steps = steps()
    waiting = [step for step in all_steps if not step.done]
    if not waiting:
        return None
    return FirstDay(steps=all_steps, next_step=waiting[0], may_do=person.has_role(*waiting[0].roles))


_MANY = 50  # rows of a page above which it becomes a search


def today(request: HttpRequest) -> HttpResponse:
    """Rigs, today's visits, and waiting visits. For clinicians, those to confirm come first.

    People who may not see patients get a page of their own.
    """
    person = person_of(request)
    if CARE.isdisjoint(person.roles):
        if person.has_role(Role.RESEARCHER) and not person.has_role(Role.ADMINISTRATOR):
            return redirect("study")
        return redirect("administration")
    now = timezone.localtime()
    begin = now.replace(hour=0, minute=0, second=0, microsecond=0)
    all_visits = Visit.objects.select_related("patient", "rig")
    of_today = all_visits.filter(taken_at__gte=begin, taken_at__lt=begin + datetime.timedelta(days=1))
    visits = list(of_today.prefetch_related("measurements__volumes")[:_MANY])
    earlier = all_visits.filter(taken_at__lt=begin)
    unfinished = list(earlier.filter(state__in=("new", "uploading", "ready", "queued", "changed", "refused"))[:_MANY])
    judges = person.has_role(Role.CLINICIAN)
    unconfirmed = (all_visits if judges else earlier).filter(state="measured")
    to_confirm = list(unconfirmed.order_by("taken_at")[:_MANY])
    request.shown = [visit.id for visit in (*visits, *unfinished, *to_confirm)]  # type: ignore[attr-defined]
    rigs = [(rig, verdict_of(rig)) for rig in Rig.objects.filter(active=True)]
    jobs = queue.computations().filter(state__in=Job.OPEN).count()
    context = {
        "now": now,
        "first_day": first_day_of(person),
        "visits": visits,
        "volumes": {result.visit.id: result for result in latest(visits)},
        "unfinished": unfinished,
        "to_confirm": to_confirm,
        "judges": judges,
        "rigs": rigs,
        "open_jobs": jobs,
    }
    return render(request, "clinic/today.html", context)


def alive(request: HttpRequest) -> HttpResponse:
    """Report that the server is running, for monitoring."""
    return HttpResponse("ok\n", content_type="text/plain")


def guide(request: HttpRequest) -> HttpResponse:
    """All help on one page."""
    return render(request, "clinic/help.html")
