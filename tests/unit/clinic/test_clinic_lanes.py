"""Backups, restore tests and deliveries are jobs of the one queue: how often, in which order, how many at once."""

import datetime
import threading
import time
from dataclasses import replace
from typing import Any

import pytest
from django.db import connection
from django.utils import timezone
from pytest_django import Settings

from mammometry.clinic import deliveries
from mammometry.clinic.config import ClinicConfig
from mammometry.clinic.jobs import queue, runner
from mammometry.clinic.jobs.lanes import LANES, Lane
from mammometry.clinic.maintenance import backups
from mammometry.clinic.models import Destination, Job, Visit

BACKUP, RESTORE = [Job.Kind.BACKUP], [Job.Kind.RESTORE]
UPKEEP = LANES[-1]


@pytest.fixture
def night(clinic: ClinicConfig, monkeypatch: pytest.MonkeyPatch) -> ClinicConfig:
    """A clinic whose daily time has passed without a backup."""
    monkeypatch.setattr(backups, "is_due", lambda *_: not backups.backup_files(clinic))
    return clinic


def lane_done(clinic: ClinicConfig, lane: Lane) -> Job | None:
    """A runner does the next job of a lane."""
    one = runner.Runner(clinic, lanes=[lane])
    jobs = queue.claim(one.owner, 1, lane.work)
    for job in jobs:
        one._do(job, lane)
        job.refresh_from_db()
    return jobs[0] if jobs else None


@pytest.mark.slow
@pytest.mark.requirement("R-KEEP-1")
def test_two_runners_make_one_backup_a_day(
    shared_database: None, night: ClinicConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runner, "_LANE_LOOK_S", 0.02)
    runners = [runner.Runner(night, lanes=[UPKEEP]) for _ in range(2)]
    threads = [threading.Thread(target=served, args=(one,)) for one in runners]
    for thread in threads:
        thread.start()
    until = time.monotonic() + 60
    while not Job.objects.filter(state=Job.State.DONE).exists() and time.monotonic() < until:
        time.sleep(0.05)
    time.sleep(0.3)  # each looks at the clock several times more
    for one in runners:
        one.stop()
    for thread in threads:
        thread.join()
    (job,) = Job.objects.all()
    assert (job.kind, job.state, job.attempt) == ("backup", "done", 1)
    assert len(backups.backup_files(night)) == 1


def served(one: runner.Runner) -> None:
    """Serve a runner's lane in this thread."""
    try:
        one._serve_lane(one._lanes[0])
    finally:
        connection.close()


def test_a_day_has_one_backup_however_often_it_is_planned(night: ClinicConfig) -> None:
    for _ in range(3):
        backups.plan_daily(night)
    (job,) = Job.objects.all()
    Job.objects.update(state=Job.State.FAILED, attempt=3, ended=timezone.now())
    backups.plan_daily(night)  # it has failed, and no try of it is noted: it is not begun for ever
    assert queue.gave_up() == [job]
    Job.objects.all().delete()
    queue.enqueue_upkeep(Job.Kind.BACKUP, None)
    backups.plan_daily(night)  # somebody pressed the button at this moment
    assert Job.objects.count() == 1


