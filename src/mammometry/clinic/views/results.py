"""A visit's result: report, 3D view, boundaries to draw or confirm, comparison of two dates."""

import hashlib
import logging
import uuid
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from threading import Lock
from typing import Any

from django.contrib import messages
from django.http import Http404, HttpRequest, HttpResponse, HttpResponseBase, JsonResponse
from django.shortcuts import get_object_or_404, redirect, render
from django.urls import reverse
from django.utils.html import format_html
from django.utils.safestring import mark_safe
from pydantic import ValidationError

from mammometry.api.job import Job as Measuring
from mammometry.api.job import drawable
from mammometry.base.errors import MammometryError, StorageError
from mammometry.clinic.jobs import queue
from mammometry.clinic.jobs.events import table_of
from mammometry.clinic.models import Comparison, Confirmation, Drawing, Job, Patient, Upload, Visit
from mammometry.clinic.records import comparing, confirmations
from mammometry.clinic.records.results import readable, rendered_report, report_file, scene_of, sides_doubtful
from mammometry.clinic.rig_history import may_queue
from mammometry.clinic.site import the_clinic
from mammometry.clinic.templatetags.pages import isolated, queued
from mammometry.clinic.views.responses import download, not_now, person_of, sealed_page, visit_or_404
from mammometry.editor.messages import Base, Breast, EditorMessage
from mammometry.editor.page import EditorPage, read
from mammometry.io.drawn_changes import Group, drawn_entries, entry_digest
from mammometry.job.inputs import SubjectKind
from mammometry.report.scene import SCENE, json_in_page
from mammometry.web.replies import refusal

_LOG = logging.getLogger(__name__)
_KEPT = 4  # surfaces in memory, about 300 MB each


class ShownItems(EditorMessage):
    """Versions of all items on the page.

    Name → digest (`entry_digest`), or None if not in the session.
    """

    boundaries: dict[Breast, Base]
    landmarks: dict[str, Base]


class FinishMessage(EditorMessage):
    """Confirmation of all items on the page, in one step."""

    curves: dict[Breast, str]
    """Breast → digest of the checked, measured curve."""
    base: ShownItems
    author: str = ""
    """Not used: the logged-in person confirms."""


class _Desks:
    """Cache of recently used drawing surfaces. A new measurement replaces the visit's surface."""

    def __init__(self) -> None:
        self._held: OrderedDict[tuple[uuid.UUID, str], EditorPage] = OrderedDict()
        self._lock = Lock()

    def of(self, visit: Visit) -> EditorPage:
        """The visit's surface for drawing. It is opened once.

        Raises:
            MammometryError: the session cannot be opened, or has nothing to draw on.
        """
        measurement = visit.measurements.first()
        whose = f"{visit.patient.pseudonym} {visit.taken_at.isoformat()}"  # both can be corrected
        key = visit.pk, f"{whose} {'' if measurement is None else measurement.digest}"
        with self._lock:
            page = self._held.pop(key, None) or EditorPage(_opened(visit))
            self._held[key] = page
            while len(self._held) > _KEPT:
                self._held.popitem(last=False)
        return page


_DESKS = _Desks()


def _opened(visit: Visit) -> Measuring:
    return drawable(visit.folder, the_clinic().measuring())


def report(request: HttpRequest, visit: uuid.UUID) -> HttpResponse:
    """The report with names, confirmation and conclusion, isolated from the clinic's pages by a sandbox."""
    try:
        return sealed_page(rendered_report(_measured(visit)).html)
    except MammometryError as error:
        return not_now(request, error)


def report_pdf(request: HttpRequest, visit: uuid.UUID) -> HttpResponse:
    """The visit's report as PDF."""
    shown = _measured(visit)
    try:
        document = rendered_report(shown).pdf
    except MammometryError as error:
        return not_now(request, error)
    return download(document, f"{shown.patient.pseudonym}_{shown.taken_at:%Y-%m-%d}.pdf", "application/pdf")


def scene(request: HttpRequest, visit: uuid.UUID) -> HttpResponse:
    """The surface for the 3D view."""
    content = scene_of(visit_or_404(visit))
    if content is None:
        raise Http404
    return HttpResponse(content, content_type="application/json")


def draw(request: HttpRequest, visit: uuid.UUID) -> HttpResponse:
    """The page for drawing boundaries and landmarks. Not available while the visit is being measured."""
    shown = visit_or_404(visit)
    if shown.jobs.filter(state__in=Job.OPEN).exists() or not shown.measurements.exists():
        busy = shown.state == Visit.State.QUEUED
        messages.info(
            request, "This visit is being measured. Its boundaries are shown afterwards."
            if busy else "This visit is not measured yet, so it has no boundaries.",
        )  # fmt: skip
        return redirect("visit", visit=shown.pk)
    drawings = shown.drawings.select_related("by")[:20]
    return render(request, "clinic/draw.html", {"visit": shown, "patient": shown.patient, "drawings": drawings})


