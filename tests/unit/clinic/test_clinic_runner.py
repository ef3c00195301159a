"""Two runners on one queue, with real workers: each job is done once; one is cancelled, one fails."""

import os
import threading
import time
from pathlib import Path

import clinic_work
import pytest
from django.db import connection
from django.utils import timezone

from mammometry.batch.cluster import machines
from mammometry.clinic.jobs import queue, runner
from mammometry.clinic.models import Calibration, Job, Measurement, Patient, Rig, Visit


def ready_visits(count):
    rig = Rig.objects.create(name="rig")
    calibration = Calibration.objects.create(rig=rig, taken_at=timezone.now(), folder="rigs/x", state="done")
    patient = Patient.objects.create(family_name="Q", given_name="Q", record_number="1")
    made = []
    for _ in range(count):
        visit = Visit.objects.create(patient=patient, rig=rig, calibration=calibration, taken_at=timezone.now())
        (visit.folder / "capture").mkdir(parents=True)
        made.append(visit)
    return made


@pytest.mark.slow
def test_two_runners_do_each_job_once(shared_database, clinic, monkeypatch):
    before = os.environ.get("PYTHONPATH")
    paths = [str(Path(__file__).parent), *([before] if before else [])]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(paths))
    monkeypatch.setattr(runner.work, "measure", clinic_work.measure)
    monkeypatch.setattr(runner.Runner, "_known", lambda self: [(1.0, 100.0)])
    visits = ready_visits(10)
    (visits[0].folder / "long").touch()
    (visits[1].folder / "bad").touch()
    jobs = [queue.enqueue(visit, None) for visit in visits]
    runners = [runner.Runner(clinic, lambda: machines(None, cores=2, memory_mb=1000)) for _ in range(2)]

    def run(one):
        try:
            one.run()
        finally:
            connection.close()

    threads = [threading.Thread(target=run, args=(one,)) for one in runners]
    for thread in threads:
        thread.start()
    try:
        until = time.monotonic() + 240
        while Job.objects.filter(state__in=Job.OPEN).count() > 1 and time.monotonic() < until:
            time.sleep(0.2)
        jobs[0].refresh_from_db()
        assert (jobs[0].state, jobs[0].stage) == ("running", "match")
        assert queue.cancel(jobs[0])
        time.sleep(2)
    finally:
        for one in runners:
            one.stop()
        for thread in threads:
            thread.join()
    states = dict(Job.objects.values_list("visit_id", "state"))
    assert states.pop(visits[0].pk) == "cancelled"
    assert states.pop(visits[1].pk) == "failed"
    assert set(states.values()) == {"done"}
    failed = Job.objects.get(visit=visits[1])
    assert failed.message.startswith(f"sessions/{visits[1].pk}/capture: ")  # no path of this machine
    for visit in visits[2:]:
        assert (visit.folder / "notes").read_text().split() == ["began", "ended"]
    assert (visits[0].folder / "notes").read_text().split() == ["began"]
    assert Measurement.objects.count() == 8
    assert set(Job.objects.values_list("attempt", flat=True)) == {1}