def test_a_backup_that_fails_is_tried_three_times(clinic: ClinicConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuses(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(backups, "make_backup", refuses)
    queue.enqueue_upkeep(Job.Kind.BACKUP, None)
    waits = []
    for _ in range(3):
        begun = timezone.now()
        job = lane_done(clinic, UPKEEP)
        assert job is not None
        waits.append(round((job.due - begun).total_seconds() / 60))
        assert not queue.is_busy(Job.Kind.BACKUP)
        if job.state == Job.State.QUEUED:
            assert lane_done(clinic, UPKEEP) is None
            queue.enqueue_upkeep(Job.Kind.BACKUP, None)  # the button: it is due now
            assert queue.is_busy(Job.Kind.BACKUP)
    assert waits[:2] == [10, 20]
    assert (job.state, job.attempt) == (Job.State.FAILED, 3)
    assert queue.gave_up() == [job]
    assert backups.state_of(clinic).backup is not None


@pytest.mark.slow
def test_a_restore_is_tested_by_a_job(clinic: ClinicConfig, settings: Settings) -> None:
    settings.MIGRATION_MODULES = {}  # which the tests leave out to be quick
    for _ in range(2):
        queue.enqueue_upkeep(Job.Kind.RESTORE, None)
        job = lane_done(clinic, UPKEEP)
        assert job is not None
        if job.state == Job.State.FAILED:
            assert "found none" in job.message
            backups.make_kept_backup(clinic)
    assert job.state == Job.State.DONE
    outcome = backups.state_of(clinic).restore
    assert outcome is not None
    assert outcome.passed


@pytest.mark.slow
def test_one_backup_or_restore_test_at_a_time_and_one_delivery_besides(
    shared_database: None, clinic: ClinicConfig, visit: Visit, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runner, "_LANE_LOOK_S", 0.02)
    at_work, most = dict.fromkeys(("deliveries", "upkeep"), 0), dict.fromkeys(("deliveries", "upkeep"), 0)
    both, lock = [False], threading.Lock()

    def noting(name: str) -> Any:
        def work(*_: object) -> dict[str, Any]:
            with lock:
                at_work[name] += 1
                most[name] = max(most[name], at_work[name])
                both[0] |= all(at_work.values())
            time.sleep(0.3)
            with lock:
                at_work[name] -= 1
            return {"sent": 1, "kept": None, "message": ""}

        return work

    lanes = [
        replace(lane, work=dict.fromkeys(lane.work, noting(lane.name)), plan=lambda _: None)
        for lane in (LANES[0], UPKEEP)
    ]
    for number in range(3):
        archive = Destination.objects.create(name=f"PACS {number}", address="PACS@h:104")
        deliveries.enqueue(visit, archive, None)
    for kind in (Job.Kind.BACKUP, Job.Kind.RESTORE):
        queue.enqueue_upkeep(kind, None)
    one = runner.Runner(clinic, lanes=lanes)
    thread = threading.Thread(target=lambda: (one.run(), connection.close()))
    thread.start()
    until = time.monotonic() + 30
    while Job.objects.filter(state__in=Job.OPEN).exists() and time.monotonic() < until:
        time.sleep(0.05)
    one.stop()
    thread.join()
    assert most == {"deliveries": 1, "upkeep": 1}
    assert both == [True]
    sent = Job.objects.filter(kind=Job.Kind.SEND).order_by("ended")
    assert [job.delivery.destination.name for job in sent if job.delivery] == ["PACS 0", "PACS 1", "PACS 2"]
    assert set(Job.objects.values_list("state", flat=True)) == {"done"}


def test_what_cannot_be_entered_counts_as_an_attempt(
    shared_database: None, clinic: ClinicConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A lane whose result the database refuses gives the job back, and gives it up in the end."""
    monkeypatch.setattr(runner, "_LANE_LOOK_S", 0.01)
    monkeypatch.setattr(queue, "_RETRIES", {})

    def done(*_: object) -> bool:
        raise ValueError("of the database")

    monkeypatch.setattr(queue, "done", done)
    queue.enqueue_upkeep(Job.Kind.BACKUP, None)
    one = runner.Runner(clinic, lanes=[replace(UPKEEP, work={Job.Kind.BACKUP: lambda *_: {}}, plan=lambda _: None)])
    thread = threading.Thread(target=served, args=(one,))
    thread.start()
    until = time.monotonic() + 30
    while not Job.objects.filter(state=Job.State.FAILED).exists() and time.monotonic() < until:
        time.sleep(0.02)
    one.stop()
    thread.join()
    assert Job.objects.get().attempt == 3


def test_the_pages_of_jobs_show_computations_alone(clinic: ClinicConfig, client_of: Any) -> None:
    from mammometry.clinic.roles import Role

    queue.enqueue_upkeep(Job.Kind.BACKUP, None)
    client = client_of(Role.TECHNICIAN)
    assert client.get("/jobs/").json() == {"jobs": [], "queued": 0, "running": 0}
    assert "Nothing is being computed" in client.get("/jobs/page/").content.decode()
    assert client.get(f"/jobs/{Job.objects.get().pk}/").status_code == 404


def test_a_job_that_is_due_later_is_not_before_one_that_is_due(clinic: ClinicConfig, visit: Visit) -> None:
    """An archive that is down does not hold up the others."""
    for name in ("down", "up"):
        deliveries.enqueue(visit, Destination.objects.create(name=name, address="PACS@h:104"), None)
    (first,) = queue.claim("runner", 1, [Job.Kind.SEND])
    queue.failed(first.pk, "runner", "nobody answers", 1)
    Job.objects.filter(pk=first.pk).update(due=timezone.now() - datetime.timedelta(milliseconds=1))
    (second,) = queue.claim("runner", 1, [Job.Kind.SEND])
    assert second.delivery is not None
    assert second.delivery.destination.name == "up"
