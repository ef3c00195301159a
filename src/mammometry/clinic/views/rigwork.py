"""Rigs, for programs of a page. May we measure today, the drift chart, a new calibration or check."""

from __future__ import annotations

from uuid import UUID

from django.http import Http404, HttpRequest, HttpResponse, HttpResponseBase, JsonResponse
from django.urls import reverse

from mammometry.clinic.models import Rig
from mammometry.clinic.rigs import history
from mammometry.clinic.site import the_clinic
from mammometry.clinic.views.answers import Refused, get_or_404, json_view


@json_view("GET")
def today(request: HttpRequest, rig: UUID) -> HttpResponseBase:
    """May we measure today?"""
    return JsonResponse(history.today(_find(rig)).as_table())


@json_view("GET")
def drift(request: HttpRequest, rig: UUID) -> HttpResponseBase:
    """The chart of the rig's checks, PNG."""
    from mammometry.report.figures.drift import drift as drawn

    entries = history.entries(_find(rig))
    if not entries:
        raise Http404
    picture = drawn(entries, the_clinic().measuring().calibration.check.refuse_mm)
    return HttpResponse(picture, content_type="image/png", headers={"Cache-Control": "private, no-store"})


@json_view("POST")
def new_calibration(request: HttpRequest, rig: UUID) -> HttpResponseBase:
    """A calibration to upload to."""
    made = history.new_calibration(_find(rig), request.user)
    return JsonResponse(
        {"id": str(made.pk), "url": reverse("calibration-uploads", kwargs={"calibration": made.pk})}, status=201
    )


@json_view("POST")
def new_check(request: HttpRequest, rig: UUID) -> HttpResponseBase:
    """A daily check to upload to."""
    made = history.new_check(_find(rig), request.user)
    if made is None:
        raise Refused("This rig is not calibrated. Calibrate it first.")
    return JsonResponse({"id": str(made.pk), "url": reverse("check-uploads", kwargs={"check": made.pk})}, status=201)


def _find(key: UUID) -> Rig:
    return get_or_404(Rig.objects.filter(pk=key).first())
