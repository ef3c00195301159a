"""Backup, restore, export and erase, by doing them."""

import datetime
import io
import json
import lzma
import os
import shutil
import subprocess
import sys
import tarfile
import uuid
import zipfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest
from auditlog.models import LogEntry
from django.contrib.contenttypes.models import ContentType
from django.db import connection
from django.test import Client
from pytest_django import Settings
from tests.clinic_server import command
from tests.postgresql import VARIABLE, new_database
from tests.released import EXAMPLES, in_process

from mammometry.cli.main import run
from mammometry.clinic.config import ClinicConfig, ClinicError, new_clinic, read_config
from mammometry.clinic.maintenance.backups import exclusive, make_backup, make_kept_backup
from mammometry.clinic.maintenance.patient import copies, erase_patient, find_patient
from mammometry.clinic.maintenance.restore import _require_measures_the_same, unpack
from mammometry.clinic.maintenance.rows import digests_of, require_same
from mammometry.clinic.models import (
    Delivery,
    Destination,
    Drawing,
    Job,
    Measurement,
    Patient,
    Rig,
    Upload,
    Visit,
    Volume,
)
from mammometry.clinic.roles import Role

MARK = b"photograph of quirina"


@pytest.fixture
def full(visit: Visit) -> Visit:
    """A visit with a photograph, an upload, a job and results."""
    from django.utils import timezone

    now = timezone.now()
    (visit.folder / "capture").mkdir(parents=True)
    (visit.folder / "capture" / "front_left.jpg").write_bytes(MARK)
    upload = Upload.objects.create(visit=visit, camera="front_left", size_bytes=9)
    upload.path.write_bytes(b"half of it")
    job = Job.objects.create(visit=visit, kind=Job.Kind.MEASURE, state=Job.State.DONE)
    measurement = Measurement.objects.create(visit=visit, job=job, digest="ab" * 32, made_at=now, software="0")
    Volume.objects.create(measurement=measurement, side="left", definition="crease", volume_cc=301.25, low_cc=290.0)
    Drawing.objects.create(visit=visit, item="left", action="drawn")
    return visit


@contextmanager
def another_database() -> Iterator[list[str]]:
    """Options that name an empty database of the kind that is tested."""
    with ExitStack() as stack:
        address = os.environ.get(VARIABLE)
        if address is None:
            yield []
        else:
            yield ["--database", stack.enter_context(new_database(address, f"restored_{uuid.uuid4().hex}"))]


@pytest.mark.slow
@pytest.mark.requirement("R-KEEP-1")
def test_a_restored_clinic_is_the_same(clinic: ClinicConfig, full: Visit, tmp_path: Path, settings: Settings) -> None:
    settings.MIGRATION_MODULES = {}  # which the tests leave out to be quick
    archive, again = tmp_path / "clinic.tar", tmp_path / "again.tar"
    make_backup(clinic, archive)
    assert archive.stat().st_mode & 0o077 == 0
    with another_database() as options:
        command("restore", str(archive), str(tmp_path / "restored"), *options)
        command("backup", str(tmp_path / "restored"), "--to", str(again))
    assert rows(again) == rows(archive)
    # 1 each but the patient, rig and so on: all that `full` made is there
    labels = [json.loads(line)["model"] for line in rows(again)]
    for label in ("patient", "rig", "visit", "upload", "job", "measurement", "volume", "drawing"):
        assert labels.count(f"clinic.{label}") == 1
    assert labels.count("auditlog.logentry") >= 8
    kept = f"sessions/{full.id}/capture/front_left.jpg"
    assert (tmp_path / "restored" / kept).read_bytes() == MARK
    assert (tmp_path / "restored" / "secret.key").read_text() == (clinic.folder / "secret.key").read_text()
    assert not (tmp_path / "restored.restoring").exists()


def rows(archive: Path) -> list[str]:
    with tarfile.open(archive) as tar:
        file = tar.extractfile("database.jsonl")
        assert file is not None
        return file.read().decode().splitlines()


