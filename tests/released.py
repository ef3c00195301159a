"""Small examples of what each released version left behind: a session with results, a clinic and its backup.

``python -m tests.released`` makes those of this version, once, when it is released: later versions must open them.
"""

import json
import lzma
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path
from typing import Any

from tests.clinic_server import command

import mammometry

EXAMPLES = Path(__file__).parent / "data" / "released"
SETTINGS = "settings.toml"
_HEAVY = ("match", "surface", "measure", "report")  # stages whose results are large; a rerun makes them again
_ROLES = ("technician", "clinician", "researcher", "administrator")
_PAGES = ("/", "/patients/", "/rigs/", "/jobs/", "/study/", "/people/", "/audit/", "/backups/")


def unpacked(version: str, what: str, folder: Path) -> Path:
    """The session or the clinic of a version, in a folder."""
    with tarfile.open(EXAMPLES / version / f"{what}.tar.xz") as archive:
        archive.extractall(folder, filter="data")
    return folder / what


def in_process(*words: str) -> Any:
    """What this module prints when it is called so: Django is set up once a process."""
    done = subprocess.run([sys.executable, "-m", "tests.released", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout)


def make_session(folder: Path) -> dict[str, Any]:
    """A tiny session: measured, a landmark drawn, every setting written down. Its volume and interval."""
    from tests.scenes.conftest import TINY, TINY_SETTINGS

    from mammometry.api.job import open_session
    from mammometry.io.drawn_changes import ItemChange, change_drawn
    from mammometry.settings import Settings
    from mammometry.simulate.session import write_session

    write_session(folder, TINY, truth=False)
    open_session(folder).calibrate()
    shutil.copy(folder / "results/calibrate/cameras.json", folder / "cameras.json")
    for name in ("calibration", "results"):  # a megabyte of photographs
        shutil.rmtree(folder / name)
    (folder / SETTINGS).write_text(TINY_SETTINGS, encoding="utf-8")
    settings = Settings.load(folder / SETTINGS)
    (folder / SETTINGS).write_text(settings.to_toml(), encoding="utf-8")
    vertices = open_session(folder, settings=settings).surface().repaired.mesh.vertices
    nipple = [round(float(value), 3) for value in vertices[vertices[:, 2].argmax()]]
    entry = {"points": [nipple], "author": "A. Nurse"}
    change_drawn(folder, "model", {("landmarks", "nipple_model"): ItemChange(entry=entry, base=None)})
    results = open_session(folder, settings=settings).run()
    for name in _HEAVY:
        shutil.rmtree(folder / "results" / name)
    return {
        "nipple_model": nipple,
        "volume_cc": results.volumes_cc["model"],
        "interval_cc": results.intervals_cc["model"],
    }


def make_clinic(folder: Path) -> None:
    """A clinic with a row or more of each kind."""
    from datetime import UTC, date, datetime

    from tests.clinic_seed import DEFINITION

    from mammometry.clinic.config import new_clinic
    from mammometry.clinic.web.server import migrate

    migrate(new_clinic(folder, name="Clinic of this version", second_factor="offered"))
    from mammometry.clinic import models as m

    at = datetime(2026, 11, 26, 9, 30, tzinfo=UTC)
    people = {role: m.Person.objects.create(username=role, roles=[role], full_name=f"Ä. {role}") for role in _ROLES}
    by = people["clinician"]
    rig = m.Rig.objects.create(name="Room 1", definition=DEFINITION)
    calibration = m.Calibration.objects.create(rig=rig, taken_at=at, folder="rigs/1", state="done", current=True)
    check = m.DailyCheck.objects.create(rig=rig, calibration=calibration, taken_at=at, passed=True, verdict="still")
    patient = m.Patient.objects.create(
        family_name="Ö'Neill", given_name="Quirina", born=date(1970, 2, 28), record_number="KIS-4711", note="a note"
    )
    m.Consent.objects.create(patient=patient, purpose="research", given_on=at.date(), entered_by=by)
    m.Operation.objects.create(patient=patient, kind="implant", side="left", day=at.date(), volume_cc=250.0)
    destination = m.Destination.objects.create(name="PACS", address="ARCHIVE@archive.example:104")
    visits = []
    for days, volume_cc in ((1, 301.25), (20, 322.5)):
        visit = m.Visit.objects.create(
            patient=patient, rig=rig, calibration=calibration, taken_at=at.replace(day=days), state="measured"
        )
        (visit.folder / "capture").mkdir(parents=True)
        (visit.folder / "capture" / "front_left.jpg").write_bytes(b"a photograph")
        m.Upload.objects.create(visit=visit, camera="front_left", size_bytes=12, state="placed", sha256="ab" * 32)
        job = m.Job.objects.create(visit=visit, kind="measure", state="done", created_by=by)
        made = m.Measurement.objects.create(visit=visit, job=job, digest="cd" * 32, made_at=at, software="1")
        m.Volume.objects.create(
            measurement=made,
            side="left",
            definition="crease",
            leads=True,
            volume_cc=volume_cc,
            low_cc=290.0,
            high_cc=340.0,
        )
        m.Volume.objects.create(measurement=made, side="right", definition="crease", refused="too little is seen")
        m.Drawing.objects.create(visit=visit, item="left", action="drawn", by=by)
        m.Confirmation.objects.create(measurement=made, by=by)
        m.Conclusion.objects.create(visit=visit, measurement=made, text="As expected.", by=by)
        m.Delivery.objects.create(visit=visit, destination=destination, state="sent")
        visits.append(visit)
    m.Correction.objects.create(kind="visit", visit=visits[0], reason="a wrong day", by=by)
    m.Comparison.objects.create(before=visits[0], after=visits[1], state="failed", message="too far apart")
    m.Job.objects.create(check_of_day=check, kind="check", state="done")
    m.Scan.objects.create(visit=visits[1], scanner="telephone", units="m", sha256="ef" * 32)
    m.VisitOrder.objects.create(visit=visits[0], accession="A-1")


def move_to_postgresql(folder: Path) -> None:
    """Bring a clinic's rows to its new, empty PostgreSQL: tables of the same version, by the migrations of then."""
    from django.core.management.color import no_style
    from django.db import connection, connections, transaction
    from django.db.migrations.executor import MigrationExecutor

    from mammometry.clinic.config import read_config
    from mammometry.clinic.site import configure, database

    config = read_config(folder)
    configure(config)
    sqlite = database(config.model_copy(update={"database": "sqlite"}))
    connections.databases["sqlite"] = {**connections.databases["default"], **sqlite}
    executor = MigrationExecutor(connection)
    applied = list(MigrationExecutor(connections["sqlite"]).loader.applied_migrations)
    state = executor.migrate(applied)
    models = state.apps.get_models(include_auto_created=True)
    with transaction.atomic():  # references are checked at its end
        for model in models:
            model._base_manager.using("default").bulk_create(model._base_manager.using("sqlite").all())
        with connection.cursor() as cursor:
            for line in connection.ops.sequence_reset_sql(no_style(), models):
                cursor.execute(line)
    (folder / "clinic.sqlite3").unlink()


def look(folder: Path) -> dict[str, Any]:
    """Rows by kind, what the volumes are, and how each role's pages answer."""
    from mammometry.clinic.config import read_config
    from mammometry.clinic.site import configure

    configure(read_config(folder).model_copy(update={"hosts": ("testserver",)}))
    from auditlog.models import LogEntry
    from django.apps import apps
    from django.test import Client

    from mammometry.clinic.models import Patient, Person, Visit, Volume

    rows = {model._meta.label: model._base_manager.count() for model in apps.get_app_config("clinic").get_models()}
    volumes = Volume.objects.order_by("measurement__visit__taken_at", "side")
    table: dict[str, Any] = {
        "rows": rows,
        "audit": LogEntry.objects.count(),
        "names": [patient.family_name for patient in Patient.objects.all()],
        "volumes": [[row.side, row.volume_cc, row.refused] for row in volumes],
        "pages": {},
    }
    visits = [f"/visits/{visit.pk}/" for visit in Visit.objects.order_by("taken_at")]
    patients = [f"/patients/{patient.pk}/" for patient in Patient.objects.all()]
    for role in _ROLES:
        client = Client()
        client.force_login(
            Person.objects.get(username=role), backend="allauth.account.auth_backends.AuthenticationBackend"
        )
        table["pages"][role] = [client.get(path).status_code for path in (*_PAGES, *patients, *visits)]
    return table


def main() -> None:
    """Make the examples of this version."""
    folder = EXAMPLES / mammometry.__version__
    if folder.exists():
        raise SystemExit(f"{folder} is there: what a released version left is never made again")
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(scratch)
        session = make_session(work / "session")
        in_process("clinic", str(work / "clinic"))
        folder.mkdir(parents=True)
        for what in ("session", "clinic"):
            with tarfile.open(folder / f"{what}.tar.xz", "w:xz") as archive:
                archive.add(work / what, what)
        command("backup", str(work / "clinic"), "--to", str(work / "backup.tar"))
        (folder / "backup.tar.xz").write_bytes(lzma.compress((work / "backup.tar").read_bytes()))
        clinic = in_process("look", str(work / "clinic"))
    (folder / "expected.json").write_text(json.dumps({"session": session, "clinic": clinic}, indent=1) + "\n")
    print(f"{folder}: {sum(path.stat().st_size for path in folder.iterdir()) / 1000:.0f} kB")  # noqa: T201


if __name__ == "__main__":
    if sys.argv[1:]:
        done = {"clinic": make_clinic, "look": look, "move": move_to_postgresql}[sys.argv[1]](Path(sys.argv[2]))
        sys.stdout.write(json.dumps(done) + "\n")
    else:
        main()
