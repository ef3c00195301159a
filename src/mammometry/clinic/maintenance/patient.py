"""Find, export and erase one patient's data."""

import io
import json
import shutil
import zipfile
from pathlib import Path
from typing import Any

from auditlog.models import LogEntry
from django.core import serializers
from django.db import connection, transaction
from django.db.models import Model, Q
from django.utils import timezone

from mammometry.base.csv_cells import CsvWriter
from mammometry.base.identity import as_utf_8
from mammometry.clinic import audit
from mammometry.clinic.config import ClinicConfig, ClinicError, new_private
from mammometry.clinic.intake import walks
from mammometry.clinic.maintenance.backups import PART, elsewhere, remove_leftovers, unfinished
from mammometry.clinic.maintenance.rows import RowEncoder
from mammometry.clinic.models import (
    Comparison,
    Conclusion,
    Confirmation,
    Consent,
    Correction,
    Delivery,
    Drawing,
    Job,
    Measurement,
    NoteChange,
    Operation,
    Patient,
    Person,
    Scan,
    Upload,
    Visit,
    VisitOrder,
    Volume,
    Walk,
)


def find_patient(word: str) -> Patient:
    """The patient with this pseudonym or record number, also if in the bin.

    For a merged record, the one that now has its visits.

    Raises:
        ClinicError: there is none.
    """
    rows = Patient.everything.select_related("merged_into")
    patient = rows.filter(Q(pseudonym=word) | Q(record_number=word)).first()
    if patient is None:
        remedy = "Look for the patient in the clinic; the page says the pseudonym"
        raise ClinicError("patient", found="no such patient", expected="a pseudonym or record number", remedy=remedy)
    return patient.merged_into or patient


def rows_of(patient: Patient) -> list[Model]:
    """All rows about a patient. Each comes after the rows that it refers to."""
    visits = list(Visit.everything.filter(patient=patient).order_by("taken_at"))
    records = [patient, *Patient.everything.filter(merged_into=patient)]
    queries: list[Any] = [
        Consent.objects.filter(patient=patient),
        Operation.objects.filter(patient=patient),
        Upload.objects.filter(visit__in=visits),
        Comparison.objects.filter(after__in=visits),
        Delivery.objects.filter(visit__in=visits),
        Job.objects.filter(Q(visit__in=visits) | Q(comparison__after__in=visits) | Q(delivery__visit__in=visits)),
        Measurement.objects.filter(visit__in=visits),
        Volume.objects.filter(measurement__visit__in=visits),
        Confirmation.objects.filter(measurement__visit__in=visits),
        Conclusion.objects.filter(visit__in=visits),
        Correction.objects.filter(Q(visit__in=visits) | Q(patient__in=records)),
        Drawing.objects.filter(visit__in=visits),
        VisitOrder.objects.filter(visit__in=visits),
        Scan.objects.filter(visit__in=visits),
        Walk.objects.filter(visit__in=visits),
        NoteChange.objects.filter(Q(patient__in=records) | Q(visit__in=visits)),
    ]
    return [*records, *visits, *(row for query in queries for row in query)]


def export_patient(config: ClinicConfig, patient: Patient, target: Path) -> int:
    """Write one patient's data (rows, session folders, audit) as a ZIP that only its owner can read.

    Returns:
        Number of files in the ZIP.

    Raises:
        ClinicError: the file exists already.
    """
    if target.exists():
        raise ClinicError(str(target), found="a file", expected="none", remedy="Name another file with --to")
    part = target.with_name(target.name + PART)
    rows = rows_of(patient)
    with (
        new_private(part) as stream,
        zipfile.ZipFile(
            stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1, strict_timestamps=False
        ) as archive,  # files dated before 1980 get that year, the earliest in a ZIP
    ):
        plain = json.loads(serializers.serialize("json", rows, cls=RowEncoder))
        archive.writestr("patient.json", json.dumps(plain, indent=1, ensure_ascii=False))
        archive.writestr("audit.csv", _audit_of(rows))
        for visit in (row for row in rows if isinstance(row, Visit)):
            for path in sorted(visit.folder.rglob("*")):
                if path.is_file() and not path.is_symlink():
                    name = as_utf_8(path.relative_to(visit.folder).as_posix())
                    archive.write(path, f"sessions/{visit.id}/{name}")
        number = len(archive.namelist())
    part.replace(target)
    audit.record_command(patient, "export")
    return number


