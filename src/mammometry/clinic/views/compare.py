"""Any two dates of one patient, side by side."""

from __future__ import annotations

import uuid

from django.http import Http404, HttpRequest, HttpResponse
from django.shortcuts import get_object_or_404, render

from mammometry.clinic import comparing
from mammometry.clinic.models import Comparison, Patient, Visit
from mammometry.clinic.results import visit_result
from mammometry.clinic.security import report_policy
from mammometry.clinic.templatetags.comparisons import queued

_LARGEST = 64 << 20  # bytes of a page; those of two full-size dates have about 10 MB


def compare(request: HttpRequest, patient: uuid.UUID) -> HttpResponse:
    """Choose two dates, and see what changed."""
    person = get_object_or_404(Patient, pk=patient)
    visits = comparing.comparable(person.visits.select_related("rig").prefetch_related("measurements__volumes"))
    context: dict[str, object] = {"patient": person, "visits": visits}
    chosen = (
        sorted((_of(visits, request.GET.get(name)) for name in ("before", "after")), key=visits.index)
        if {"before", "after"} <= set(request.GET)
        else visits[-2:]
    )
    if len(chosen) == 2:
        before, after = chosen
        context |= {"before": before, "after": after}
        if before.pk != after.pk:
            request.shown = [before.pk, after.pk]  # type: ignore[attr-defined]
            context["both"] = [visit_result(visit, visit.measurements.all()[0]) for visit in chosen]
            context["found"] = found = queued(comparing.verdict(before, after))
            if found.state == "done":
                context["table"] = Comparison.objects.get(before=before, after=after).table
    part = request.headers.get("HX-Request") == "true"
    return render(request, "clinic/compare_result.html" if part else "clinic/compare.html", context)


def visit_verdict(request: HttpRequest, visit: uuid.UUID) -> HttpResponse:
    """The verdict against the visit before, as a part of the visit's page."""
    return render(request, "clinic/visit_verdict.html", {"visit": get_object_or_404(Visit, pk=visit)})


def patient_changes(request: HttpRequest, patient: uuid.UUID) -> HttpResponse:
    """The verdicts from visit to visit, as a part of the patient's page."""
    return render(request, "clinic/patient_changes.html", {"patient": get_object_or_404(Patient, pk=patient)})


def compare_page(request: HttpRequest, patient: uuid.UUID, before: uuid.UUID, after: uuid.UUID) -> HttpResponse:
    """The full page of a comparison, with its pictures."""
    both = [get_object_or_404(Visit, pk=each, patient=patient) for each in (before, after)]
    path = comparing.comparison_folder(*both) / "compare.html"
    if not path.is_file() or path.is_symlink() or path.stat().st_size > _LARGEST:
        raise Http404
    page = path.read_bytes()
    response = HttpResponse(page, content_type="text/html; charset=utf-8")
    response["Content-Security-Policy"] = report_policy(page)
    return response


def _of(visits: list[Visit], key: str | None) -> Visit:
    visit = next((visit for visit in visits if str(visit.pk) == key), None)
    if visit is None:
        raise Http404
    return visit
