"""The queue: rows in the database, claimed by runners with leases.

All background work is done by jobs: computations, deliveries to archives, backups and restore tests.

A job belongs to the runner that changed its row from queued to running; the database allows only one to do so. The
runner renews its lease while it is alive. When it dies, the lease expires, and the job is queued again. A job's result
is stored in the transaction that ends the job, and only by the runner that still holds it.
"""

import datetime
import os
import platform
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any
from uuid import NAMESPACE_OID, UUID, uuid4, uuid5

from django.db import IntegrityError, transaction
from django.db.models import F, Q, QuerySet
from django.db.models.functions import Greatest
from django.utils import timezone

from mammometry.capture.sessions import make_session, manifest_text
from mammometry.clinic.jobs import results
from mammometry.clinic.jobs.results import Target
from mammometry.clinic.models import Calibration, Comparison, DailyCheck, Delivery, Job, Person, Visit
from mammometry.clinic.records import comparing
from mammometry.clinic.site import the_clinic
from mammometry.io.subject import rename_subject

LEASE_S = 45.0
"""Time without a renewal after which a runner is considered dead. It renews its leases three times as often."""
_GAVE_UP_DAYS = 30  # jobs that failed for good are shown to administrators for this long
_STOPPED_S = 10.0  # time for stopping the process of a cancelled job
_KINDS: Mapping[type, tuple[str, str]] = {
    Visit: (Job.Kind.MEASURE, "visit"),
    Calibration: (Job.Kind.CALIBRATE, "calibration"),
    DailyCheck: (Job.Kind.CHECK, "check_of_day"),
    Comparison: (Job.Kind.COMPARE, "comparison"),
    Delivery: (Job.Kind.SEND, "delivery"),
}
COMPUTED = (Job.Kind.MEASURE, Job.Kind.CALIBRATE, Job.Kind.CHECK, Job.Kind.COMPARE)
"""Kinds that workers compute, and that pages show as jobs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Retries:
    """How often a job is attempted, and when it is attempted again."""

    most: int = 3
    """Most attempts."""
    first_wait: datetime.timedelta | None = None
    """Wait after the first failure, doubled after each further one. None: errors are final, unless the runner died."""
    longest_wait: datetime.timedelta = datetime.timedelta(hours=1)

    def wait(self, attempt: int) -> datetime.timedelta:
        """Wait after this number of attempts."""
        return min((self.first_wait or datetime.timedelta()) * 2 ** (attempt - 1), self.longest_wait)


_RETRIES = {
    Job.Kind.SEND: Retries(most=8, first_wait=datetime.timedelta(minutes=1)),  # retried for three hours
    Job.Kind.BACKUP: Retries(first_wait=datetime.timedelta(minutes=10)),  # the disk may be full or missing for a moment
}
_AN_ERROR_IS_FINAL = Retries()
_AGAIN: dict[str, Any] = {
    "state": Job.State.QUEUED, "lease_owner": "", "lease_until": None, "stage": "", "fraction": 0.0,
}  # fmt: skip
"""Values of a job that is queued again."""
_WORDS = {
    "": "Waiting",
    "wait": "Waiting for a free place",
    "start": "Starting",
    "prepare": "Preparing",
    "board": "Finding the board in the photographs",
    "calibrate": "Calibrating the cameras",
    "match": "Matching the photographs",
    "surface": "Building the surface",
    "measure": "Measuring",
    "report": "Writing the report",
    "check": "Looking for the board",
    "compare": "Comparing both dates",
}


def stage_words(stage: str) -> str:
    """Name of a stage, as shown on pages."""
    return _WORDS.get(stage, stage)


def target_of(job: Job) -> Target:
    """The record that a computation belongs to."""
    target = job.visit or job.calibration or job.check_of_day or job.comparison
    assert target is not None
    return target


def _about(job: Job) -> Target | Delivery | None:
    """The record that a job belongs to. None for a backup or a restore test."""
    return target_of(job) if job.kind in COMPUTED else job.delivery


def retries_of(job: Job) -> Retries:
    """How often jobs of this kind are attempted."""
    return _RETRIES.get(Job.Kind(job.kind), _AN_ERROR_IS_FINAL)


def enqueue(target: Target | Delivery, by: Person | None) -> Job:
    """Queue a computation for a visit, calibration, daily check or comparison, or a delivery.

    If one is already waiting or running, it is returned.

    Raises:
        StorageError: the disk is full or refuses.
    """
    kind, field = _KINDS[type(target)]
    about: dict[str, Any] = {field: target}
    open_one = Job.objects.filter(**about, state__in=Job.OPEN).first()
    if open_one is not None:
        return open_one
    if isinstance(target, Visit):
        carry_subject(target)
    if isinstance(target, Calibration) and "rig" in target.rig.definition:  # the board may have been measured since
        make_session(the_clinic().folder / target.folder, manifest_text(target.rig.definition, "torso"))
    try:
        with transaction.atomic():
            job = Job.objects.create(**about, kind=kind, created_by=by)
            results.queued(target)
    except IntegrityError:  # another process queued it at the same time
        return Job.objects.get(**about, state__in=Job.OPEN)
    return job


def enqueue_upkeep(kind: Job.Kind, by: Person | None, *, once: str = "") -> None:
    """Queue a backup or a restore test, unless one is open. One that waits for later becomes due now.

    Args:
        kind: kind of the job.
        by: person who requested it.
        once: key under which it is queued only once, however often this is called. Empty: no limit.
    """
    key = uuid5(NAMESPACE_OID, once) if once else uuid4()
    if not once:
        Job.objects.filter(kind=kind, state=Job.State.QUEUED, due__gt=timezone.now()).update(due=timezone.now())
    if Job.objects.filter(Q(pk=key) | Q(kind=kind, state__in=Job.OPEN)).exists():
        return
    with suppress(IntegrityError), transaction.atomic():  # another process queued it at the same time
        Job.objects.create(pk=key, kind=kind, created_by=by)


def compare(before: Visit, after: Visit, by: Person | None) -> None:
    """Queue the comparison of two visits, unless their newest measurements have one."""
    if not comparing.may_compare(before, after):
        return
    comparison, _ = Comparison.objects.get_or_create(before=before, after=after)
    if not comparing.is_current(comparison):
        enqueue(comparison, by)


def carry_subject(visit: Visit) -> None:
    """Update pseudonym and day in a visit's folder after a correction.

    Results of another patient are deleted.

    Raises:
        StorageError: the disk is full or refuses.
    """
    rename_subject(visit.folder, visit.patient.pseudonym, timezone.localdate(visit.taken_at))


def retry(job: Job, by: Person | None) -> Job:
    """Queue a job's computation again."""
    return enqueue(target_of(job), by)


