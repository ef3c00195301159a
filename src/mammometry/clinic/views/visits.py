"""Pages of visits: start, photograph with the rig's cameras, and view."""

import uuid
from typing import Any
from uuid import UUID

from django.contrib import messages
from django.db import transaction
from django.http import Http404, HttpRequest, HttpResponse, HttpResponseBase, JsonResponse
from django.shortcuts import get_object_or_404, redirect, render
from django.urls import reverse
from django.utils import timezone
from PIL import Image

from mammometry.base.errors import SessionError
from mammometry.capture.checks import Finding
from mammometry.capture.loop import CaptureResult
from mammometry.capture.page import firing_table
from mammometry.capture.shots import last_record, require_replaceable
from mammometry.clinic import cameras
from mammometry.clinic.forms import CircumstancesForm, ConclusionForm, VisitForm
from mammometry.clinic.intake import uploads
from mammometry.clinic.intake.photographs import fired_files, small_picture, thumbnail_path
from mammometry.clinic.intake.places import require_open, rig_of
from mammometry.clinic.intake.walks import facts_of, is_prepared
from mammometry.clinic.jobs import queue
from mammometry.clinic.models import Calibration, Conclusion, Job, Person, Scan, Upload, Visit, Walk
from mammometry.clinic.records.clinical import pictures_caution
from mammometry.clinic.records.confirmations import CHANGED_SENTENCE, next_step
from mammometry.clinic.records.operations import phase_of
from mammometry.clinic.records.results import (
    facts,
    refusal_picture,
    refusal_pictures,
    report_file,
    sides_doubtful,
    visit_result,
)
from mammometry.clinic.rig_history import today
from mammometry.clinic.roles import Role
from mammometry.clinic.site import the_clinic
from mammometry.clinic.views.patients import chosen_patient, is_part, search_context
from mammometry.clinic.views.responses import json_view, person_of, visit_or_404
from mammometry.clinic.walk_forms import BoardForm, print_words
from mammometry.io.photographs.images import FORMATS
from mammometry.report.words.anthropometry import length_table
from mammometry.web.replies import Refused


def visit_new(request: HttpRequest) -> HttpResponse:
    """Start a visit of a chosen patient."""
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


def visit_page(
    request: HttpRequest,
    visit: uuid.UUID,
    *,
    conclusion: ConclusionForm | None = None,
    circumstances: CircumstancesForm | None = None,
    board: BoardForm | None = None,
) -> HttpResponse:
    """One visit: photographs, progress or result, depending on its state.

    Args:
        request: the request.
        visit: key of the visit.
        conclusion: form that could not be signed, to show again.
        circumstances: form that could not be saved, to show again.
        board: form that could not be saved, to show again.
    """
    shown = visit_or_404(visit)
    job = shown.jobs.order_by("-created").first()
    measurement = shown.measurements.prefetch_related("volumes").first()
    busy = job is not None and job.state in Job.OPEN
    person = person_of(request)
    failed = job if job is not None and job.state in ("failed", "cancelled") and not busy else None
    if failed is not None and shown.is_walk and not shown.uploads.filter(created__lte=failed.created).exists():
        failed = None  # its photographs have been deleted, so that others can be sent
    conclusions = list(shown.conclusions.select_related("by"))
    walk = facts_of(shown) if shown.is_walk else None
    context = {
        "visit": shown,
        "patient": shown.patient,
        "job": job,
        "busy": busy,
        "failed": failed,
        "refusal_pictures": {} if failed is None else refusal_pictures(shown),
        "step": next_step(shown, job, measurement, person),
        "result": None if measurement is None or busy else visit_result(shown, measurement),
        "lengths": None if measurement is None or shown.is_changed else length_table(measurement.quantities),
        "sides_doubtful": measurement is not None and not busy and sides_doubtful(shown),
        "facts": facts(shown) if measurement is not None and not busy else None,
        "has_report": report_file(shown, "report.html") is not None,
        "drawings": shown.drawings.select_related("by")[:20],
        "conclusions": conclusions,
        "conclusion": conclusion or _conclusion_form(None, shown, conclusions[0] if conclusions else None),
        "draft": None if conclusion is None else conclusion.data.get("text", ""),
        "consent_caution": pictures_caution(shown.patient) if shown.subject_kind == Visit.Subject.TORSO else "",
        "circumstances": circumstances or CircumstancesForm(instance=shown),
        "phase": phase_of(shown, list(shown.patient.operations.all())),
        "rig_verdict": None if shown.rig is None else today(shown.rig),
        "photographs": not busy and shown.rig is not None and (measurement is None or "photographs" in request.GET),
        "walk": walk,
        "prepared": shown.is_walk and is_prepared(shown),
        "collecting": shown.is_walk and not busy and not is_prepared(shown),
        **(_board_context(shown, board) if shown.is_walk else {}),
        "clinician": person.has_role(Role.CLINICIAN),
        "driven": shown.rig is not None and cameras.rig_file(shown.rig) is not None,
        "scan": Scan.objects.filter(visit=shown).first(),
        "limit_mb": the_clinic().limits.photograph_mb,
        "video_mb": the_clinic().limits.video_mb,
    }
    return render(request, "clinic/visit.html", context)


