"""Any two dates of one patient, side by side."""

from __future__ import annotations

import uuid
from pathlib import Path

from django.http import Http404, HttpRequest, HttpResponse
from django.shortcuts import get_object_or_404, render

from mammometry.clinic.models import Comparison, Patient, Upload, Visit
from mammometry.clinic.records.reports import readable
from mammometry.clinic.study import comparing
from mammometry.clinic.templatetags.comparisons import queued
from mammometry.clinic.web.security import report_policy
from mammometry.report.scene import json_in_page

Pair = tuple[Upload | None, Upload | None]


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
    busy = False
    if len(chosen) == 2:
        before, after = chosen
        context |= {"before": before, "after": after}
        if before.pk != after.pk:
            request.shown = [before.pk, after.pk]  # type: ignore[attr-defined]
            verdict = queued(comparing.verdict(before, after))
            row = Comparison.objects.filter(before=before, after=after).first()
            busy = verdict.state == "busy"
            context |= {
                "found": verdict,
                "table": row.table if row is not None and verdict.state == "done" else None,
                "job": None if row is None else row.jobs.order_by("-created").first(),
                "photographs": photographs(before, after),
                "unconfirmed": [visit for visit in chosen if visit.state != Visit.State.CONFIRMED],
            }
    if request.headers.get("HX-Request") == "true":
        response = render(request, "clinic/compare_busy.html", context)
        if not busy:
            response["HX-Refresh"] = "true"  # the viewer comes with the page
        return response
    return render(request, "clinic/compare.html", context)


def photographs(before: Visit, after: Visit) -> list[tuple[str, Pair]]:
    """Camera → its photograph at both dates, for the cameras that have one at either."""
    of_visits = [
        {upload.camera: upload for upload in visit.uploads.filter(state=Upload.State.PLACED)}
        for visit in (before, after)
    ]
    cameras = sorted(of_visits[0].keys() | of_visits[1].keys())
    return [(camera, (of_visits[0].get(camera), of_visits[1].get(camera))) for camera in cameras]


def compare_page(request: HttpRequest, patient: uuid.UUID, before: uuid.UUID, after: uuid.UUID) -> HttpResponse:
    """The full page of a comparison, with its pictures."""
    page = _page(patient, before, after).read_bytes()
    response = HttpResponse(page, content_type="text/html; charset=utf-8")
    response["Content-Security-Policy"] = report_policy(page)
    return response


def compare_scene(request: HttpRequest, patient: uuid.UUID, before: uuid.UUID, after: uuid.UUID) -> HttpResponse:
    """Both surfaces for the 3D view, laid onto one another."""
    scene = json_in_page(_page(patient, before, after).read_text(encoding="utf-8"))
    if scene is None:
        raise Http404
    return HttpResponse(scene, content_type="application/json")


def _page(patient: uuid.UUID, before: uuid.UUID, after: uuid.UUID) -> Path:
    """The page that a comparison of the newest measurements wrote."""
    row = get_object_or_404(
        Comparison.objects.select_related("before", "after"), before=before, after=after, after__patient=patient
    )
    path = readable(comparing.comparison_folder(row.before, row.after) / "compare.html")
    if path is None or row.state != Comparison.State.DONE or not comparing.is_current(row):
        raise Http404
    return path


def visit_verdict(request: HttpRequest, visit: uuid.UUID) -> HttpResponse:
    """The verdict against the visit before, as a part of the visit's page."""
    return render(request, "clinic/visit_verdict.html", {"visit": get_object_or_404(Visit, pk=visit)})


def patient_changes(request: HttpRequest, patient: uuid.UUID) -> HttpResponse:
    """The verdicts from visit to visit, as a part of the patient's page."""
    return render(request, "clinic/patient_changes.html", {"patient": get_object_or_404(Patient, pk=patient)})


def _of(visits: list[Visit], key: str | None) -> Visit:
    visit = next((visit for visit in visits if str(visit.pk) == key), None)
    if visit is None:
        raise Http404
    return visit
