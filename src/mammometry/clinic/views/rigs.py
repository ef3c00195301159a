"""Pages of rigs: readiness, calibrations, drift, and the daily check."""

import uuid
from types import MappingProxyType
from typing import Any
from uuid import UUID

from django.contrib import messages
from django.http import Http404, HttpRequest, HttpResponse, HttpResponseBase, JsonResponse
from django.shortcuts import get_object_or_404, redirect, render
from django.urls import reverse

from mammometry.base.errors import MammometryError, SettingsError
from mammometry.calibration.targets.target import Target
from mammometry.capture.sessions import cameras_of, manifest_text
from mammometry.clinic import rig_history
from mammometry.clinic.intake import left_out
from mammometry.clinic.intake.photographs import screen_picture
from mammometry.clinic.intake.places import UploadError
from mammometry.clinic.intake.reassign import exchange_of_check, put_check_right
from mammometry.clinic.jobs import queue
from mammometry.clinic.models import Calibration, DailyCheck, Job, Rig
from mammometry.clinic.rig_form import RigForm, board_of, board_svg, is_measured
from mammometry.clinic.rig_history import drift_rows
from mammometry.clinic.rig_history import today as verdict_of
from mammometry.clinic.site import the_clinic
from mammometry.clinic.views.responses import download, form_page, json_view, person_of
from mammometry.io.manifest import MANIFEST
from mammometry.io.photographs.images import read_photograph
from mammometry.study.acceptance.tables import DECISION_WORDS, worst_errors
from mammometry.web.replies import Refused


def rigs(request: HttpRequest) -> HttpResponse:
    """All rigs with today's readiness."""
    rows = [(rig, verdict_of(rig) if rig.active else None) for rig in Rig.objects.all()]
    return render(request, "clinic/rigs.html", {"rows": rows})


def rig(request: HttpRequest, rig: uuid.UUID) -> HttpResponse:
    """One rig: readiness, calibrations, checks, drift."""
    shown = get_object_or_404(Rig, pk=rig)
    context = {
        "rig": shown,
        "verdict": verdict_of(shown),
        "calibrations": shown.calibrations.select_related("created_by")[:50],
        "checks": shown.checks.select_related("by")[:30],
        "drift": list(drift_rows(shown)),
        "tests": _tests(shown),
        "cameras": cameras_of(shown.definition),
        "doubted": _doubted(shown),
        "described": "rig" in shown.definition,
        "measured": is_measured(shown.definition),
    }
    return render(request, "clinic/rig.html", context)


_CHIPS = MappingProxyType({"accept": ("good", "✓"), "reject": ("bad", "✕"), "undecided": ("care", "!")})
"""Decision of an acceptance test → class and sign on the page."""


def _tests(rig: Rig) -> list[dict[str, Any]]:
    """The rig's acceptance tests with their largest errors, newest first."""
    return [
        {
            "date": test.date,
            "decision": DECISION_WORDS.get(test.decision, test.decision),
            "chip": _CHIPS.get(test.decision, _CHIPS["undecided"]),
            "errors": worst_errors(test),
        }
        for test in reversed(rig_history.acceptance_tests(rig))
    ]


def _doubted(rig: Rig) -> Calibration | None:
    """The calibration in use, if some of its photographs contradict others."""
    calibration = rig_history.current(rig)
    return calibration if calibration is not None and left_out.doubts_of(calibration) else None


def rig_form(request: HttpRequest, rig: uuid.UUID | None = None) -> HttpResponse:
    """Describe a rig, or change its name, note or description."""
    shown = None if rig is None else get_object_or_404(Rig, pk=rig)
    form = RigForm(request.POST or None, request.FILES or None, instance=shown)

    def goes_on(row: Rig) -> HttpResponse:
        if form.is_described_otherwise and rig_history.current(row) is not None:
            messages.warning(request, "Its cameras or its board have changed: calibrate it again.")
        return redirect("rig", rig=row.pk)

    return form_page(request, "clinic/rig_form.html", form, "The rig is saved.", goes_on, rig=shown)


def board(request: HttpRequest) -> HttpResponse:
    """A picture of the board being entered, SVG."""
    try:
        picture = board_svg(board_of(request.GET.dict()))
    except MammometryError as error:
        return HttpResponse(str(error), status=422, content_type="text/plain; charset=utf-8")
    return HttpResponse(picture, content_type="image/svg+xml", headers={"Cache-Control": "private, no-store"})


