"""The queue: rows in the database, held by runners on leases.

A job belongs to the runner that changed its row from queued to running; the database lets one do so. The runner
renews its lease while it lives. When it dies, the lease ends, and the job is queued again. What a job came to is
entered in the same transaction that ends it, and only by the runner that still holds it.
"""

import datetime
import os
import platform
from collections.abc import Mapping
from typing import Any
from uuid import UUID

from django.db import IntegrityError, transaction
from django.db.models import F, Q, QuerySet
from django.utils import timezone

from mammometry.capture.sessions import make_session, manifest_text
from mammometry.clinic.jobs import results
from mammometry.clinic.jobs.results import Target
from mammometry.clinic.models import Calibration, Comparison, DailyCheck, Job, Person, Visit
from mammometry.clinic.records import comparing
from mammometry.clinic.site import the_clinic
from mammometry.io.subject import rename_subject

LEASE_S = 45.0
"""A runner that says nothing for so long is taken for dead. It renews every third of it."""
_ATTEMPTS = 3  # times that a job may take its runner down, before it is blamed
_STOPPED_S = 10.0  # for so long a cancelled job's process is looked for
OPEN = (Job.State.QUEUED, Job.State.RUNNING)
_KINDS: Mapping[type, tuple[str, str]] = {
    Visit: (Job.Kind.MEASURE, "visit"),
    Calibration: (Job.Kind.CALIBRATE, "calibration"),
    DailyCheck: (Job.Kind.CHECK, "check_of_day"),
    Comparison: (Job.Kind.COMPARE, "comparison"),
}
_AGAIN: dict[str, Any] = {
    "state": Job.State.QUEUED, "lease_owner": "", "lease_until": None, "stage": "", "fraction": 0.0,
}  # fmt: skip
"""A job that waits again."""
_WORDS = {
    "": "Waiting",
    "wait": "Waiting for a free place",
    "start": "Starting",
    "prepare": "Preparing",
    "calibrate": "Calibrating the cameras",
    "match": "Matching the photographs",
    "surface": "Building the surface",
    "measure": "Measuring",
    "report": "Writing the report",
    "check": "Looking for the board",
    "compare": "Comparing both dates",
}


def stage_words(stage: str) -> str:
    """Name of a stage on pages."""
    return _WORDS.get(stage, stage)


def target_of(job: Job) -> Target:
    """The record that a job is about."""
    target = job.visit or job.calibration or job.check_of_day or job.comparison
    assert target is not None
    return target


def enqueue(target: Target, by: Person | None) -> Job:
    """Queue a computation for a visit, calibration, daily check or comparison.

    One that is open already is returned.

    Raises:
        StorageError: the disk is full or refuses.
    """
    kind, field = _KINDS[type(target)]
    about: dict[str, Any] = {field: target}
    open_one = Job.objects.filter(**about, state__in=OPEN).first()
    if open_one is not None:
        return open_one
    if isinstance(target, Visit):
        carry_subject(target)
    if isinstance(target, Calibration) and "rig" in target.rig.definition:  # the board may have been measured meanwhile
        make_session(the_clinic().folder / target.folder, manifest_text(target.rig.definition, "torso"))
    try:
        with transaction.atomic():
            job = Job.objects.create(**about, kind=kind, created_by=by)
            results.queued(target)
    except IntegrityError:  # somebody else queued it at this moment
        return Job.objects.get(**about, state__in=OPEN)
    return job


def compare(before: Visit, after: Visit, by: Person | None) -> None:
    """Queue the comparison of two visits where none of their newest measurements is there."""
    if not comparing.may_compare(before, after):
        return
    comparison, _ = Comparison.objects.get_or_create(before=before, after=after)
    if not comparing.is_current(comparison):
        enqueue(comparison, by)


def carry_subject(visit: Visit) -> None:
    """Let a visit's folder name its patient by pseudonym, and its day, after either was corrected.

    Results that name another patient are dropped.

    Raises:
        StorageError: the disk is full or refuses.
    """
    rename_subject(visit.folder, visit.patient.pseudonym, timezone.localdate(visit.taken_at))


def retry(job: Job, by: Person | None) -> Job:
    """Queue what a job was about once more."""
    return enqueue(target_of(job), by)


def cancel(job: Job) -> bool:
    """Take a job out of the queue, or stop it. Say whether it was still open."""
    with transaction.atomic():
        done = Job.objects.filter(pk=job.pk, state__in=OPEN).update(state=Job.State.CANCELLED, ended=timezone.now())
        if done:
            results.cancelled(target_of(job))
    job.refresh_from_db()
    return bool(done)


def of_visits_in_use() -> QuerySet[Job]:
    """Jobs as pages show them: none of a visit in the bin."""
    return Job.objects.filter(
        visit__binned_at=None, comparison__before__binned_at=None, comparison__after__binned_at=None
    )


def place(job: Job) -> int | None:
    """Place in the queue, from 1. None where it does not wait."""
    if job.state != Job.State.QUEUED:
        return None
    before = Q(created__lt=job.created) | Q(created=job.created, pk__lt=job.pk)
    return 1 + Job.objects.filter(before, state=Job.State.QUEUED).count()


