"""Median seconds of the clinic's pages, with 5 000 patients and 15 000 measured visits.

    python -m benchmarks.speed.pages [--database postgresql://…] [--patients 5000] [--times 9] [--only today study]

The clinic is made in a temporary folder. Pages are asked for within the process, so no network is in the figures.
"""

from __future__ import annotations

import argparse
import datetime
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

_VISITS = 3  # a patient
_FAMILIES = ("Müller", "Schmidt", "O’Brien", "Łuczak", "Strauß", "García", "Åkesson", "Nguyễn", "Meier-Huber", "Ünal")
_DEFINITIONS = ("named wall", "flat chest", "measured wall")


def make(folder: Path, database: str, patients: int) -> None:
    """Make a clinic whose database is as full as that of a large one."""
    from mammometry.clinic.config import new_clinic
    from mammometry.clinic.web.server import migrate

    migrate(new_clinic(folder, name="Large clinic", second_factor="offered", database=database))
    from django.utils import timezone

    from mammometry.clinic.models import Calibration, Consent, Measurement, Patient, Rig, Visit, Volume

    now = timezone.now()
    rig = Rig.objects.create(name="Room 1", definition={"rig": {"name": "r", "pairs": []}})
    calibration = Calibration.objects.create(
        rig=rig, taken_at=now - datetime.timedelta(days=2000), folder="c", state="done", current=True
    )
    people = Patient.objects.bulk_create(
        [
            Patient(
                family_name=_FAMILIES[number % len(_FAMILIES)], given_name=f"Given{number}",
                record_number=f"KIS-{number:05d}", pseudonym=f"P-{number:06d}",
                born=datetime.date(1940, 1, 1) + datetime.timedelta(days=7 * (number % 3000)),
            )
            for number in range(patients)
        ],
        batch_size=1000,
    )  # fmt: skip
    Consent.objects.bulk_create(
        [Consent(patient=patient, purpose="research", given_on=now.date()) for patient in people], batch_size=1000
    )
    visits = Visit.objects.bulk_create(
        [
            Visit(
                patient=patient, rig=rig, calibration=calibration, state="confirmed" if number % 5 else "measured",
                taken_at=now - datetime.timedelta(days=180 * k + number % 180, hours=1),
            )
            for number, patient in enumerate(people)
            for k in range(_VISITS)
        ],
        batch_size=1000,
    )  # fmt: skip
    measurements = Measurement.objects.bulk_create(
        [Measurement(visit=visit, digest=visit.pk.hex, made_at=visit.taken_at, software="1") for visit in visits],
        batch_size=1000,
    )
    rows = (
        Volume(
            measurement=measurement, side=side, definition=definition, volume_cc=400.0 + number % 90,
            low_cc=390.0 + number % 90, high_cc=410.0 + number % 90, leads=definition == "flat chest",
        )
        for number, measurement in enumerate(measurements)
        for side in ("left", "right")
        for definition in _DEFINITIONS
    )  # fmt: skip
    Volume.objects.bulk_create(rows, batch_size=1000)


def pages() -> dict[str, str]:
    """Name → address of the pages that are asked for."""
    from mammometry.clinic.models import Patient

    patient = Patient.objects.filter(visits__isnull=False).order_by("pk")[0]
    return {
        "today": "/", "patients": "/patients/", "search by name": "/patients/?q=MULLER+given12",
        "search by birthday": "/patients/?q=14.5.79", "search for nobody": "/patients/?q=nobody",
        "patient": f"/patients/{patient.pk}/", "visit": f"/visits/{patient.visits.all()[0].pk}/",
        "new visit": "/visits/new/", "new visit, chosen": f"/visits/new/?patient={patient.pk}",
        "new visit, search": "/visits/new/?q=given123", "new scan": "/visits/scan/",
        "corrections": "/corrections/", "jobs": "/jobs/page/", "study": "/study/", "study, table": "/study/cohort.csv",
    }  # fmt: skip


def timed(client: Any, path: str, times: int) -> list[float]:
    """Seconds of each time that a page was asked for."""
    seconds = []
    for _ in range(times + 1):  # the first one compiles templates
        begun = time.perf_counter()
        answer = client.get(path)
        seconds.append(time.perf_counter() - begun)
        assert answer.status_code == 200, (path, answer.status_code)
    return seconds[1:]


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--database", default="sqlite")
    parser.add_argument("--patients", type=int, default=5000)
    parser.add_argument("--times", type=int, default=9)
    parser.add_argument("--only", nargs="+", default=[], help="words that a page's name holds")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="mammometry-pages-") as scratch:
        make(Path(scratch) / "clinic", arguments.database, arguments.patients)
        from django.conf import settings
        from django.test import Client

        from mammometry.clinic.models import Person
        from mammometry.clinic.roles import Role

        settings.ALLOWED_HOSTS = ["*"]
        person = Person.objects.create(username="all", roles=[str(role) for role in Role])
        client = Client()
        client.force_login(person, backend="allauth.account.auth_backends.AuthenticationBackend")
        print("| page | median s | slowest s |\n| --- | --- | --- |")
        for name, path in pages().items():
            if not arguments.only or any(word in name for word in arguments.only):
                seconds = timed(client, path, arguments.times)
                print(f"| {name} | {statistics.median(seconds):.3f} | {max(seconds):.3f} |", flush=True)


if __name__ == "__main__":
    main()