@pytest.mark.slow
def test_a_restore_is_tested_and_the_page_says_so(
    clinic: ClinicConfig, full: Visit, client_of: Callable[..., Client], settings: Settings
) -> None:
    """A whole backup comes back the same; one with a changed row is named."""
    settings.MIGRATION_MODULES = {}
    made = make_kept_backup(clinic)
    answer = command("test-restore", str(clinic.folder))
    with tarfile.open(made) as tar:
        kept = {member.name for member in tar if member.isfile()} - {"database.jsonl", "manifest.json"}
    assert answer["files"] == len(kept)
    assert {"clinic.toml", "secret.key", f"sessions/{full.id}/capture/front_left.jpg"} <= kept
    page = client_of(Role.ADMINISTRATOR).get("/backups/").content.decode()
    assert f"✓ {made.name}" in page
    with tarfile.open(made, "a") as tar:  # a manifest of what was not there
        manifest = json.dumps({"sha256": {"sessions/lost.jpg": "0" * 64}}).encode()
        entry = tarfile.TarInfo("manifest.json")
        entry.size = len(manifest)
        tar.addfile(entry, io.BytesIO(manifest))
    assert run(["clinic", "test-restore", str(clinic.folder)]) == ClinicError.exit_code
    page = client_of(Role.ADMINISTRATOR).get("/backups/").content.decode()
    assert f"✕ {made.name}" in page
    assert not list(clinic.backups.glob("restore-test-*"))


def test_rows_that_differ_are_named() -> None:
    lines = [b'{"model": "clinic.rig", "pk": 1, "fields": {}}', b'{"model": "clinic.rig", "pk": 2, "fields": {}}']
    same = digests_of(lines)
    assert same == digests_of(reversed(lines))
    require_same(same, digests_of(lines))
    with pytest.raises(ClinicError, match=r"clinic: .*clinic\.rig: 1 lost, .*\b2\b"):
        require_same(same, digests_of(lines[:1]))
    with pytest.raises(ClinicError, match=r"clinic: .*\b1 changed, .*\b2\b"):
        require_same(same, digests_of([lines[0], lines[1].replace(b"{}", b'{"name": "x"}')]))


@pytest.mark.parametrize(
    ("before", "after", "is_same"),
    [
        ("2026-11-26T13:21:38.000Z", "2026-11-26T13:21:38+00:00", True),  # as 1.0 wrote it
        ("2026-11-26T13:21:38.120Z", "2026-11-26T13:21:38.120000+00:00", True),
        ("2026-11-26T13:21:38.000838+00:00", "2026-11-26T13:21:38+00:00", False),
        ("2026-11-26T13:21:38.12Z", "2026-11-26T13:21:38.120001+00:00", False),
    ],
)
def test_a_time_is_compared_to_the_microsecond(before: str, after: str, is_same: bool) -> None:
    first, second = (
        digests_of([json.dumps({"model": "m", "pk": 1, "fields": {"at": at}}).encode()]) for at in (before, after)
    )
    assert (first == second) is is_same


def enter(microseconds: Iterable[int]) -> None:
    """Entries of the audit at these microseconds of a second."""
    kind, at = ContentType.objects.get_for_model(Rig), datetime.datetime(2026, 11, 28, 12, 0, 38, tzinfo=datetime.UTC)
    LogEntry.objects.bulk_create(
        LogEntry(content_type=kind, object_pk="x", object_repr="x", action=3, timestamp=at.replace(microsecond=number))
        for number in microseconds
    )


@pytest.mark.requirement("R-KEEP-1")
def test_microseconds_are_kept_in_a_backup(clinic: ClinicConfig, tmp_path: Path) -> None:
    chosen = [0, 1, 838, 1000, 120_000, 999_999]
    enter(chosen)
    make_backup(clinic, tmp_path / "clinic.tar")
    written = [json.loads(line)["fields"].get("timestamp") for line in rows(tmp_path / "clinic.tar")]
    times = [datetime.datetime.fromisoformat(text).microsecond for text in written if text and "12:00:38" in text]
    assert times == chosen


@pytest.mark.slow
@pytest.mark.requirement("R-KEEP-1")
def test_a_restore_with_20_000_entries_at_random_microseconds_is_the_same(
    clinic: ClinicConfig, settings: Settings
) -> None:
    settings.MIGRATION_MODULES = {}
    enter(np.random.default_rng(0).integers(0, 1_000_000, 20_000).tolist())
    make_kept_backup(clinic)
    answer = command("test-restore", str(clinic.folder), timeout_s=400)
    assert int(str(answer["rows"])) >= 20_000


