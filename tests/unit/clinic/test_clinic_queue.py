"""The queue: one runner has a job, none is lost, none is entered twice; what jobs come to is entered with them."""

import asyncio
import datetime
import json
import subprocess
import sys
import threading

import pytest
from django.db import IntegrityError, connection, transaction
from django.utils import timezone

from mammometry.clinic import rig_history
from mammometry.clinic.jobs import events, queue, runner
from mammometry.clinic.models import Calibration, DailyCheck, Job, Measurement, Patient, Rig, Visit
from mammometry.clinic.roles import Role

ANSWER = {
    "digest": "d" * 64,
    "made_at": "2026-11-23T05:00:00+00:00",
    "software": "0.1",
    "megapixels": 1.0,
    "volumes": [
        {"side": "left", "definition": "muscle", "volume_cc": 310.0, "low_cc": 290.0, "high_cc": 330.0, "refused": ""},
        {
            "side": "right",
            "definition": "any",
            "volume_cc": None,
            "low_cc": None,
            "high_cc": None,
            "refused": "No breast stands out there.",
        },
    ],
}


def visits(count):
    rig = Rig.objects.create(name="rig")
    calibration = Calibration.objects.create(
        rig=rig, taken_at=timezone.now(), folder="rigs/x", state=Calibration.State.DONE, current=True
    )
    patient = Patient.objects.create(family_name="Q", given_name="Q", record_number="1")
    return [
        Visit.objects.create(patient=patient, rig=rig, calibration=calibration, taken_at=timezone.now())
        for _ in range(count)
    ]