def _board_context(visit: Visit, board: BoardForm | None) -> dict[str, Any]:
    walk = Walk.objects.get(visit=visit)
    return {"board": board or BoardForm(instance=walk), **print_words(), "is_measured_print": walk.edge_mm is not None}


def refused_picture(request: HttpRequest, visit: uuid.UUID, name: str) -> HttpResponse:
    """A picture of a refused measurement."""
    picture = refusal_picture(get_object_or_404(Visit, pk=visit), name)
    if picture is None:
        raise Http404
    return HttpResponse(picture, content_type="image/png", headers={"Cache-Control": "private, no-store"})


def circumstances(request: HttpRequest, visit: uuid.UUID) -> HttpResponse:
    """Change occasion and posture."""
    shown = get_object_or_404(Visit, pk=visit)
    if request.method == "POST":
        form = CircumstancesForm(request.POST, instance=shown)
        if not form.is_valid():
            reasons = [str(error) for errors in form.errors.values() for error in errors]
            messages.error(request, f"Nothing was changed. {' '.join(reasons)}")
            return visit_page(request, visit, circumstances=form)
        form.save()
        messages.success(request, "Occasion, posture and repeat are changed.")
    return redirect("visit", visit=visit)


def conclude(request: HttpRequest, visit: uuid.UUID) -> HttpResponse:
    """Sign a conclusion on the newest result of a visit. If it is refused, the form is shown again."""
    if request.method != "POST":
        return redirect("visit", visit=visit)
    shown = get_object_or_404(Visit.objects.select_for_update(), pk=visit)  # two people sign in turn
    measurement, newest = shown.measurements.first(), shown.conclusions.first()
    form = _conclusion_form(request.POST, shown, newest)
    if measurement is None:
        messages.error(request, "This visit is not measured yet. Measure it first.")
    elif request.POST.get("measurement") != str(measurement.pk):
        messages.error(request, "The visit has been measured again. Read the new result, then sign.")
    elif shown.is_changed:
        messages.error(request, CHANGED_SENTENCE)
    elif not form.is_valid():
        messages.error(request, "First write the conclusion, in up to 4,000 characters.")
    elif newest is not None and (newest.text, newest.measurement_id) == (form.cleaned_data["text"], measurement.pk):
        messages.info(request, "This conclusion is already signed. Nothing was changed.")
    else:
        text = form.cleaned_data["text"]
        Conclusion.objects.create(visit=shown, measurement=measurement, text=text, by=person_of(request))
        messages.success(request, "The conclusion is signed.")
        return redirect("visit", visit=visit)
    return visit_page(request, visit, conclusion=form)


def _conclusion_form(data: Any, visit: Visit, newest: Conclusion | None) -> ConclusionForm:
    """Form for a conclusion, which amends the newest one if there is one."""
    return ConclusionForm(data, instance=newest or Conclusion(visit=visit), auto_id="conclusion_%s")