@pytest.mark.slow
@pytest.mark.requirement("R-KEEP-1")
@pytest.mark.parametrize("version", sorted(path.parent.name for path in EXAMPLES.glob("*/backup.tar.xz")))
def test_a_backup_of_a_release_is_restored(version: str, tmp_path: Path) -> None:
    """Tables as that version had them are made and filled, and then brought to this version."""
    archive = tmp_path / "clinic.tar"
    archive.write_bytes(lzma.decompress((EXAMPLES / version / "backup.tar.xz").read_bytes()))
    expected = json.loads((EXAMPLES / version / "expected.json").read_text())["clinic"]
    with another_database() as options:
        command("restore", str(archive), str(tmp_path / "restored"), *options)
        found = in_process("look", str(tmp_path / "restored"))
        assert command("upgrade", str(tmp_path / "restored"))["applied"] == []
    for what in ("names", "volumes", "pages"):
        assert found[what] == expected[what]
    assert {name: count for name, count in found["rows"].items() if name in expected["rows"]} == expected["rows"]
    (tmp_path / "restored" / "backups" / "clinic-20260101-000000.tar").write_bytes(archive.read_bytes())
    command("test-restore", str(tmp_path / "restored"))


def small_clinic(folder: Path) -> ClinicConfig:
    """A clinic with settings of its own, and two rigs that this computer drives: one's file is elsewhere."""
    config = new_clinic(folder, name="Clinic")
    (folder / "settings.toml").write_text('[measure]\nwall = "membrane"\n')
    (folder / "cables").mkdir()
    (folder / "cables" / "rig.toml").write_text("of one")
    (folder.parent / "rig.toml").write_text("of two")
    with (folder / "clinic.toml").open("a") as file:
        file.write('\n[cameras]\n"one" = "cables/rig.toml"\n"two" = "../rig.toml"\n')
    (folder / "stow-secret-of-an-archive").write_text("secret")
    return read_config(config.folder)


@pytest.mark.requirement("R-KEEP-1")
def test_a_backup_holds_what_changes_a_number(clinic: ClinicConfig, tmp_path: Path) -> None:
    config = small_clinic(tmp_path / "clinic")
    make_backup(config, config.backups / "clinic-20260101-000000.tar")
    shutil.rmtree(tmp_path / "clinic" / "cables")
    (tmp_path / "rig.toml").unlink()
    restored, manifest = unpack(config.backups / "clinic-20260101-000000.tar", tmp_path / "deep" / "restored")
    assert restored.measuring().measure.wall == "membrane"
    files = {rig: (restored.folder / name).read_text() for rig, name in restored.cameras.items()}
    assert files == {"one": "of one", "two": "of two"}
    assert (restored.folder / "stow-secret-of-an-archive").is_file()
    assert not list(restored.folder.glob("clinic.sqlite3*"))
    _require_measures_the_same(config, restored, manifest)
    (restored.folder / "settings.toml").unlink()
    with pytest.raises(ClinicError, match=r"settings\.toml"):
        _require_measures_the_same(config, restored, manifest)


def test_a_backup_of_1_0_without_the_settings_is_refused_by_the_restore_test(
    clinic: ClinicConfig, tmp_path: Path
) -> None:
    config = small_clinic(tmp_path / "clinic")
    bare = new_clinic(tmp_path / "bare", name="Clinic")
    with pytest.raises(ClinicError, match=r"settings\.toml|rig\.toml"):
        _require_measures_the_same(config, bare, {})


@pytest.mark.requirement("R-KEEP-2")
def test_what_a_killed_backup_left_goes_before_the_next_and_with_an_erased_patient(
    clinic: ClinicConfig, full: Visit
) -> None:
    part, scratch = clinic.backups / "clinic-20260101-000000.tar.part", clinic.backups / "restore-test-xyz"

    def killed() -> None:
        part.write_bytes(b"Zypernkatze")
        part.chmod(0o644)
        scratch.mkdir()
        (scratch / "database.jsonl").write_bytes(b"Zypernkatze")

    killed()
    made = make_kept_backup(clinic)
    assert not part.exists()
    assert not scratch.exists()
    made.unlink()
    killed()
    with exclusive(clinic):  # one is at work: its files are not taken away, and are named
        part.write_bytes(b"Zypernkatze")
        assert any(part.name in copy for copy in copies(clinic, full.patient))
    erase_patient(clinic, full.patient)
    assert not part.exists()
    assert not [path for path in clinic.folder.rglob("*") if path.is_file() and b"Zypernkatze" in path.read_bytes()]


def test_a_file_of_a_killed_backup_with_a_wide_mode_is_not_written_into(clinic: ClinicConfig, tmp_path: Path) -> None:
    part = tmp_path / "clinic.tar.part"
    part.write_bytes(b"")
    part.chmod(0o666)
    reader = part.open("rb")
    make_backup(clinic, tmp_path / "clinic.tar")
    assert (tmp_path / "clinic.tar").stat().st_mode & 0o077 == 0
    assert reader.read() == b""  # whoever had it open reads nothing of the new one
    reader.close()