def erase_patient(config: ClinicConfig, patient: Patient, by: Person | None = None) -> int:
    """Erase one patient: first the files, then the rows.

    After a kill, the same command continues. Audit entries with the pseudonym, and earlier backups, remain.

    Args:
        config: settings of the open clinic.
        patient: the patient to erase.
        by: user of the page; None for a command.

    Returns:
        Number of visits erased.

    Raises:
        ClinicError: one of the patient's visits is being measured.
    """
    visits = list(Visit.everything.filter(patient=patient))
    _erase_visits(patient, visits, by)
    remove_leftovers(config)
    with transaction.atomic():
        patient.delete()
    _overwrite()
    return len(visits)


def erase_bin(patient: Patient) -> int:
    """Erase a patient's visits in the bin, in the same way as `erase_patient`.

    Returns:
        Number of visits erased.

    Raises:
        ClinicError: one of them is being measured.
    """
    visits = list(Visit.everything.filter(patient=patient).exclude(binned_at=None))
    _erase_visits(patient, visits)
    _overwrite()
    return len(visits)


def copies(config: ClinicConfig, patient: Patient) -> list[str]:
    """Copies of a patient's data outside the clinic's rows and files, one sentence each.

    These are backups (also unfinished ones, and those that a command wrote elsewhere), results sent to archives, and
    exports for the patient. Later copies of these files are unknown to the clinic.
    """
    backups = sorted(path.name for path in config.backups.glob("*.tar"))
    known = [f"The backup{'s' if len(backups) > 1 else ''} {', '.join(backups)}"] if backups else []
    known += [f"{path.name}, which is unfinished: a backup or a restore test is running" for path in unfinished(config)]
    known += [f"The backup {path}" for path in elsewhere(config)]
    sent = Delivery.objects.filter(visit__in=Visit.everything.filter(patient=patient), sent__gt=0)
    for name in sorted(set(sent.values_list("destination__name", flat=True))):
        known.append(f"The archive {name}, to which results were sent")
    keys = [str(record.pk) for record in (patient, *Patient.everything.filter(merged_into=patient))]
    exports = LogEntry.objects.filter(object_pk__in=keys, action=LogEntry.Action.ACCESS)
    for entry in exports.filter(additional_data__page="command export").order_by("pk"):
        known.append(f"The export of {timezone.localtime(entry.timestamp).date().isoformat()}, made by a command")
    return known


def _erase_visits(patient: Patient, visits: list[Visit], by: Person | None = None) -> None:
    compared = Q(comparison__after__in=visits) | Q(comparison__before__in=visits)
    jobs = Job.objects.filter(Q(visit__in=visits) | Q(delivery__visit__in=visits) | compared)
    jobs.filter(state=Job.State.QUEUED).update(state=Job.State.CANCELLED)
    running = jobs.filter(state=Job.State.RUNNING, lease_until__gt=timezone.now())
    if running.exists():
        found = "a visit that is being measured or sent"
        remedy = "Cancel the job or wait until it ends, then repeat the command"
        raise ClinicError(patient.pseudonym, found=found, expected="none", remedy=remedy)
    audit.record_command(patient, "erase", by)
    for upload in Upload.objects.filter(visit__in=visits):
        for path in upload.path.parent.glob(f"{upload.id}*"):
            path.unlink(missing_ok=True)
    for visit in visits:
        walks.erase(visit)
        if visit.folder.exists():
            shutil.rmtree(visit.folder)
    with transaction.atomic():
        for visit in visits:
            visit.delete()


def _overwrite() -> None:
    """Remove the erased rows from the database's own files."""
    if connection.in_atomic_block:
        return
    with connection.cursor() as cursor:
        if connection.vendor == "postgresql":
            for model in (Patient, Visit):
                cursor.execute(f"VACUUM FULL {connection.ops.quote_name(model._meta.db_table)}")
        else:
            cursor.execute("PRAGMA wal_checkpoint(TRUNCATE)")  # freed pages are overwritten because of secure_delete


def _audit_of(rows: list[Model]) -> str:
    file = io.StringIO()
    writer = CsvWriter(file)
    writer.row(("time", "who", "action", "what", "changes"))
    keys = [str(row.pk) for row in rows]
    entries = LogEntry.objects.select_related("content_type", "actor").order_by("pk")
    for start in range(0, len(keys), 500):
        for entry in entries.filter(object_pk__in=keys[start : start + 500]):
            what = entry.content_type.model if entry.content_type else ""
            writer.row(
                (entry.timestamp.isoformat(), entry.actor or "", entry.get_action_display(), what, entry.changes_str)
            )
    return file.getvalue()