def cancel(job: Job) -> bool:
    """Remove a job from the queue, or stop it. Returns whether it was still open."""
    with transaction.atomic():
        done = Job.objects.filter(pk=job.pk, state__in=Job.OPEN).update(state=Job.State.CANCELLED, ended=timezone.now())
        if done:
            results.cancelled(target_of(job))
    job.refresh_from_db()
    return bool(done)


def computations() -> QuerySet[Job]:
    """Jobs that workers compute."""
    return Job.objects.filter(kind__in=COMPUTED)


def of_visits_in_use() -> QuerySet[Job]:
    """Jobs as shown on pages: computations, without those of visits in the bin."""
    return computations().filter(
        visit__binned_at=None, comparison__before__binned_at=None, comparison__after__binned_at=None
    )


def place(job: Job) -> int | None:
    """Place in the queue, from 1. None if it is not waiting."""
    if job.state != Job.State.QUEUED:
        return None
    before = Q(created__lt=job.created) | Q(created=job.created, pk__lt=job.pk)
    return 1 + computations().filter(before, state=Job.State.QUEUED).count()


def gave_up() -> list[Job]:
    """Jobs of the last days that failed after all attempts, newest first.

    Jobs that a later job has replaced are left out.
    """
    since = timezone.now() - datetime.timedelta(days=_GAVE_UP_DAYS)
    failed = Job.objects.filter(state=Job.State.FAILED, ended__gt=since).order_by("-ended")
    about = ("kind", "visit", "calibration", "check_of_day", "comparison", "delivery")
    return [
        job
        for job in failed.select_related("delivery__destination")
        if job.attempt >= retries_of(job).most
        and not Job.objects.filter(**{field: getattr(job, field) for field in about}, created__gt=job.created).exists()
    ]


# --- for runners ---


def anything() -> bool:
    """Whether any computation is queued."""
    return _due(COMPUTED).exists()


def is_busy(*kinds: Job.Kind) -> bool:
    """Whether a job of these kinds is running or due. Jobs that wait for another attempt do not count."""
    return _due(kinds).exists() or Job.objects.filter(kind__in=kinds, state=Job.State.RUNNING).exists()


def _due(kinds: Collection[str]) -> QuerySet[Job]:
    """Jobs that may be started. Deliveries of visits in the bin may not."""
    return Job.objects.filter(
        state=Job.State.QUEUED, kind__in=kinds, due__lte=timezone.now(), delivery__visit__binned_at=None
    )


def claim(owner: str, room: int, kinds: Collection[str] = COMPUTED) -> list[Job]:
    """Take up to `room` jobs of these kinds, which no other runner then gets.

    Those that have been due longest come first.
    """
    now = timezone.now()
    taken: list[Job] = []
    for job in _due(kinds).order_by("due", "created", "pk")[: 2 * room]:
        if len(taken) == room:
            break
        won = Job.objects.filter(pk=job.pk, state=Job.State.QUEUED).update(
            state=Job.State.RUNNING,
            lease_owner=owner,
            lease_until=now + datetime.timedelta(seconds=LEASE_S),
            attempt=F("attempt") + 1,
            started=now,
            stage="wait",
            fraction=0.0,
        )
        if won:
            job.refresh_from_db()
            results.begun(_about(job))
            taken.append(job)
    return taken