def drawing(request: HttpRequest, visit: uuid.UUID) -> HttpResponseBase:
    """All data that the page needs."""
    return _session_response(visit, lambda shown, page, job: _with_visit(shown, page.drawing(str(request.user)), job))


def items(request: HttpRequest, visit: uuid.UUID) -> HttpResponseBase:
    """State of all boundaries and landmarks."""
    return _session_response(visit, lambda shown, page, job: _with_visit(shown, page.items(), job))


def measure(request: HttpRequest, visit: uuid.UUID) -> HttpResponseBase:
    """Volumes for the present drawing. They are not stored."""
    return _session_response(visit, lambda shown, page, job: page.measure(request.body))


def save(request: HttpRequest, visit: uuid.UUID) -> HttpResponseBase:
    """Save the drawing with the person's name and the time, and measure it."""

    def saved(shown: Visit, page: EditorPage, _: Job | None) -> dict[str, Any]:
        # A measurement that ends now waits for the lock, and then finds that the drawing has changed.
        locked = Visit.objects.select_for_update().get(pk=shown.pk)
        sent, changed = page.save(request.body, str(request.user))
        if changed:
            for breast, drawn in sent.boundaries.items():
                _note(request, shown, f"boundary {breast}", removed=drawn.sketch is None)
            for mark, place in sent.landmarks.items():
                _note(request, shown, f"landmark {mark}", removed=place.points is None)
            _set_state(locked, Visit.State.CHANGED)
            if may_queue(locked, anyway=True) is None:
                try:
                    queue.enqueue(locked, person_of(request))
                    _set_state(locked, Visit.State.QUEUED)
                except StorageError as error:  # the drawing is saved and can be measured later
                    _LOG.error("%s", error)
        return {"saved": len(changed), **_with_visit(locked, page.items(), _newest_job(locked))}

    return _session_response(visit, saved)


def finish(request: HttpRequest, visit: uuid.UUID) -> HttpResponseBase:
    """Confirm all boundaries and landmarks in one step.

    The visit's page then offers the conclusion and the next visit.
    """
    locked = get_object_or_404(Visit.objects.select_for_update(), pk=visit)
    kind: SubjectKind = "model" if locked.subject_kind == Visit.Subject.MODEL else "torso"
    try:
        sent = read(FinishMessage, request.body)
        entries = drawn_entries(locked.folder, kind)
    except (MammometryError, ValidationError) as error:
        status, words = refusal(error)
        return JsonResponse(words, status=status)
    groups: dict[Group, Any] = {"boundaries": sent.base.boundaries, "landmarks": sent.base.landmarks}
    on_page = {(group, name): base for group, items in groups.items() for name, base in items.items() if base}
    why = confirmations.refusal(locked, {str(name): digest for name, digest in sent.curves.items()})
    if why is None and sides_doubtful(locked):
        why = "Left and right of this scan may be exchanged. First compare them with the patient, on the visit's page."
    if why is None and on_page != {item: entry_digest(entry) for item, entry in entries.items()}:
        why = "Somebody else has changed a boundary or landmark. Reload the page and check it."
    if why is not None:
        return JsonResponse({"error": why}, status=409)
    confirmations.confirm(locked, person_of(request))
    messages.success(request, _what_follows(confirmations.next_to_confirm(locked)))
    return JsonResponse({"next": reverse("visit", args=[locked.pk])})


def _what_follows(following: Visit | None) -> str:
    conclude = mark_safe('Confirmed. <a href="#conclusion">Write the conclusion</a>')  # no part of it is typed
    if following is None:
        return format_html("{}. No other visit to confirm.", conclude)
    where = reverse("draw", args=[following.pk])
    return format_html('{} · <a href="{}">Next visit ({})</a>', conclude, where, isolated(following.patient))


def _newest_job(visit: Visit) -> Job | None:
    return visit.jobs.filter(kind=Job.Kind.MEASURE).order_by("-created").first()