def dead_owner():
    """The name of a runner of this machine whose process is gone."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    host, _, random = queue.new_owner().split(":")
    return f"{host}:{process.pid}:{random}"


@pytest.mark.django_db
def test_a_job_goes_from_the_queue_to_its_result():
    (visit,) = visits(1)
    job = queue.enqueue(visit, None)
    assert queue.place(job) == 1
    visit.refresh_from_db()
    assert visit.state == Visit.State.QUEUED
    owner = queue.new_owner()
    (mine,) = queue.claim(owner, 3)
    assert (mine.pk, mine.state, mine.attempt) == (job.pk, "running", 1)
    queue.progressed(job.pk, owner, "match", 0.3)
    queue.progressed(job.pk, owner, "match", 0.1)  # a second product of the stage begins
    job.refresh_from_db()
    assert (job.stage, job.fraction) == ("match", 0.3)
    assert queue.done(job.pk, owner, ANSWER)
    visit.refresh_from_db()
    job.refresh_from_db()
    assert (visit.state, job.state, job.digest) == ("measured", "done", ANSWER["digest"])
    rows = {row.side: row for row in Measurement.objects.get().volumes.all()}
    assert (rows["left"].low_cc, rows["left"].high_cc) == (290.0, 330.0)
    assert rows["right"].refused == "No breast stands out there."


@pytest.mark.django_db
def test_what_is_open_is_not_queued_again_and_what_comes_to_the_same_is_not_entered_again():
    (visit,) = visits(1)
    job = queue.enqueue(visit, None)
    assert queue.enqueue(visit, None) == job
    for _ in range(2):
        owner = queue.new_owner()
        (mine,) = queue.claim(owner, 1)
        queue.done(mine.pk, owner, ANSWER)
        queue.enqueue(visit, None)
    assert Job.objects.count() == 3
    assert Measurement.objects.count() == 1


@pytest.mark.django_db
@pytest.mark.parametrize("about", ["visit", "calibration", "check_of_day"])
def test_the_database_refuses_a_second_open_job(about):
    (visit,) = visits(1)
    check = DailyCheck.objects.create(rig=visit.rig, taken_at=timezone.now())
    target = {"visit": visit, "calibration": visit.calibration, "check_of_day": check}[about]
    job = queue.enqueue(target, None)
    for state in Job.OPEN:
        Job.objects.filter(pk=job.pk).update(state=state)
        with pytest.raises(IntegrityError), transaction.atomic():
            Job.objects.create(**{about: target}, kind=job.kind)
    Job.objects.filter(pk=job.pk).update(state=Job.State.DONE)
    assert queue.enqueue(target, None) != job
    with pytest.raises(IntegrityError), transaction.atomic():
        Job.objects.filter(pk=job.pk).update(state=Job.State.QUEUED)


@pytest.mark.django_db
def test_who_comes_second_gets_the_job_of_who_came_first(monkeypatch):
    (visit,) = visits(1)
    first = queue.enqueue(visit, None)
    looks = iter([Job.objects.none()])  # somebody else queues it between the look and the entry
    found = Job.objects.filter
    monkeypatch.setattr(Job.objects, "filter", lambda **about: next(looks, None) or found(**about))
    assert queue.enqueue(visit, None) == first
    assert Job.objects.count() == 1


@pytest.mark.django_db
def test_a_runner_that_lost_its_job_enters_nothing():
    (visit,) = visits(1)
    queue.enqueue(visit, None)
    late, heir = queue.new_owner(), queue.new_owner()
    (job,) = queue.claim(late, 1)
    Job.objects.update(lease_until=timezone.now() - datetime.timedelta(seconds=1))
    assert queue.requeue_abandoned() == 1
    assert [each.pk for each in queue.claim(heir, 1)] == [job.pk]
    assert not queue.done(job.pk, late, ANSWER)
    assert not queue.failed(job.pk, late, "late", 1)
    assert Measurement.objects.count() == 0
    assert queue.done(job.pk, heir, ANSWER)
    assert Measurement.objects.count() == 1


@pytest.mark.django_db
def test_leases_of_the_living_are_left_alone_and_those_of_the_dead_end_at_once():
    first, second = visits(1), None
    queue.enqueue(first[0], None)
    owner = queue.new_owner()
    queue.claim(owner, 1)
    assert queue.requeue_abandoned() == 0
    Job.objects.update(lease_owner=dead_owner())
    assert queue.requeue_abandoned() == 1
    assert Job.objects.get().state == Job.State.QUEUED
    assert second is None


@pytest.mark.django_db
def test_a_job_that_takes_its_runner_down_three_times_is_blamed():
    (visit,) = visits(1)
    queue.enqueue(visit, None)
    for attempt in range(1, 4):
        (job,) = queue.claim(dead_owner(), 1)
        assert job.attempt == attempt
        queue.requeue_abandoned()
    job.refresh_from_db()
    assert job.state == Job.State.FAILED
    assert "stopped 3 times" in job.message
    visit.refresh_from_db()
    assert visit.state == Visit.State.REFUSED


@pytest.mark.django_db
def test_giving_back_is_no_attempt():
    (visit,) = visits(1)
    queue.enqueue(visit, None)
    owner = queue.new_owner()
    queue.claim(owner, 1)
    assert queue.release(owner) == 1
    job = Job.objects.get()
    assert (job.state, job.attempt) == (Job.State.QUEUED, 0)


@pytest.mark.django_db
def test_cancelled_jobs_leave_the_queue_or_are_stopped_and_can_be_tried_again():
    waiting, working = visits(1)[0], None
    job = queue.enqueue(waiting, None)
    assert queue.cancel(job)
    assert not queue.cancel(job)
    waiting.refresh_from_db()
    assert waiting.state == Visit.State.READY
    working = queue.retry(job, None)
    owner = queue.new_owner()
    queue.claim(owner, 1)
    assert queue.cancel(working)
    assert queue.unwanted(owner) == [str(working.pk)]
    assert not queue.done(working.pk, owner, ANSWER)
    assert Measurement.objects.count() == 0


@pytest.mark.slow
def test_many_runners_at_once_never_have_the_same_job(shared_database):
    for visit in visits(30):
        queue.enqueue(visit, None)
    taken, errors, barrier = [], [], threading.Barrier(4)

    def take():
        try:
            owner = queue.new_owner()
            barrier.wait()
            while got := queue.claim(owner, 2):
                taken.extend(job.pk for job in got)
        except BaseException as error:
            errors.append(error)
        finally:
            connection.close()

    threads = [threading.Thread(target=take) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not errors
    assert len(taken) == len(set(taken)) == 30


@pytest.mark.django_db
def test_what_a_calibration_and_a_check_come_to_is_told_by_the_rig():
    (visit,) = visits(1)
    rig, earlier = visit.rig, visit.calibration
    new = Calibration.objects.create(rig=rig, taken_at=timezone.now(), folder="rigs/y")
    queue.enqueue(new, None)
    owner = queue.new_owner()
    (job,) = queue.claim(owner, 1)
    new.refresh_from_db()
    assert new.state == Calibration.State.RUNNING
    queue.done(job.pk, owner, {"digest": "c", "figures": {"verdict": "pass", "reasons": ["All is well."]}})
    new.refresh_from_db()
    earlier.refresh_from_db()
    assert (new.state, new.current, earlier.current) == (Calibration.State.DONE, True, False)
    assert rig_history.today(rig).verdict == "yes"
    check = rig_history.new_check(rig, None)
    figures = {
        "verdict": "refuse",
        "reasons": ["front_left moved by 2 mm."],
        "effect_mm": 0.4,
        "cameras": {"front_left": {"moved": True, "shift_mm": 2.0, "turn_deg": 0.1, "shift_px": 3.0, "sigma": 50.0}},
    }
    queue.enqueue(check, None)
    (job,) = queue.claim(owner, 1)
    queue.done(job.pk, owner, {"digest": "k", "figures": figures})
    check = DailyCheck.objects.get()
    assert check.passed is False
    answer = rig_history.today(rig)
    assert answer.verdict == "no"
    assert "front_left moved by 2 mm." in answer.reasons
    (row,) = rig_history.drift_rows(rig)
    assert row["moved"] == ["front_left"]
    assert "moved" in rig_history.may_queue(visit)


def test_the_bar_grows_from_stage_to_stage():
    told = [runner.whole(stage, fraction) for stage in runner._SHARES for fraction in (0.0, 0.5, 1.0)]
    assert told == sorted(told)
    assert (told[0], told[-1]) == (0.0, 1.0)


# --- over HTTP ---


@pytest.mark.django_db
def test_jobs_over_http(client_of):
    (visit,) = visits(1)
    client = client_of(Role.TECHNICIAN)
    refused = client.post(f"/visits/{visit.pk}/measure/", "{}", content_type="application/json")
    assert refused.status_code == 409  # a rig without cameras: nothing could be measured
    job = queue.enqueue(visit, None)
    table = client.get(f"/jobs/{job.pk}/").json()
    assert (table["state"], table["place"], table["for"]) == ("queued", 1, "visit")
    assert table["patient"] == visit.patient.pseudonym
    assert client.get("/jobs/?state=open").json()["queued"] == 1
    assert client.post(f"/jobs/{job.pk}/cancel/").json()["state"] == "cancelled"
    assert client.post(f"/jobs/{job.pk}/cancel/").status_code == 409
    assert client.get(f"/jobs/{job.pk}/cancel/").status_code == 405
    assert client_of(Role.ADMINISTRATOR).get(f"/jobs/{job.pk}/").status_code == 403
    assert client_of(Role.RESEARCHER).get("/jobs/").status_code == 403


def test_events_tell_each_change_and_the_end(shared_database, monkeypatch):
    monkeypatch.setattr(events, "_LOOK_S", 0.02)
    visit, other = visits(2)
    job = queue.enqueue(visit, None)
    queue.enqueue(other, None)
    owner = queue.new_owner()

    def later():
        queue.claim(owner, 1)
        queue.progressed(job.pk, owner, "surface", 0.6)

    async def listen():
        told = []
        async for chunk in events.stream({"target": str(visit.pk)}):
            lines = dict(line.split(": ", 1) for line in chunk.decode().strip().splitlines() if ": " in line)
            if lines.get("event") == "job":
                told.append(json.loads(lines["data"]))
                if told[-1]["state"] == "queued":
                    await asyncio.to_thread(lambda: (later(), connection.close()))
                elif told[-1]["stage"] == "surface":
                    await asyncio.to_thread(lambda: (queue.done(job.pk, owner, ANSWER), connection.close()))
            if lines.get("event") == "end":
                return told
        raise AssertionError("the stream ended without saying so")

    told = asyncio.run(asyncio.wait_for(listen(), 30))
    assert {each["id"] for each in told} == {str(job.pk)}
    assert [told[0]["state"], told[-1]["state"]] == ["queued", "done"]
    assert any(each["stage_words"] == "Building the surface" and each["fraction"] == 0.6 for each in told)