# --- what runners do ---


def anything() -> bool:
    """Whether any job waits in the queue."""
    return Job.objects.filter(state=Job.State.QUEUED).exists()


def claim(owner: str, room: int) -> list[Job]:
    """Take up to so many jobs, the oldest first. No other runner has them."""
    now = timezone.now()
    taken: list[Job] = []
    for job in Job.objects.filter(state=Job.State.QUEUED).order_by("created", "pk")[: 2 * room]:
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
            results.begun(target_of(job))
            taken.append(job)
    return taken


def renew(owner: str) -> None:
    """Say that the runner lives."""
    until = timezone.now() + datetime.timedelta(seconds=LEASE_S)
    Job.objects.filter(lease_owner=owner, state=Job.State.RUNNING).update(lease_until=until)


def requeue_abandoned() -> int:
    """Queue again what dead runners held.

    Blame what took its runner down too often. Return how many there were.
    """
    now = timezone.now()
    count = 0
    for job in Job.objects.filter(state=Job.State.RUNNING):
        if job.lease_until is not None and job.lease_until > now and not _is_dead(job.lease_owner):
            continue
        held = Job.objects.filter(pk=job.pk, state=Job.State.RUNNING, lease_owner=job.lease_owner)
        if job.attempt >= _ATTEMPTS:
            with transaction.atomic():
                if held.update(
                    state=Job.State.FAILED,
                    message=f"The machine stopped {job.attempt} times while it worked on this. Look at its memory.",
                    exit_code=1,
                    ended=now,
                ):
                    results.failed(target_of(job), "The machine stopped while it worked on this.")
        else:
            held.update(**_AGAIN)
        count += 1
    return count


def release(owner: str, key: UUID | None = None) -> int:
    """Queue again what a runner holds, or one job of it. That was no attempt. Return how many there were."""
    held = Job.objects.filter(lease_owner=owner, state=Job.State.RUNNING)
    return (held if key is None else held.filter(pk=key)).update(**_AGAIN, attempt=F("attempt") - 1)


def progressed(key: UUID, owner: str, stage: str, fraction: float) -> None:
    """Note how far a job is. The bar never goes back."""
    held = Job.objects.filter(pk=key, lease_owner=owner, state=Job.State.RUNNING)
    held.update(stage=stage[:60])
    held.filter(fraction__lt=fraction).update(fraction=fraction)


def done(key: UUID, owner: str, answer: Mapping[str, Any]) -> bool:
    """Enter what a job came to. Say whether it was still this runner's."""
    with transaction.atomic():
        held = Job.objects.filter(pk=key, lease_owner=owner, state=Job.State.RUNNING)
        if not held.update(
            state=Job.State.DONE, fraction=1.0, stage="", digest=answer["digest"], ended=timezone.now(), exit_code=0
        ):
            return False
        job = Job.objects.get(pk=key)
        results.enter(job, answer)
        if job.visit is not None and job.visit.state == Visit.State.CHANGED:  # drawn while this was at work
            enqueue(job.visit, job.created_by)
        _compare_after(job)
    return True


def failed(key: UUID, owner: str, message: str, exit_code: int) -> bool:
    """Enter why a job failed. Say whether it was still this runner's."""
    with transaction.atomic():
        held = Job.objects.filter(pk=key, lease_owner=owner, state=Job.State.RUNNING)
        if not held.update(
            state=Job.State.FAILED, message=message[:1500], exit_code=exit_code, ended=timezone.now(), stage=""
        ):
            return False
        job = Job.objects.get(pk=key)
        results.failed(target_of(job), message)
        _compare_after(job)
    return True


def _compare_after(job: Job) -> None:
    """Queue the comparisons that are due now that a job has ended.

    A comparison is due again when one of its visits was measured while it was made.
    """
    pairs = [(job.comparison.before, job.comparison.after)] if job.comparison is not None else []
    if job.visit is not None:
        pairs = comparing.neighbours(job.visit)
    for before, after in pairs:
        compare(before, after, None)


def unwanted(owner: str) -> list[str]:
    """Keys of a runner's jobs that were cancelled just now."""
    since = timezone.now() - datetime.timedelta(seconds=_STOPPED_S)
    cancelled = Job.objects.filter(lease_owner=owner, state=Job.State.CANCELLED, ended__gt=since)
    return [str(key) for key in cancelled.values_list("pk", flat=True)]


def new_owner() -> str:
    """A runner's name: its machine, its process, and a random part."""
    from uuid import uuid4

    return ":".join((platform.node(), str(os.getpid()), uuid4().hex[:12]))


def _is_dead(owner: str) -> bool:
    """Whether the runner was a process of this machine that is gone. Its lease need not be waited for."""
    import psutil

    host, _, rest = owner.partition(":")
    pid = rest.partition(":")[0]
    return host == platform.node() and pid.isdecimal() and not psutil.pid_exists(int(pid))