def _with_visit(visit: Visit, state: dict[str, Any], job: Job | None) -> dict[str, Any]:
    """A page's state with its measurement and confirmation.

    ``visit`` has the visit's state, whether its newest drawing is not measured yet (``changed``), and the digests of
    the measured boundaries (``curves``). ``job`` is its newest job, read before the state.
    """
    measurement = visit.measurements.first()
    confirmation = Confirmation.objects.filter(measurement__visit=visit).select_related("by").first()
    for name, boundary in state["boundaries"].items():
        if confirmation is not None and "of" in boundary:
            holds = confirmation.curves.get(name) == boundary["of"]
            at = confirmation.at.isoformat(timespec="seconds")
            boundary["confirmed"] = {"by": str(confirmation.by or ""), "at": at, "holds": holds}
    curves = {} if measurement is None else measurement.curves
    return {
        **state,
        "job": None if job is None else table_of(job, queue.place(job)),
        "visit": {"state": visit.state, "changed": visit.is_changed, "curves": curves},
    }


def _set_state(visit: Visit, state: Visit.State) -> None:
    visit.state = state
    visit.save(update_fields=["state"])


def _note(request: HttpRequest, visit: Visit, item: str, *, removed: bool) -> None:
    action = Drawing.Action.REMOVED if removed else Drawing.Action.DRAWN
    name = "boundaries.json" if item.startswith("boundary") else "landmarks.json"
    Drawing.objects.create(
        visit=visit, item=item, action=action, by=person_of(request), digest=_digest(visit.folder / name)
    )


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def _session_response(
    visit: uuid.UUID, answer: Callable[[Visit, EditorPage, Job | None], dict[str, Any]]
) -> HttpResponseBase:
    """Answer as JSON. The message of a refusal is included."""
    shown = visit_or_404(visit)
    job = _newest_job(shown)  # read the job first, then its numbers
    try:
        return JsonResponse(answer(shown, _DESKS.of(shown), job))
    except (MammometryError, ValidationError) as error:
        status, words = refusal(error)
        words["error"] = words["error"].replace(f"{the_clinic().folder}/", "")  # the path must not be revealed
        return JsonResponse(words, status=status)


def _measured(visit: uuid.UUID) -> Visit:
    """A visit that has a report."""
    shown = visit_or_404(visit)
    if report_file(shown, "report.html") is None:
        raise Http404
    return shown


Pair = tuple[Upload | None, Upload | None]


def compare(request: HttpRequest, patient: uuid.UUID) -> HttpResponse:
    """Choose two dates to compare."""
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
            response["HX-Refresh"] = "true"  # the 3D viewer is loaded with the page
        return response
    return render(request, "clinic/compare.html", context)


def photographs(before: Visit, after: Visit) -> list[tuple[str, Pair]]:
    """Camera → its photographs at both dates, for cameras with at least one photograph."""
    of_visits = [
        {upload.camera: upload for upload in visit.uploads.filter(state=Upload.State.PLACED)}
        for visit in (before, after)
    ]
    cameras = sorted(of_visits[0].keys() | of_visits[1].keys())
    return [(camera, (of_visits[0].get(camera), of_visits[1].get(camera))) for camera in cameras]


def compare_page(request: HttpRequest, patient: uuid.UUID, before: uuid.UUID, after: uuid.UUID) -> HttpResponse:
    """The full page of a comparison, with its pictures."""
    return sealed_page(_page(patient, before, after).read_bytes())


def compare_scene(request: HttpRequest, patient: uuid.UUID, before: uuid.UUID, after: uuid.UUID) -> HttpResponse:
    """Both aligned surfaces for the 3D view."""
    page = _page(patient, before, after)
    path = readable(page.with_name(SCENE))
    # Version 1.0 stored the scene only inside the page.
    scene = json_in_page(page.read_text(encoding="utf-8")) if path is None else path.read_bytes()
    if scene is None:
        raise Http404
    return HttpResponse(scene, content_type="application/json")


def _page(patient: uuid.UUID, before: uuid.UUID, after: uuid.UUID) -> Path:
    """The page of the comparison of the newest measurements."""
    row = get_object_or_404(
        Comparison.objects.select_related("before", "after"), before=before, after=after, after__patient=patient
    )
    path = readable(comparing.comparison_folder(row.before, row.after) / "compare.html")
    if path is None or row.state != Comparison.State.DONE or not comparing.is_current(row):
        raise Http404
    return path


def visit_verdict(request: HttpRequest, visit: uuid.UUID) -> HttpResponse:
    """The verdict against the previous visit, as a part of the visit's page."""
    return render(request, "clinic/visit_verdict.html", {"visit": get_object_or_404(Visit, pk=visit)})


def patient_changes(request: HttpRequest, patient: uuid.UUID) -> HttpResponse:
    """The verdicts from visit to visit, as a part of the patient's page."""
    return render(request, "clinic/patient_changes.html", {"patient": get_object_or_404(Patient, pk=patient)})


def _of(visits: list[Visit], key: str | None) -> Visit:
    visit = next((visit for visit in visits if str(visit.pk) == key), None)
    if visit is None:
        raise Http404
    return visit
