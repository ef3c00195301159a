"""Changes of jobs as server-sent events (HTML Standard, section 9.2).

One poll of the database serves all listeners, because any process may change the rows.
"""

import asyncio
import json
from collections.abc import AsyncIterator, Mapping
from contextlib import suppress
from datetime import timedelta
from typing import Any

from asgiref.sync import sync_to_async
from django.db import close_old_connections
from django.db.models import Q
from django.utils import timezone

from mammometry.clinic.jobs import queue
from mammometry.clinic.models import Job

_LOOK_S = 0.5  # between two polls
_STILL_S = 15.0  # without an event for this long, a line is sent to keep the connection open
_ENDED_S = 60.0  # time for which a finished job is still sent
OF_PATIENTS = ("visit", "comparison")
"""Subjects of jobs that concern a patient."""
_RETRY_MS = 2000  # time until a browser that lost the connection reconnects


def table_of(job: Job, place: int | None = None) -> dict[str, Any]:
    """A job as JSON, with the patient's pseudonym."""
    target = queue.target_of(job)
    fields = {"visit": job.visit_id, "calibration": job.calibration_id, "comparison": job.comparison_id}
    field = next((name for name, key in fields.items() if key), "check")
    visit = job.comparison.after if job.comparison is not None else job.visit
    return {
        "id": str(job.pk),
        "kind": job.kind,
        "for": field,
        "target": str(target.pk),
        "patient": None if visit is None else visit.patient.pseudonym,
        "state": job.state,
        "place": place,
        "attempt": job.attempt,
        "stage": job.stage,
        "stage_words": queue.stage_words(job.stage) if job.state in Job.OPEN else "",
        "fraction": round(job.fraction, 3),
        "message": job.message,
        "created": job.created.isoformat(),
        "started": None if job.started is None else job.started.isoformat(),
        "ended": None if job.ended is None else job.ended.isoformat(),
    }


def tables(jobs: list[Job]) -> list[dict[str, Any]]:
    """Jobs as JSON, each with its place in the queue. They must include all waiting ones."""
    waiting = sorted((job for job in jobs if job.state == Job.State.QUEUED), key=lambda job: (job.created, job.pk))
    places = {job.pk: place for place, job in enumerate(waiting, start=1)}
    return [table_of(job, places.get(job.pk)) for job in jobs]


def newest() -> dict[str, dict[str, Any]]:
    """Key → JSON of unfinished and recently finished jobs, oldest first."""
    since = timezone.now() - timedelta(seconds=_ENDED_S)
    jobs = (
        queue.computations()
        .filter(Q(state__in=Job.OPEN) | Q(ended__gt=since))
        .select_related("visit__patient", "comparison__after__patient", "calibration", "check_of_day")
        .order_by("created", "pk")
    )
    return {table["id"]: table for table in tables(list(jobs))}


class JobNews:
    """Distributes changes of jobs to listeners. There is one for each event loop."""

    def __init__(self) -> None:
        self.jobs: dict[str, dict[str, Any]] = {}
        self._changed = asyncio.Condition()
        self._listeners = 0
        self._poller: asyncio.Task[None] | None = None

    async def listen(self) -> AsyncIterator[Mapping[str, dict[str, Any]]]:
        """Yield the jobs now, after each change, and after a while without changes."""
        self._listeners += 1
        try:
            if self._poller is None or self._poller.done():
                self.jobs = await sync_to_async(_look)()
                self._poller = asyncio.create_task(self._poll())
            while True:
                yield self.jobs
                async with self._changed:
                    with suppress(TimeoutError):
                        await asyncio.wait_for(self._changed.wait(), _STILL_S)
        finally:
            self._listeners -= 1

    async def _poll(self) -> None:
        """Poll the rows while there are listeners."""
        while self._listeners:
            await asyncio.sleep(_LOOK_S)
            now = await sync_to_async(_look)()
            if now != self.jobs:
                self.jobs = now
                async with self._changed:
                    self._changed.notify_all()


def _look() -> dict[str, dict[str, Any]]:
    close_old_connections()
    return newest()


_boards: dict[int, JobNews] = {}


def board() -> JobNews:
    """The `JobNews` of this event loop."""
    loop = asyncio.get_running_loop()
    if (known := _boards.get(id(loop))) is None:
        _boards.clear()  # a closed loop has no listeners
        known = _boards[id(loop)] = JobNews()
    return known


async def stream(about: Mapping[str, str], *, visits: bool = True) -> AsyncIterator[bytes]:
    """Yield events of all unfinished jobs, or of those about one object, until the last has finished.

    Args:
        about: field of a job's JSON → the value that it must have; empty: all.
        visits: whether jobs of visits and of their comparisons are included.
    """
    sent: dict[str, dict[str, Any]] = {}
    number = 0
    yield f"retry: {_RETRY_MS}\n\n".encode()
    async for jobs in board().listen():
        mine = {
            key: job
            for key, job in jobs.items()
            if (visits or job["for"] not in OF_PATIENTS) and all(job[name] == value for name, value in about.items())
        }
        news = [job for key, job in mine.items() if sent.get(key) != job]
        for job in news:
            number += 1
            yield f"id: {number}\nevent: job\ndata: {json.dumps(job)}\n\n".encode()
        sent = mine
        if about and all(job["state"] not in Job.OPEN for job in mine.values()):
            yield b"event: end\ndata: {}\n\n"
            return
        if not news:
            yield b": still here\n\n"
