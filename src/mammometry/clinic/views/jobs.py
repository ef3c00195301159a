"""Requests about jobs: queue, cancel, retry and follow them."""

from collections.abc import AsyncIterator
from uuid import UUID

from django.http import HttpRequest, HttpResponseBase, JsonResponse, StreamingHttpResponse
from django.shortcuts import get_object_or_404

from mammometry.clinic.jobs import events, queue
from mammometry.clinic.jobs.results import Target
from mammometry.clinic.models import Calibration, DailyCheck, Job, Person
from mammometry.clinic.rig_history import may_queue
from mammometry.clinic.roles import CARE
from mammometry.clinic.views.responses import json_body, json_view, require_care, visit_or_404
from mammometry.web.replies import Refused

_MOST = 200  # most jobs in one answer


@json_view("POST")
def measure(request: HttpRequest, visit: UUID) -> HttpResponseBase:
    """Measure a visit."""
    return _queued(request, visit_or_404(visit), anyway=json_body(request).get("anyway") is True)


@json_view("POST")
def calibrate(request: HttpRequest, calibration: UUID) -> HttpResponseBase:
    """Calibrate a rig."""
    return _queued(request, get_object_or_404(Calibration.objects.select_related("rig"), pk=calibration))


@json_view("POST")
def check(request: HttpRequest, check: UUID) -> HttpResponseBase:
    """Evaluate a daily check."""
    return _queued(request, get_object_or_404(DailyCheck.objects.select_related("rig", "calibration"), pk=check))


@json_view("GET")
def many(request: HttpRequest) -> HttpResponseBase:
    """The newest jobs, or all unfinished ones."""
    rows = (
        queue.of_visits_in_use()
        .select_related("visit__patient", "comparison__after__patient", "calibration", "check_of_day")
        .order_by("-created")
    )
    if request.GET.get("state") == "open":
        rows = rows.filter(state__in=Job.OPEN)
    waiting = queue.computations().filter(state=Job.State.QUEUED).count()
    running = queue.computations().filter(state=Job.State.RUNNING).count()
    return JsonResponse({"jobs": events.tables(list(rows[:_MOST])), "queued": waiting, "running": running})


@json_view("GET")
def one(request: HttpRequest, job: UUID) -> HttpResponseBase:
    """A job as JSON."""
    return _job_response(_find(request, job))


@json_view("POST")
def cancel(request: HttpRequest, job: UUID) -> HttpResponseBase:
    """Remove a job from the queue, or stop it."""
    row = _find(request, job)
    if not queue.cancel(row):
        raise Refused("This has already ended.")
    return _job_response(row)


@json_view("POST")
def retry(request: HttpRequest, job: UUID) -> HttpResponseBase:
    """Queue a job's computation again."""
    row = _find(request, job)
    if row.state in Job.OPEN:
        raise Refused("This has not ended yet.")
    return _queued(request, queue.target_of(row), anyway=True)


async def stream(request: HttpRequest) -> HttpResponseBase:
    """Changes of jobs, as server-sent events."""
    about = {}
    for name, field in (("visit", "target"), ("calibration", "target"), ("check", "target"), ("job", "id")):
        if text := request.GET.get(name):
            try:
                about[field] = str(UUID(text))
            except ValueError:
                return JsonResponse({"error": f"{name} is no id."}, status=400)
    person = await request.auser()
    assert isinstance(person, Person)
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    body: AsyncIterator[bytes] = events.stream(about, visits=person.has_role(*CARE))
    return StreamingHttpResponse(body, content_type="text/event-stream", headers=headers)


def _find(request: HttpRequest, key: UUID) -> Job:
    rows = queue.computations().select_related("visit__patient", "visit__rig", "visit__calibration", "calibration__rig")
    row: Job = get_object_or_404(rows, pk=key)
    require_care(request, queue.target_of(row))
    return row


def _queued(request: HttpRequest, target: Target, *, anyway: bool = False) -> JsonResponse:
    why = may_queue(target, anyway=anyway)
    if why is not None:
        raise Refused(why)
    job = queue.enqueue(target, request.user)  # type: ignore[arg-type]  # logged in
    return _job_response(job, 202)


def _job_response(job: Job, status: int = 200) -> JsonResponse:
    return JsonResponse(events.table_of(job, queue.place(job)), status=status)
