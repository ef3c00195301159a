"""The first page: what there is to do today."""

from __future__ import annotations

import datetime

from django.http import HttpRequest, HttpResponse
from django.shortcuts import redirect, render
from django.utils import timezone

from mammometry.clinic.first_day import first_day_of
from mammometry.clinic.models import Job, Rig, Visit
from mammometry.clinic.records.results import latest
from mammometry.clinic.rigs.history import today as verdict_of
from mammometry.clinic.roles import CARE, Role
from mammometry.clinic.views.who import person_of

_MANY = 50  # rows that a page shows before it becomes a search


def today(request: HttpRequest) -> HttpResponse:
    """Rigs, visits of the day, and what waits, to be confirmed first for clinicians.

    People without patients are led to their own first page.
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
    jobs = Job.objects.filter(state__in=("queued", "running")).count()
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