def renew(owner: str) -> None:
    """Renew the runner's leases."""
    until = timezone.now() + datetime.timedelta(seconds=LEASE_S)
    Job.objects.filter(lease_owner=owner, state=Job.State.RUNNING).update(lease_until=until)


def requeue_abandoned() -> int:
    """Queue the jobs of dead runners again. Return their number.

    Jobs whose runners died too often fail.
    """
    now = timezone.now()
    abandoned = [
        job
        for job in Job.objects.filter(state=Job.State.RUNNING)
        if job.lease_until is None or job.lease_until <= now or _is_dead(job.lease_owner)
    ]
    for job in abandoned:
        _abandon(job)
    return len(abandoned)


def abandon(owner: str, kinds: Collection[str]) -> None:
    """Treat a runner's jobs of these kinds as if it had died, because it could not store a result."""
    for job in Job.objects.filter(lease_owner=owner, state=Job.State.RUNNING, kind__in=kinds):
        _abandon(job)


def _abandon(job: Job) -> None:
    held = Job.objects.filter(pk=job.pk, state=Job.State.RUNNING, lease_owner=job.lease_owner)
    retries = retries_of(job)
    if job.attempt < retries.most:
        held.update(**_AGAIN, due=timezone.now() + retries.wait(job.attempt))
        return
    with transaction.atomic():
        if held.update(
            state=Job.State.FAILED,
            message=f"The machine stopped {job.attempt} times during this job. Check its memory.",
            exit_code=1,
            ended=timezone.now(),
        ):
            results.failed(_about(job), "The machine stopped during this job.")


def release(owner: str, key: UUID | None = None, kinds: Collection[str] = tuple(Job.Kind)) -> int:
    """Queue a runner's jobs again, or one of them. Return their number.

    This does not count as an attempt.
    """
    held = Job.objects.filter(lease_owner=owner, state=Job.State.RUNNING, kind__in=kinds)
    return (held if key is None else held.filter(pk=key)).update(**_AGAIN, attempt=F("attempt") - 1)


def progressed(key: UUID, owner: str, stage: str, fraction: float) -> None:
    """Store a job's progress, which never decreases."""
    held = Job.objects.filter(pk=key, lease_owner=owner, state=Job.State.RUNNING)
    held.update(stage=stage[:60], fraction=Greatest(F("fraction"), fraction))  # one statement: both stay in step


def done(key: UUID, owner: str, answer: Mapping[str, Any]) -> bool:
    """Store the result of a job. Return whether the job was still this runner's."""
    with transaction.atomic():
        held = Job.objects.filter(pk=key, lease_owner=owner, state=Job.State.RUNNING)
        if not held.update(
            state=Job.State.DONE, fraction=1.0, stage="", digest=answer.get("digest", ""), ended=timezone.now(),
            exit_code=0,
        ):  # fmt: skip
            return False
        job = Job.objects.get(pk=key)
        results.enter(job, answer)
        if job.visit is not None and job.visit.state == Visit.State.CHANGED:  # drawn during the measurement
            enqueue(job.visit, job.created_by)
        _compare_after(job)
    return True


def failed(key: UUID, owner: str, message: str, exit_code: int) -> bool:
    """Store why a job failed. It is retried or ends. Return whether it was still this runner's."""
    with transaction.atomic():
        held = Job.objects.filter(pk=key, lease_owner=owner, state=Job.State.RUNNING)
        job = held.first()
        if job is None:
            return False
        retries = retries_of(job)
        if retries.first_wait is not None and job.attempt < retries.most:
            due = timezone.now() + retries.wait(job.attempt)
            return bool(held.update(**_AGAIN, due=due, message=message[:1500]))
        if not held.update(
            state=Job.State.FAILED, message=message[:1500], exit_code=exit_code, ended=timezone.now(), stage=""
        ):
            return False
        results.failed(_about(job), message)
        _compare_after(job)
    return True


def _compare_after(job: Job) -> None:
    """Queue the comparisons that are due after a job.

    A comparison is due again if one of its visits was measured while the comparison ran.
    """
    pairs = [(job.comparison.before, job.comparison.after)] if job.comparison is not None else []
    if job.visit is not None:
        pairs = comparing.neighbours(job.visit)
    for before, after in pairs:
        compare(before, after, None)


def unwanted(owner: str) -> list[str]:
    """Keys of a runner's jobs that were cancelled recently."""
    since = timezone.now() - datetime.timedelta(seconds=_STOPPED_S)
    cancelled = Job.objects.filter(lease_owner=owner, state=Job.State.CANCELLED, ended__gt=since)
    return [str(key) for key in cancelled.values_list("pk", flat=True)]


def new_owner() -> str:
    """A runner's name: its machine, its process, and a random part."""
    return ":".join((platform.node(), str(os.getpid()), uuid4().hex[:12]))


def _is_dead(owner: str) -> bool:
    """Whether the runner was a process of this machine that has ended, so that its lease can be ignored."""
    import psutil

    host, _, rest = owner.partition(":")
    pid = rest.partition(":")[0]
    return host == platform.node() and pid.isdecimal() and not psutil.pid_exists(int(pid))
