"""Any two dates of one patient, side by side."""

from __future__ import annotations

import uuid

from django.http import Http404, HttpRequest, HttpResponse
from django.shortcuts import get_object_or_404, render

from mammometry.clinic.comparing import COMPARER, comparison_folder
from mammometry.clinic.models import Patient, Visit
from mammometry.clinic.results import visit_result
from mammometry.clinic.security import report_policy

_LARGEST = 64 << 20  # bytes of a page; those of two full-size dates have about 10 MB


def compare(request: HttpRequest, patient: uuid.UUID) -> HttpResponse:
    """Choose two dates, and see what changed."""
    person = get_object_or_404(Patient, pk=patient)
    visits = [
        visit
        for visit in person.visits.select_related("rig").prefetch_related("measurements__volumes").order_by("taken_at")
        if visit.measurements.all()
    ]
    context: dict[str, object] = {"patient": person, "visits": visits}
    chosen = (
        sorted((_of(visits, request.GET.get(name)) for name in ("before", "after")), key=lambda each: each.taken_at)
        if {"before", "after"} <= set(request.GET)
        else visits[-2:]
    )
    if len(chosen) == 2:
        before, after = chosen
        context |= {"before": before, "after": after}
        if before.pk == after.pk:
            context["state"] = "same"
        else:
            request.shown = [before.pk, after.pk]  # type: ignore[attr-defined]
            context["both"] = [visit_result(each, each.measurements.all()[0]) for each in chosen]
            context["state"], context["table"] = COMPARER.state(before, after)
    part = request.headers.get("HX-Request") == "true"
    return render(request, "clinic/compare_result.html" if part else "clinic/compare.html", context)


def compare_page(request: HttpRequest, patient: uuid.UUID, before: uuid.UUID, after: uuid.UUID) -> HttpResponse:
    """The full page of a comparison, with its pictures."""
    both = [get_object_or_404(Visit, pk=each, patient=patient) for each in (before, after)]
    path = comparison_folder(*both) / "compare.html"
    if not path.is_file() or path.is_symlink() or path.stat().st_size > _LARGEST:
        raise Http404
    page = path.read_bytes()
    response = HttpResponse(page, content_type="text/html; charset=utf-8")
    response["Content-Security-Policy"] = report_policy(page)
    return response


def _of(visits: list[Visit], asked: str | None) -> Visit:
    found = next((visit for visit in visits if str(visit.pk) == asked), None)
    if found is None:
        raise Http404
    return found