def session_toml(request: HttpRequest, rig: uuid.UUID) -> HttpResponse:
    """The rig's description as a session.toml, for the command line."""
    shown = get_object_or_404(Rig, pk=rig)
    try:
        return download(manifest_text(shown.definition, "torso", posture="unknown"), MANIFEST, "application/toml")
    except MammometryError as error:
        messages.error(request, f"The rig is not described yet: {error}")
        return redirect("rig", rig=shown.pk)


def calibration(request: HttpRequest, calibration: uuid.UUID) -> HttpResponse:
    """One calibration: its photographs, progress, figures and verdict."""
    shown = get_object_or_404(Calibration.objects.select_related("rig", "created_by"), pk=calibration)
    context = {
        "calibration": shown,
        "rig": shown.rig,
        "job": shown.jobs.order_by("-created").first(),
        "measured": is_measured(shown.rig.definition),
        "doubts": left_out.doubts_of(shown) if shown.state == Calibration.State.DONE else [],
        "left_out": left_out.left_out_of(shown) if shown.state == Calibration.State.DONE else [],
        "same_day": shown.rig.calibrations.filter(taken_at=shown.taken_at, state="done").exclude(pk=shown.pk),
        **_figures(shown.figures),
    }
    return render(request, "clinic/calibration.html", context)


def leave_out(request: HttpRequest, calibration: uuid.UUID) -> HttpResponse:
    """Calibrate again without the selected photographs."""
    shown = get_object_or_404(Calibration.objects.select_related("rig"), pk=calibration)
    if request.method != "POST":
        return redirect("calibration", calibration=shown.pk)
    try:
        made = left_out.calibrate_without(shown, request.POST.getlist("photograph"), person_of(request))
    except UploadError as error:
        messages.error(request, str(error))
        return redirect("calibration", calibration=shown.pk)
    queue.enqueue(made, person_of(request))
    messages.success(
        request,
        "The rig is being calibrated without the ticked photographs. The present calibration stays in use until then.",
    )
    return redirect("calibration", calibration=made.pk)


def use(request: HttpRequest, calibration: uuid.UUID) -> HttpResponse:
    """Use an earlier calibration again."""
    shown = get_object_or_404(Calibration.objects.select_related("rig"), pk=calibration)
    if request.method == "POST":
        try:
            left_out.use(shown)
        except UploadError as error:
            messages.error(request, str(error))
        else:
            messages.success(request, "New visits use this calibration.")
    return redirect("calibration", calibration=shown.pk)


def board_picture(request: HttpRequest, calibration: uuid.UUID, pose: str, camera: str) -> HttpResponse:
    """A photograph of the board that fills a screen."""
    photographs = left_out.board_photographs(get_object_or_404(Calibration, pk=calibration))
    photograph = photographs.get(f"{pose}/{camera}")
    if photograph is None:
        raise Http404
    try:
        picture = screen_picture(read_photograph(photograph.path, photograph.key))
    except MammometryError:
        raise Http404 from None
    return HttpResponse(picture, content_type="image/webp", headers={"Cache-Control": "private, no-store"})


def check(request: HttpRequest, check: uuid.UUID) -> HttpResponse:
    """Page of a daily check."""
    shown = get_object_or_404(DailyCheck.objects.select_related("rig", "by"), pk=check)
    context = {
        "check": shown,
        "rig": shown.rig,
        "job": shown.jobs.order_by("-created").first(),
        "exchange": exchange_of_check(shown),
        **_figures(shown.figures),
    }
    return render(request, "clinic/check.html", context)


def check_put_right(request: HttpRequest, check: uuid.UUID) -> HttpResponse:
    """Swap back the photographs of a check, and evaluate it again."""
    shown = get_object_or_404(DailyCheck.objects.select_related("rig", "calibration"), pk=check)
    if request.method == "POST" and shown.jobs.filter(state__in=Job.OPEN).exists():
        messages.error(request, "This is being evaluated. Wait until it is done.")
    elif request.method == "POST":
        try:
            put_check_right(shown)
        except UploadError as error:
            messages.error(request, str(error))
        else:
            queue.enqueue(shown, person_of(request))
    return redirect("check", check=shown.pk)


