"""A visit's result.

Report, 3D view, boundaries and landmarks to draw or confirm.
"""

from __future__ import annotations

import hashlib
import uuid
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from threading import Lock
from typing import Any

from django.http import FileResponse, Http404, HttpRequest, HttpResponse, HttpResponseBase, JsonResponse
from django.shortcuts import get_object_or_404, render
from django.urls import reverse
from pydantic import ValidationError

from mammometry.base.errors import MammometryError
from mammometry.clinic.jobs import queue
from mammometry.clinic.jobs.events import table_of
from mammometry.clinic.models import Drawing, Visit
from mammometry.clinic.reports import report_file, scene_of
from mammometry.clinic.security import report_policy
from mammometry.clinic.site import the_clinic
from mammometry.clinic.views.who import person_of
from mammometry.editor.desk import Drawable
from mammometry.editor.page import EditorPage, refusal

_KEPT = 4  # surfaces in memory, about 300 MB each


class _Desks:
    """Surfaces that are drawn on, the last few.

    A new measurement makes a new one.
    """

    def __init__(self) -> None:
        self._held: OrderedDict[tuple[uuid.UUID, str], EditorPage] = OrderedDict()
        self._lock = Lock()

    def of(self, visit: Visit) -> EditorPage:
        """The visit's surface.

        Raises:
            MammometryError: the session cannot be opened, or has nothing to draw on.
        """
        measurement = visit.measurements.first()
        key = visit.pk, "" if measurement is None else measurement.digest
        with self._lock:
            page = self._held.pop(key, None) or EditorPage(_opened(visit))
            self._held[key] = page
            while len(self._held) > _KEPT:
                self._held.popitem(last=False)
        return page


_DESKS = _Desks()


def _opened(visit: Visit) -> Drawable:
    from mammometry.api.job import open_session
    from mammometry.api.mesh import scan_job

    settings = the_clinic().measuring()
    if visit.is_scan:
        return scan_job(visit.folder, visit.folder / "results", settings)
    return open_session(visit.folder, settings)


def report(request: HttpRequest, visit: uuid.UUID) -> HttpResponse:
    """The report, as the pipeline wrote it.

    Sealed off from the clinic's pages.
    """
    path = report_file(_visit(visit), "report.html")
    if path is None:
        raise Http404
    page = path.read_bytes()
    response = HttpResponse(page, content_type="text/html; charset=utf-8")
    response["Content-Security-Policy"] = report_policy(page)
    return response


def report_pdf(request: HttpRequest, visit: uuid.UUID) -> FileResponse:
    """The report on paper."""
    shown = _visit(visit)
    path = report_file(shown, "report.pdf")
    if path is None:
        raise Http404
    name = f"{shown.patient.pseudonym}_{shown.taken_at:%Y-%m-%d}.pdf"
    return FileResponse(path.open("rb"), as_attachment=True, filename=name)


def scene(request: HttpRequest, visit: uuid.UUID) -> HttpResponse:
    """The surface for the 3D view."""
    found = scene_of(_visit(visit))
    if found is None:
        raise Http404
    return HttpResponse(found, content_type="application/json")


def draw(request: HttpRequest, visit: uuid.UUID) -> HttpResponse:
    """The page on which boundaries and landmarks are drawn."""
    shown = _visit(visit)
    drawings = shown.drawings.select_related("by")[:20]
    return render(request, "clinic/draw.html", {"visit": shown, "patient": shown.patient, "drawings": drawings})


def drawing(request: HttpRequest, visit: uuid.UUID) -> HttpResponseBase:
    """Everything the page needs."""
    return _told(visit, lambda shown, page: {**page.drawing(str(request.user)), **_job_of(shown)})


def items(request: HttpRequest, visit: uuid.UUID) -> HttpResponseBase:
    """State of all boundaries and landmarks, and of the visit's job."""
    return _told(visit, lambda shown, page: {**page.items(), **_job_of(shown)})


def measure(request: HttpRequest, visit: uuid.UUID) -> HttpResponseBase:
    """Volumes of what is drawn, not kept."""
    return _told(visit, lambda shown, page: page.measure(request.body))


def save(request: HttpRequest, visit: uuid.UUID) -> HttpResponseBase:
    """Keep what was drawn, with name and time."""

    def saved(shown: Visit, page: EditorPage) -> dict[str, Any]:
        sent, changed = page.save(request.body, str(request.user))
        for breast, drawn in sent.boundaries.items():
            _note(request, shown, f"boundary {breast}", removed=drawn.sketch is None)
        for mark, place in sent.landmarks.items():
            _note(request, shown, f"landmark {mark}", removed=place.points is None)
        if changed:
            queue.enqueue(shown, person_of(request))
        return {"saved": len(changed), **page.items(), **_job_of(shown)}

    return _told(visit, saved)


def finish(request: HttpRequest, visit: uuid.UUID) -> HttpResponseBase:
    """Confirm all boundaries of the measured result, and name the next page."""

    def finished(shown: Visit, page: EditorPage) -> dict[str, Any]:
        curves = page.measured_curves(request.body)
        for breast, digest in curves.items():
            item = f"boundary {breast}"
            Drawing.objects.create(
                visit=shown, item=item, action=Drawing.Action.CONFIRMED, by=person_of(request), digest=digest
            )
        Visit.objects.filter(pk=shown.pk).update(state=Visit.State.CONFIRMED)
        waiting = Visit.objects.filter(state=Visit.State.MEASURED).exclude(pk=shown.pk).first()
        return {"next": reverse("draw", args=[waiting.pk]) if waiting else reverse("visit", args=[shown.pk])}

    return _told(visit, finished)


def _job_of(visit: Visit) -> dict[str, Any]:
    """What is being measured, for the page that waits for it."""
    job = visit.jobs.order_by("-created").first()
    return {"job": None if job is None else table_of(job, queue.place(job))}


def _note(request: HttpRequest, visit: Visit, item: str, *, removed: bool) -> None:
    action = Drawing.Action.REMOVED if removed else Drawing.Action.DRAWN
    name = "boundaries.json" if item.startswith("boundary") else "landmarks.json"
    Drawing.objects.create(
        visit=visit, item=item, action=action, by=person_of(request), digest=_digest(visit.folder / name)
    )


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def _told(visit: uuid.UUID, answer: Callable[[Visit, EditorPage], dict[str, Any]]) -> HttpResponseBase:
    """Answer as JSON.

    The sentence of a refusal is passed on.
    """
    shown = _visit(visit)
    try:
        return JsonResponse(answer(shown, _DESKS.of(shown)))
    except (MammometryError, ValidationError) as error:
        status, words = refusal(error)
        return JsonResponse(words, status=status)


def _visit(visit: uuid.UUID) -> Visit:
    found: Visit = get_object_or_404(Visit.objects.select_related("patient", "rig"), pk=visit)
    return found