def jobs(request: HttpRequest) -> HttpResponse:
    """Page of running, waiting and recently finished jobs."""
    all_jobs = queue.of_visits_in_use().select_related(
        "visit__patient", "comparison__before", "comparison__after__patient", "calibration__rig", "check_of_day__rig"
    )
    context = {
        "open": list(all_jobs.filter(state__in=Job.OPEN).order_by("created")),
        "ended": list(all_jobs.exclude(state__in=Job.OPEN).order_by("-ended", "-created")[:50]),
    }
    return render(request, "clinic/jobs.html", context)


def take_in(visit: Visit, fired: CaptureResult, by: Person | None) -> None:
    """Add the photographs of an accepted capture to a visit.

    Those of an earlier capture are set aside.

    Args:
        visit: the capture is in its session folder.
        fired: the accepted capture.
        by: the user.
    """
    record: dict[str, Any] = last_record(visit.folder) or {}
    with transaction.atomic():
        names = fired_files(visit.folder)
        for old in visit.uploads.exclude(state=Upload.State.SET_ASIDE):
            if old.state == Upload.State.PLACED and old.sha256 in names:
                old.name, old.state = names[old.sha256], Upload.State.SET_ASIDE
                old.save()
            else:
                thumbnail_path(old).unlink(missing_ok=True)
                old.delete()
        for camera, about in record["cameras"].items():
            path = visit.folder / "capture" / about["file"]
            upload = Upload.objects.create(
                visit=visit,
                camera=camera,
                name=f"capture/{path.name}",
                size_bytes=path.stat().st_size,
                received_bytes=path.stat().st_size,
                sha256=about["sha256"],
                state=Upload.State.PLACED,
                checks=_checks(fired, camera, about),
                created_by=by,
            )
            with Image.open(path, formats=FORMATS) as picture:
                small_picture(picture, thumbnail_path(upload))
        uploads.note_ready(visit, changed=True)


def _checks(fired: CaptureResult, camera: str, about: dict[str, Any]) -> list[dict[str, Any]]:
    own = [finding for who, finding in fired.verdict.findings if who == camera]
    fact = Finding("camera", "ok", "Taken by the rig, from this page.")
    # Times were checked when the capture was accepted, with better clocks than EXIF's.
    shared = {"serial": about["serial"], "taken_s": None, "named": None}
    return [{**finding.as_table(), **shared} for finding in (fact, *own)]


def visit_capture(request: HttpRequest, visit: UUID) -> HttpResponse:
    """The page for photographing a visit."""
    shown = get_object_or_404(Visit.objects.select_related("patient", "rig").exclude(rig=None), pk=visit)
    return render(request, "clinic/capture.html", {
        "visit": shown, "patient": shown.patient, "rig_verdict": today(rig_of(shown)),
        "driven": cameras.rig_file(rig_of(shown)) is not None,
    })  # fmt: skip


@json_view("GET")
def visit_state(request: HttpRequest, visit: UUID) -> HttpResponseBase:
    """State of the rig before a capture."""
    row = visit_or_404(visit)
    rig = rig_of(row)
    return JsonResponse(cameras.service_of(rig, row.calibration).state(rig.name, row.folder))


@json_view("POST")
def visit_look(request: HttpRequest, visit: UUID) -> HttpResponseBase:
    """Live picture of every camera, with drawn aids."""
    row = visit_or_404(visit)
    service = cameras.service_of(rig_of(row), row.calibration)
    return JsonResponse(service.look(request.body, subject_kind=row.subject_kind))


@json_view("POST")
def visit_fire(request: HttpRequest, visit: UUID) -> HttpResponseBase:
    """Capture pictures. Those that may be measured are added to the visit."""
    row = visit_or_404(visit)
    require_open(row)
    service = cameras.service_of(rig_of(row), row.calibration)
    uploads.ready_folder(row)
    try:
        require_replaceable(row.folder)
    except SessionError:
        raise Refused("This visit has uploaded photographs. Set them aside first, then fire.") from None
    fired = service.fire(row.folder, subject_id=row.patient.pseudonym)
    if fired.accepted:
        take_in(row, fired, person_of(request))
    where = reverse("visit", kwargs={"visit": row.pk})
    return JsonResponse({**firing_table(fired, "Press “Measure”, or fire again."), "visit": where})