_SINGLE = (
    ("rms_px", "Reprojection error, RMS", "{:.2f} px"),
    ("rms_mm", "The same on the subject, RMS", "{:.2f} mm"),
    ("worst_pair_mm", "Expected error of the worst pair", "{:.2f} mm"),
    ("volume_coverage", "Share of the working volume covered by the board", "{:.0%}"),
    ("poses", "Poses of the board", "{}"),
    ("effect_mm", "Effect of the movement on a length", "{:.2f} mm"),
    ("limit_mm", "Allowed", "{:.2f} mm"),
)
_BY_CAMERA = (
    ("rms_px_of", "Reprojection error by camera", "{:.2f} px"),
    ("expected_mm_of", "Expected error by pair", "{:.2f} mm"),
    ("coverage_of", "Share of the picture covered by the board, by camera", "{:.0%}"),
)


def _figures(figures: dict[str, Any]) -> dict[str, Any]:
    """Figures of a calibration or check as text, with units."""
    single = [(title, form.format(figures[key])) for key, title, form in _SINGLE if figures.get(key) is not None]
    tables = [
        (
            title,
            [
                (camera.replace("_", " "), form.format(value))
                for camera, value in figures[key].items()
                if value is not None
            ],
        )
        for key, title, form in _BY_CAMERA
        if figures.get(key)
    ]
    return {"figures": single, "tables": tables}


@json_view("GET")
def today(request: HttpRequest, rig: UUID) -> HttpResponseBase:
    """Whether a rig may be used today, as JSON."""
    return JsonResponse(rig_history.today(get_object_or_404(Rig, pk=rig)).as_table())


@json_view("GET")
def drift(request: HttpRequest, rig: UUID) -> HttpResponseBase:
    """The chart of the rig's checks, PNG."""
    from mammometry.report.figures.calibration import drift as drawn

    entries = rig_history.entries(get_object_or_404(Rig, pk=rig))
    if not entries:
        raise Http404
    picture = drawn(entries, the_clinic().measuring().calibration.check.refuse_mm)
    return HttpResponse(picture, content_type="image/png", headers={"Cache-Control": "private, no-store"})


@json_view("POST")
def new_calibration(request: HttpRequest, rig: UUID) -> HttpResponseBase:
    """Create a calibration to upload photographs to."""
    made = rig_history.new_calibration(get_object_or_404(Rig, pk=rig), request.user)
    return JsonResponse(
        {"id": str(made.pk), "url": reverse("calibration-uploads", kwargs={"calibration": made.pk})}, status=201
    )


@json_view("POST")
def new_check(request: HttpRequest, rig: UUID) -> HttpResponseBase:
    """Create a daily check to upload photographs to."""
    made = rig_history.new_check(get_object_or_404(Rig, pk=rig), request.user)
    if made is None:
        raise Refused("This rig is not calibrated. Calibrate it first.")
    return JsonResponse({"id": str(made.pk), "url": reverse("check-uploads", kwargs={"check": made.pk})}, status=201)


_MEASURED = ("edge_mm", "edge_std_mm", "flatness_mm")
"""Keys of a description that concern an earlier print. The board is drawn at its nominal size."""


def target(request: HttpRequest, rig: uuid.UUID) -> HttpResponse:
    """The calibration board of the rig's description as a PDF at true scale."""
    from mammometry.calibration.targets.table import target_from_table

    shown = get_object_or_404(Rig, pk=rig)
    table = {key: value for key, value in shown.definition.get("target", {}).items() if key not in _MEASURED}
    try:
        content = _on_smallest_page(target_from_table(table))
    except MammometryError as error:
        messages.error(request, f"The board cannot be drawn: {error}")
        return redirect("rig", rig=shown.pk)
    name = f"board-{shown.pk}.pdf"
    return HttpResponse(
        content, content_type="application/pdf", headers={"Content-Disposition": f'inline; filename="{name}"'}
    )


def _on_smallest_page(target: Target) -> bytes:
    """The board on the smallest usual page on which it fits, or else on a page of its own size."""
    from mammometry.calibration.targets.pdf import target_pdf

    for page in ("A4", "A3", "A2", "A1", "A0"):
        try:
            return target_pdf(target, page=page)
        except SettingsError:
            continue
    return target_pdf(target)
