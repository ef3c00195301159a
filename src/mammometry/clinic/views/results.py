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
from pydantic import ValidationError

from mammometry.base.errors import MammometryError
from mammometry.clinic.models import Drawing, Visit
from mammometry.clinic.reports import report_file, scene_of
from mammometry.clinic.security import report_policy
from mammometry.clinic.site import the_clinic
from mammometry.clinic.views.who import person_of
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
        from mammometry.api.job import open_session

        measurement = visit.measurements.first()
        whose = f"{visit.patient.pseudonym} {visit.taken_at.isoformat()}"  # both can be corrected
        key = visit.pk, f"{whose} {'' if measurement is None else measurement.digest}"
        with self._lock:
            page = self._held.pop(key, None) or EditorPage(open_session(visit.folder, the_clinic().measuring()))
            self._held[key] = page
            while len(self._held) > _KEPT:
                self._held.popitem(last=False)
        return page


_DESKS = _Desks()


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
    return _told(visit, lambda shown, page: page.drawing(str(request.user)))


def items(request: HttpRequest, visit: uuid.UUID) -> HttpResponseBase:
    """State of all boundaries and landmarks."""
    return _told(visit, lambda shown, page: page.items())


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
        if shown.state == Visit.State.CONFIRMED:
            Visit.objects.filter(pk=shown.pk).update(state=Visit.State.MEASURED)
        return {"saved": [path.name for path in changed], **page.items()}

    return _told(visit, saved)


def confirm(request: HttpRequest, visit: uuid.UUID) -> HttpResponseBase:
    """Keep that somebody looked at a boundary and found it right.

    The visit is confirmed when all boundaries are.
    """

    def confirmed(shown: Visit, page: EditorPage) -> dict[str, Any]:
        sent = page.confirm(request.body, str(request.user))
        Drawing.objects.create(
            visit=shown,
            item=f"boundary {sent.name}",
            action=Drawing.Action.CONFIRMED,
            by=person_of(request),
            digest=sent.curve,
        )
        state = page.items()
        seen = [each.get("confirmed") for each in state["boundaries"].values() if "curve" in each]
        if seen and all(each is not None and each["holds"] for each in seen):
            Visit.objects.filter(pk=shown.pk).update(state=Visit.State.CONFIRMED)
        return state

    return _told(visit, confirmed)


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
