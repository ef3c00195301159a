"""The rig's cameras on a visit's page: aim and fire."""

from __future__ import annotations

from uuid import UUID

from django.http import HttpRequest, HttpResponse, HttpResponseBase, JsonResponse
from django.shortcuts import get_object_or_404, render
from django.urls import reverse

from mammometry.base.errors import SessionError
from mammometry.capture.page_service import firing_table
from mammometry.capture.shots import require_replaceable
from mammometry.clinic import cameras
from mammometry.clinic.intake import uploads
from mammometry.clinic.intake.fired import take_in
from mammometry.clinic.models import Visit
from mammometry.clinic.rigs.history import today
from mammometry.clinic.views.answers import Refused, get_or_404, json_view
from mammometry.clinic.views.who import person_of


def visit_capture(request: HttpRequest, visit: UUID) -> HttpResponse:
    """The page on which a visit is photographed."""
    shown = get_object_or_404(Visit.objects.select_related("patient", "rig").exclude(rig=None), pk=visit)
    return render(request, "clinic/capture.html", {
        "visit": shown, "patient": shown.patient, "rig_verdict": today(uploads.rig_of(shown)),
        "driven": cameras.rig_file(uploads.rig_of(shown)) is not None,
    })  # fmt: skip


@json_view("GET")
def visit_state(request: HttpRequest, visit: UUID) -> HttpResponseBase:
    """The rig before anything is fired."""
    row = _visit(visit)
    rig = uploads.rig_of(row)
    return JsonResponse(cameras.stand_of(rig, row.calibration).state(rig.name, row.folder))


@json_view("POST")
def visit_look(request: HttpRequest, visit: UUID) -> HttpResponseBase:
    """A live picture of every camera, with its aids."""
    row = _visit(visit)
    stand = cameras.stand_of(uploads.rig_of(row), row.calibration)
    return JsonResponse(stand.look(request.body, subject_kind=row.subject_kind))


@json_view("POST")
def visit_fire(request: HttpRequest, visit: UUID) -> HttpResponseBase:
    """Fire. Pictures that may be measured are the visit's from then on."""
    row = _visit(visit)
    uploads.require_open(row)
    stand = cameras.stand_of(uploads.rig_of(row), row.calibration)
    uploads.ready_folder(row)
    try:
        require_replaceable(row.folder)
    except SessionError:
        raise Refused("This visit has photographs that were sent. Set them aside first, then fire.") from None
    fired = stand.fire(row.folder, subject_id=row.patient.pseudonym)
    if fired.accepted:
        take_in(row, fired, person_of(request))
    where = reverse("visit", kwargs={"visit": row.pk})
    return JsonResponse({**firing_table(fired, "Press “Measure”, or fire again."), "visit": where})


def _visit(key: UUID) -> Visit:
    return get_or_404(Visit.objects.select_related("patient", "rig", "calibration").filter(pk=key).first())
