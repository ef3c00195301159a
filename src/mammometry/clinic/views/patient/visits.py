"""Visits: begun, photographed, measured, looked at."""

from __future__ import annotations

import uuid

from django.http import Http404, HttpRequest, HttpResponse
from django.shortcuts import get_object_or_404, redirect, render
from django.utils import timezone

from mammometry.clinic.cameras import rig_file
from mammometry.clinic.clinical_forms import CircumstancesForm
from mammometry.clinic.forms import VisitForm
from mammometry.clinic.jobs import queue
from mammometry.clinic.models import Calibration, Scan, Visit
from mammometry.clinic.records.confirmations import is_changed
from mammometry.clinic.records.consents import pictures_caution
from mammometry.clinic.records.next_step import next_step
from mammometry.clinic.records.operations import phase_of
from mammometry.clinic.records.reports import facts, refusal_picture, refusal_pictures, report_file
from mammometry.clinic.records.results import visit_result
from mammometry.clinic.rigs.history import today as verdict_of
from mammometry.clinic.roles import Role
from mammometry.clinic.site import the_clinic
from mammometry.clinic.views.patient.choose import chosen_patient, is_part, search_context
from mammometry.clinic.views.who import person_of
from mammometry.report.words.lengths import length_table

OPEN = ("queued", "running")


def visit_new(request: HttpRequest) -> HttpResponse:
    """Begin a visit of a patient, who is searched for first."""
    patient = chosen_patient(request)
    if patient is None:
        page = "clinic/patients_rows.html" if is_part(request) else "clinic/visit_new.html"
        return render(request, page, search_context(request, choosing=True))
    first = {"taken_at": timezone.localtime(), "patient": patient, "rig": request.GET.get("rig")}
    form = VisitForm(request.POST or None, initial={name: value for name, value in first.items() if value is not None})
    if request.method == "POST" and form.is_valid():
        visit: Visit = form.save(commit=False)
        visit.created_by = person_of(request)
        visit.calibration = Calibration.objects.filter(rig=visit.rig, current=True).first()
        visit.save()
        return redirect("visit", visit=visit.pk)
    return render(request, "clinic/visit_new.html", {"form": form, "chosen": patient})


def visit(request: HttpRequest, visit: uuid.UUID, draft: str | None = None) -> HttpResponse:
    """One visit, as far as it is: photographs, progress or result.

    Args:
        request: whose.
        visit: its key.
        draft: a conclusion that could not be signed, to be shown again.
    """
    shown = get_object_or_404(Visit.objects.select_related("patient", "rig", "calibration"), pk=visit)
    job = shown.jobs.order_by("-created").first()
    measurement = shown.measurements.prefetch_related("volumes").first()
    busy = job is not None and job.state in OPEN
    person = person_of(request)
    failed = job if job is not None and job.state in ("failed", "cancelled") and not busy else None
    context = {
        "visit": shown,
        "patient": shown.patient,
        "job": job,
        "busy": busy,
        "failed": failed,
        "refusal_pictures": {} if failed is None else refusal_pictures(shown),
        "step": next_step(shown, job, measurement, person),
        "result": None if measurement is None or busy else visit_result(shown, measurement),
        "lengths": None if measurement is None or is_changed(shown) else length_table(measurement.quantities),
        "facts": facts(shown) if measurement is not None and not busy else None,
        "has_report": report_file(shown, "report.html") is not None,
        "drawings": shown.drawings.select_related("by")[:20],
        "conclusions": list(shown.conclusions.select_related("by")),
        "draft": draft,
        "consent_caution": pictures_caution(shown.patient) if shown.subject_kind == Visit.Subject.TORSO else "",
        "circumstances": CircumstancesForm(instance=shown),
        "phase": phase_of(shown, list(shown.patient.operations.all())),
        "rig_verdict": None if shown.rig is None else verdict_of(shown.rig),
        "photographs": not busy and not shown.is_scan and (measurement is None or "photographs" in request.GET),
        "clinician": person.has_role(Role.CLINICIAN),
        "driven": shown.rig is not None and rig_file(shown.rig) is not None,
        "scan": Scan.objects.filter(visit=shown).first(),
        "limit_mb": the_clinic().limits.photograph_mb,
    }
    return render(request, "clinic/visit.html", context)


def refused_picture(request: HttpRequest, visit: uuid.UUID, name: str) -> HttpResponse:
    """A picture of what a refused measurement saw."""
    picture = refusal_picture(get_object_or_404(Visit, pk=visit), name)
    if picture is None:
        raise Http404
    return HttpResponse(picture, content_type="image/png", headers={"Cache-Control": "private, no-store"})


def jobs(request: HttpRequest) -> HttpResponse:
    """What is being computed, what waits, and how the last ones ended."""
    all_jobs = queue.of_visits_in_use().select_related(
        "visit__patient", "comparison__before", "comparison__after__patient", "calibration__rig", "check_of_day__rig"
    )
    context = {
        "open": list(all_jobs.filter(state__in=OPEN).order_by("created")),
        "ended": list(all_jobs.exclude(state__in=OPEN).order_by("-ended", "-created")[:50]),
    }
    return render(request, "clinic/jobs.html", context)