@pytest.mark.requirement("R-KEEP-2")
def test_the_page_of_an_erasure_names_every_copy(
    clinic: ClinicConfig, full: Visit, client_of: Callable[..., Client], tmp_path: Path
) -> None:
    made = make_kept_backup(clinic)
    run(["clinic", "backup", str(clinic.folder), "--to", str(tmp_path / "other.tar")])
    run(["clinic", "export", str(clinic.folder), "KIS-4711", "--to", str(tmp_path / "export.zip")])
    archive = Destination.objects.create(name="Archive of the house", address="A@b:104")
    Delivery.objects.create(visit=full, destination=archive, state="sent", sent=3)
    client, pseudonym = client_of(Role.ADMINISTRATOR), full.patient.pseudonym
    page = client.get("/erase/", {"pseudonym": pseudonym}).content.decode()
    after = client.post("/erase/", {"pseudonym": pseudonym, "again": pseudonym}).content.decode()
    for copy in (made.name, str(tmp_path / "other.tar"), "Archive of the house", "The export of"):
        assert copy in page
        assert copy in after


@pytest.mark.requirement("R-KEEP-1")
def test_a_damaged_backup_is_refused(clinic: ClinicConfig, full: Visit, tmp_path: Path) -> None:
    archive = tmp_path / "clinic.tar"
    run(["clinic", "backup", str(clinic.folder), "--to", str(archive)])
    content = archive.read_bytes()
    archive.write_bytes(content.replace(MARK, MARK.upper()))
    with pytest.raises(ClinicError, match=r"^clinic\.tar: .*\b1 damaged"):
        unpack(archive, tmp_path / "restored")
    archive.write_bytes(content[: len(content) // 2])
    with pytest.raises(ClinicError, match=r"^clinic\.tar: .*backup"):
        unpack(archive, tmp_path / "restored")
    assert not (tmp_path / "restored").exists()


def test_a_backup_cannot_leave_its_folder(tmp_path: Path) -> None:
    archive = tmp_path / "evil.tar"
    (tmp_path / "payload").write_text("x")
    with tarfile.open(archive, "w") as tar:
        tar.add(tmp_path / "payload", arcname="../../escaped")
    with pytest.raises(ClinicError, match=r"^evil\.tar: .*backup"):
        unpack(archive, tmp_path / "deep" / "restored")
    assert not (tmp_path / "escaped").exists()


@pytest.mark.requirement("R-KEEP-1")
def test_restore_replaces_nothing(clinic: ClinicConfig, tmp_path: Path) -> None:
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "file").write_text("mine")
    with pytest.raises(ClinicError, match="folder"):
        unpack(tmp_path / "any.tar", tmp_path / "used")
    assert (tmp_path / "used" / "file").read_text() == "mine"


def test_an_export_holds_all_of_one_patient_and_nothing_of_others(
    clinic: ClinicConfig, full: Visit, tmp_path: Path
) -> None:
    other = Patient.objects.create(family_name="Andere", given_name="Ada", record_number="2")
    Visit.objects.create(patient=other, rig=full.rig, taken_at=full.taken_at)
    target = tmp_path / "export.zip"
    assert run(["clinic", "export", str(clinic.folder), "KIS-4711", "--to", str(target)]) == 0
    with zipfile.ZipFile(target) as archive:
        table = json.loads(archive.read("patient.json"))
        assert archive.read(f"sessions/{full.id}/capture/front_left.jpg") == MARK
        audit = archive.read("audit.csv").decode()
    kinds = [row["model"].removeprefix("clinic.") for row in table]
    assert kinds == ["patient", "visit", "upload", "job", "measurement", "volume", "drawing"]
    assert table[0]["fields"]["family_name"] == "Zypernkatze"
    assert "Andere" not in json.dumps(table)
    assert "create,visit" in audit.replace('"', "")
    assert target.stat().st_mode & 0o077 == 0


def test_an_export_takes_files_of_any_date_and_name(clinic: ClinicConfig, full: Visit, tmp_path: Path) -> None:
    os.utime(full.folder / "capture" / "front_left.jpg", (0, 0))  # a camera whose clock was never set
    (full.folder / os.fsdecode(b"n\xffte.txt")).write_text("kept")
    target = tmp_path / "export.zip"
    assert run(["clinic", "export", str(clinic.folder), "KIS-4711", "--to", str(target)]) == 0
    with zipfile.ZipFile(target) as archive:
        assert archive.read(f"sessions/{full.id}/capture/front_left.jpg") == MARK
        assert archive.getinfo(f"sessions/{full.id}/capture/front_left.jpg").date_time[0] == 1980
        assert archive.read(f"sessions/{full.id}/n\\xffte.txt") == b"kept"


@pytest.mark.requirement("R-KEEP-2")
def test_an_erased_patient_is_gone(clinic: ClinicConfig, full: Visit, tmp_path: Path) -> None:
    folder, upload, pseudonym = full.folder, Upload.objects.get().path, full.patient.pseudonym
    other = Patient.objects.create(family_name="Andere", given_name="Ada", record_number="2")
    kept = Visit.objects.create(patient=other, rig=full.rig, taken_at=full.taken_at)
    kept.folder.mkdir()
    assert run(["clinic", "erase", str(clinic.folder), pseudonym, "--yes"]) == 0
    assert not folder.exists()
    assert not upload.exists()
    assert list(Patient.objects.all()) == [other]
    assert list(Visit.objects.all()) == [kept]
    assert kept.folder.is_dir()
    for model in (Upload, Job, Measurement, Volume, Drawing):
        assert not model._default_manager.exists()
    entries = list(LogEntry.objects.filter(object_repr__startswith=pseudonym))
    assert {entry.get_action_display() for entry in entries} >= {"create", "delete", "access"}
    with connection.cursor() as cursor:
        cursor.execute("SELECT * FROM auditlog_logentry")
        assert "Zypernkatze" not in repr(cursor.fetchall())
    with pytest.raises(ClinicError):
        find_patient(pseudonym)


def test_a_patient_who_is_being_measured_is_not_erased(clinic: ClinicConfig, full: Visit) -> None:
    from datetime import timedelta

    from django.utils import timezone

    Job.objects.update(state=Job.State.RUNNING, lease_until=timezone.now() + timedelta(minutes=1))
    assert run(["clinic", "erase", str(clinic.folder), full.patient.pseudonym, "--yes"]) == ClinicError.exit_code
    assert full.folder.is_dir()
    assert Patient.objects.count() == 1


def test_a_file_of_that_name_is_not_replaced(clinic: ClinicConfig, full: Visit, tmp_path: Path) -> None:
    target = tmp_path / "mine"
    target.write_text("mine")
    folder = str(clinic.folder)
    for words in (["backup", folder], ["export", folder, "KIS-4711"], ["audit", folder]):
        assert run(["clinic", *words, "--to", str(target)]) == ClinicError.exit_code
    assert target.read_text() == "mine"


# Makes a patient with a visit in a database on disk; with the word erase, erases it.
_LIFE = """
import sys
from pathlib import Path
from mammometry.clinic.config import read_config
from mammometry.clinic.site import configure
config = read_config(Path(sys.argv[1]))
configure(config)
from mammometry.clinic.web.server import migrate
migrate(config)
from django.db import connections
from django.utils import timezone
from mammometry.clinic.maintenance.patient import erase_patient
from mammometry.clinic.models import Patient, Rig, Visit
if sys.argv[2] == "erase":
    erase_patient(config, Patient.objects.get(record_number="KIS-4711"))
else:
    for number in range(200):
        name = "Zypernkatze" if number == 77 else f"Name{number}"
        patient = Patient.objects.create(family_name=name, given_name="Q", record_number=f"KIS-{4634 + number}")
    patient = Patient.objects.get(record_number="KIS-4711")
    rig = Rig.objects.create(name="r")
    visit = Visit.objects.create(patient=patient, rig=rig, taken_at=timezone.now(), note="Zypernkatze hinkt")
    visit.folder.mkdir()
    (visit.folder / "session.toml").write_text(patient.pseudonym)
connections.close_all()
"""


@pytest.mark.slow
@pytest.mark.requirement("R-KEEP-2")
def test_no_byte_of_an_erased_name_is_left_in_the_folder(tmp_path: Path) -> None:
    from mammometry.clinic.config import new_clinic

    folder = tmp_path / "clinic"
    new_clinic(folder, name="Clinic")

    def where() -> list[str]:
        found = [path for path in folder.rglob("*") if path.is_file() and b"Zypernkatze" in path.read_bytes()]
        return sorted(path.name for path in found)

    for word in ("make", "erase"):
        done = subprocess.run(
            [sys.executable, "-c", _LIFE, str(folder), word], capture_output=True, text=True, timeout=120, check=False
        )
        assert done.returncode == 0, done.stderr
        if word == "make":
            assert where() == ["clinic.sqlite3"]
    assert where() == []
    assert list((folder / "sessions").iterdir()) == []
