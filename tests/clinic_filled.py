"""Fills a clinic with rows, in a process of its own: ``python tests/clinic_filled.py DIR WHAT [SESSION]``."""

import json
import shutil
import sys
from pathlib import Path
from typing import Any


def login(name: str, *roles: str) -> dict[str, str]:
    """Enter somebody, and log in: the cookies of a browser."""
    from django.middleware.csrf import _get_new_csrf_string
    from django.test import Client

    from mammometry.clinic.models import Person

    person, _ = Person.objects.get_or_create(username=name, defaults={"roles": list(roles)})
    client = Client()
    client.force_login(person, backend="allauth.account.auth_backends.AuthenticationBackend")
    session = next(iter(client.cookies.items()))
    return {session[0]: session[1].value, "clinic-csrf": _get_new_csrf_string()}


def rig_of(session: Path, folder: Path) -> Any:
    """A rig, with a calibration whose photographs are those of a session."""
    from mammometry.capture.sessions import definition_of
    from mammometry.clinic.models import Rig
    from mammometry.clinic.rig_history import new_calibration
    from mammometry.io.manifest import read_manifest

    rig = Rig.objects.create(name="rig", definition=definition_of(read_manifest(session / "session.toml")))
    calibration = new_calibration(rig, None)
    shutil.copytree(session / "calibration", folder / calibration.folder / "calibration")
    return calibration


def visit_of(calibration: Any, session: Path | None, number: int = 1) -> Any:
    """A visit whose photographs are those of a session; without one, only the rows say so."""
    from django.utils import timezone

    from mammometry.capture.sessions import cameras_of
    from mammometry.clinic.intake.uploads import ready_folder
    from mammometry.clinic.models import Patient, Upload, Visit

    patient = Patient.objects.create(family_name="Q", given_name="Q", record_number=str(number))
    visit = Visit.objects.create(
        patient=patient,
        rig=calibration.rig,
        calibration=calibration,
        taken_at=timezone.now(),
        subject_kind="model",
        state="ready",
    )
    for camera in cameras_of(calibration.rig.definition):
        Upload.objects.create(
            visit=visit,
            camera=camera,
            name=f"capture/{camera}.jpg",
            size_bytes=1,
            state="placed",
            sha256=f"{number} {camera}".ljust(64),  # no two visits have the same photographs
        )
    if session is not None:
        ready_folder(visit)
        shutil.copytree(session / "capture", visit.folder / "capture", dirs_exist_ok=True)
    return visit


def before_cameras(folder: Path, place: Path) -> Any:
    """A visit before a rig that this computer drives: rig.toml and the session ``calibrated`` lie in a place."""
    from django.utils import timezone

    from mammometry.capture.sessions import definition_of, read_rig_file
    from mammometry.clinic.models import Patient, Rig, Visit
    from mammometry.clinic.rig_history import new_calibration

    with (folder / "clinic.toml").open("a") as file:
        file.write(f'\n[cameras]\n"Room 2" = "{place / "rig.toml"}"\n')
    rig = Rig.objects.create(name="Room 2", definition=definition_of(read_rig_file(place / "rig.toml")))
    calibration = new_calibration(rig, None)
    calibration.state, calibration.current, calibration.figures = "done", True, {"verdict": "pass"}
    calibration.save()
    shutil.copy(place / "calibrated/cameras.json", folder / calibration.folder / "cameras.json")
    patient = Patient.objects.create(family_name="Meier", given_name="Eva", record_number="C-1")
    return Visit.objects.create(
        patient=patient, rig=rig, calibration=calibration, taken_at=timezone.now(), subject_kind="model"
    )


def main() -> dict[str, Any]:
    """Fill, or tell what is there."""
    from mammometry.clinic.config import read_config
    from mammometry.clinic.site import configure

    folder, what = Path(sys.argv[1]), sys.argv[2]
    config = read_config(folder)
    configure(config.model_copy(update={"hosts": (*config.hosts, "testserver")}))
    from mammometry.clinic.jobs import queue
    from mammometry.clinic.models import Calibration, DailyCheck, Job, Measurement, Volume

    if what == "calibrate":
        calibration = rig_of(Path(sys.argv[3]), folder)
        return {"job": str(queue.enqueue(calibration, None).pk), "calibration": str(calibration.pk)}
    if what == "measure":
        visit = visit_of(Calibration.objects.get(), Path(sys.argv[3]))
        return {"job": str(queue.enqueue(visit, None).pk), "visit": str(visit.pk)}
    if what == "send":
        from mammometry.clinic.deliveries import enqueue
        from mammometry.clinic.models import Destination, Visit

        destination = Destination.objects.create(name="PACS", address=sys.argv[3])
        return {"delivery": str(enqueue(Visit.objects.get(), destination, None).pk)}
    if what == "cameras":
        return {"visit": str(before_cameras(folder, Path(sys.argv[3])).pk)}
    if what == "photograph":
        calibration = rig_of(Path(sys.argv[3]), folder)
        visit = visit_of(calibration, None)
        visit.uploads.all().delete()
        return {"visit": str(visit.pk), "cookies": login("tessa", "technician")}
    if what == "rig":
        calibration = rig_of(Path(sys.argv[3]), folder)
        shutil.rmtree(folder / calibration.folder)
        rig = calibration.rig
        calibration.delete()
        return {"rig": str(rig.pk), "cookies": login("tessa", "technician")}
    if what == "load":
        people, visits = map(int, sys.argv[3].split(","))
        calibration = rig_of(Path(sys.argv[4]), folder)
        calibration.state, calibration.current = "done", True
        calibration.save()
        made = [visit_of(calibration, None, number) for number in range(visits)]
        return {
            "visits": [str(visit.pk) for visit in made],
            "cookies": [login(f"person{number}", "technician") for number in range(people)],
        }
    jobs = [
        {
            "id": str(job.pk), "kind": job.kind, "state": job.state, "stage": job.stage, "attempt": job.attempt,
            "message": job.message, "owner": job.lease_owner,
        }
        for job in Job.objects.all()
    ]  # fmt: skip
    rows = [[row.side, row.definition, row.volume_cc] for row in Volume.objects.all()]
    return {
        "jobs": jobs,
        "measurements": Measurement.objects.count(),
        "volumes": rows,
        "calibrations": [each.folder for each in Calibration.objects.all()],
        "checks": [{"verdict": each.verdict, "passed": each.passed} for each in DailyCheck.objects.all()],
    }


if __name__ == "__main__":
    sys.stdout.write(json.dumps(main()) + "\n")
