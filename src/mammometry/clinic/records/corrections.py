"""Corrections of records, each with a reason, and undoing them.

A visit can be moved to another patient or get another day. Two records of one patient can be merged. A visit, or a
record without visits, can be put into the bin. Nothing is deleted. A visit whose patient or day has changed is measured
again, so that no report contains another patient's pseudonym.
"""

import datetime
import shutil
from typing import Any

from django.db import transaction
from django.db.models import Model, QuerySet
from django.utils import timezone
from django.utils.dateparse import parse_datetime

from mammometry.base.errors import MammometryError
from mammometry.clinic.jobs import queue
from mammometry.clinic.models import Comparison, Consent, Correction, Job, Operation, Patient, Person, Visit, VisitOrder
from mammometry.clinic.records.comparing import comparison_folder
from mammometry.clinic.rig_history import may_queue

DAYS = 30
"""Days within which a correction can be undone."""
_ORDER = ("accession", "study_uid", "referring", "procedure_id", "procedure")


class CorrectionError(MammometryError):
    """A correction is refused. The message has the reason in one sentence."""

    exit_code = 4
    code = "correction"

    def __init__(self, sentence: str) -> None:
        Exception.__init__(self, sentence)


@transaction.atomic
def move(visit: Visit, to: Patient, reason: str, by: Person | None) -> Correction:
    """Move a visit to another patient.

    An order from the hospital's worklist belongs to the former patient and is not moved.

    Raises:
        CorrectionError: the visit is already this patient's, or is being measured.
        StorageError: the disk is full or refuses.
    """
    _require_idle(visit)
    if to.pk == visit.patient_id:
        raise CorrectionError("This visit already belongs to this patient. Choose another one.")
    former = visit.patient
    order = VisitOrder.objects.filter(visit=visit).first()
    kept = None if order is None else {name: getattr(order, name) for name in _ORDER}
    if order is not None:
        order.delete()
    _give(visit, to, by)
    return Correction.objects.create(
        kind=Correction.Kind.MOVED, visit=visit, patient=former, reason=reason, by=by,
        before={"patient": str(former.pk), "order": kept}, after={"patient": str(to.pk)},
    )  # fmt: skip


@transaction.atomic
def redate(visit: Visit, taken_at: datetime.datetime, note: str, reason: str, by: Person | None) -> Correction:
    """Correct a visit's day, time and note.

    Raises:
        CorrectionError: nothing has changed, or the visit is being measured.
        StorageError: the disk is full or refuses.
    """
    _require_idle(visit)
    before = {"taken_at": visit.taken_at.isoformat(), "note": visit.note}
    after = {"taken_at": taken_at.isoformat(), "note": note}
    if (taken_at, note) == (visit.taken_at, visit.note):
        raise CorrectionError("Day, time and note have not changed. Change what is wrong.")
    _date(visit, after, by)
    return Correction.objects.create(
        kind=Correction.Kind.DATED, visit=visit, patient=visit.patient, reason=reason, by=by, before=before, after=after
    )


@transaction.atomic
def merge(kept: Patient, other: Patient, number_of: Patient, reason: str, by: Person | None) -> Correction:
    """Merge two records of one patient.

    Args:
        kept: keeps its name, birthday and pseudonym, and gets the other's visits, operations and consents.
        other: redirects to `kept` from then on.
        number_of: the record whose number remains in use.
        reason: reason for the merge.
        by: the user.

    Raises:
        CorrectionError: they are the same record, or a visit of the other is being measured.
        StorageError: the disk is full or refuses.
    """
    if kept.pk == other.pk:
        raise CorrectionError("This is the same record. Choose another one.")
    for record in sorted((kept, other), key=lambda record: record.pk):  # all fields are saved, so read again
        record.refresh_from_db(from_queryset=Patient.everything.select_for_update())
    rows: dict[str, list[Any]] = {
        "visits": list(Visit.everything.filter(patient=other)),
        "operations": list(Operation.objects.filter(patient=other)),
        "consents": list(Consent.objects.filter(patient=other)),
        "merged": list(Patient.everything.filter(merged_into=other)),
    }
    for visit in rows["visits"]:
        _require_idle(visit)
    before: dict[str, Any] = {name: [str(row.pk) for row in related] for name, related in rows.items()}
    before |= {"numbers": [kept.record_number, other.record_number], "note": kept.note}
    for visit in rows["visits"]:
        _give(visit, kept, by)
    for row in (*rows["operations"], *rows["consents"]):
        _set(row, patient=kept)
    for row in rows["merged"]:
        _set(row, merged_into=kept)
    if other.note and other.note not in kept.note:
        kept.note = f"{kept.note}\n{other.note}".strip()[:2000]
    if number_of.pk == other.pk:
        _number(kept, other, [other.record_number, kept.record_number])
    _set(other, merged_into=kept)
    kept.save()
    after = {"into": str(kept.pk), "numbers": [kept.record_number, other.record_number], "note": kept.note}
    return Correction.objects.create(
        kind=Correction.Kind.MERGED, patient=other, reason=reason, by=by, before=before, after=after
    )


@transaction.atomic
def put_into_bin(row: Visit | Patient, reason: str, by: Person | None) -> Correction:
    """Put a visit, or a patient's record without visits, into the bin.

    Raises:
        CorrectionError: the visit is being measured, or the patient has visits.
    """
    if isinstance(row, Visit):
        _require_idle(row)
    elif row.visits.exists():
        raise CorrectionError("This patient has visits. Move them or put them into the bin first.")
    _set(row, binned_at=timezone.now())
    visit, patient = (row, row.patient) if isinstance(row, Visit) else (None, row)
    return Correction.objects.create(kind=Correction.Kind.BINNED, visit=visit, patient=patient, reason=reason, by=by)


@transaction.atomic
def undo(correction: Correction, by: Person | None) -> None:
    """Undo a correction.

    Raises:
        CorrectionError: it was already undone, is too old, or the record was changed again since.
        StorageError: the disk is full or refuses.
    """
    row = Correction.objects.select_for_update().get(pk=correction.pk)
    if row.undone_at is not None:
        raise CorrectionError("This correction has already been undone.")
    if row.at < oldest():
        raise CorrectionError(f"A correction can be undone for {DAYS} days. Correct the record again instead.")
    {
        Correction.Kind.MOVED: _undo_move, Correction.Kind.DATED: _undo_date,
        Correction.Kind.MERGED: _undo_merge, Correction.Kind.BINNED: _undo_bin,
    }[Correction.Kind(row.kind)](row, by)  # fmt: skip
    _set(row, undone_at=timezone.now(), undone_by=by)


def newest() -> QuerySet[Correction]:
    """Corrections that can be undone or have been undone, newest first."""
    related = ("visit__patient", "patient__merged_into", "by", "undone_by")
    return Correction.objects.filter(at__gte=oldest()).select_related(*related)


def left_in_bin() -> list[Visit | Patient]:
    """Records that have been in the bin too long to be restored."""
    visits = Visit.everything.filter(binned_at__lt=oldest()).select_related("patient")
    return [*visits.order_by("binned_at"), *Patient.everything.filter(binned_at__lt=oldest()).order_by("binned_at")]


def oldest() -> datetime.datetime:
    """Time before which corrections can no longer be undone."""
    return timezone.now() - datetime.timedelta(days=DAYS)


def _undo_move(row: Correction, by: Person | None) -> None:
    visit, patient = _visit(row), row.patient
    assert patient is not None
    if str(visit.patient_id) != row.after["patient"]:
        raise _later()
    if patient.merged_into is not None or patient.binned_at is not None:
        raise CorrectionError("The former patient's record is not in use. Undo that correction first.")
    _give(visit, patient, by)
    if row.before["order"] is not None and not VisitOrder.objects.filter(visit=visit).exists():
        VisitOrder.objects.create(visit=visit, **row.before["order"])


def _undo_date(row: Correction, by: Person | None) -> None:
    visit = _visit(row)
    if (visit.taken_at, visit.note) != (parse_datetime(row.after["taken_at"]), row.after["note"]):
        raise _later()
    _date(visit, row.before, by)


def _undo_merge(row: Correction, by: Person | None) -> None:
    other = row.patient
    assert other is not None
    kept = Patient.everything.select_for_update().get(pk=row.after["into"])
    if other.merged_into_id != kept.pk or [kept.record_number, other.record_number] != row.after["numbers"]:
        raise _later()
    visits = list(Visit.everything.filter(pk__in=row.before["visits"], patient=kept))
    for visit in visits:
        _require_idle(visit)
        _give(visit, other, by)
    for model in (Operation, Consent):
        for record in model.objects.filter(pk__in=row.before[f"{model.__name__.lower()}s"], patient=kept):
            _set(record, patient=other)
    for merged in Patient.everything.filter(pk__in=row.before["merged"], merged_into=kept):
        _set(merged, merged_into=other)
    if kept.note == row.after["note"]:
        kept.note = row.before["note"]
    _number(kept, other, row.before["numbers"])
    _set(other, merged_into=None)
    kept.save()


def _undo_bin(row: Correction, by: Person | None) -> None:
    if row.visit is not None and (row.visit.patient.binned_at or row.visit.patient.merged_into_id):
        raise CorrectionError("The patient's record is not in use. Take it out of the bin first.")
    _set(row.visit or row.patient, binned_at=None)


def _give(visit: Visit, patient: Patient, by: Person | None) -> None:
    """Assign a visit to another patient, and measure it again under that pseudonym."""
    _forget_comparisons(visit)
    _set(visit, patient=patient)
    _remake(visit, by)


def _date(visit: Visit, values: dict[str, str], by: Person | None) -> None:
    taken_at = parse_datetime(values["taken_at"])
    assert taken_at is not None
    again = timezone.localdate(taken_at) != timezone.localdate(visit.taken_at)
    if again:
        _forget_comparisons(visit)
    _set(visit, taken_at=taken_at, note=values["note"])
    if again:
        _remake(visit, by)


def _remake(visit: Visit, by: Person | None) -> None:
    """Make the report again with the visit's current pseudonym and day."""
    queue.carry_subject(visit)
    if not visit.measurements.exists():
        return
    _set(visit, state=Visit.State.CHANGED)
    if visit.binned_at is None and may_queue(visit, anyway=True) is None:
        queue.enqueue(visit, by)


def _forget_comparisons(visit: Visit) -> None:
    """Delete comparisons with visits of one patient. They are made again when needed."""
    for other in Visit.everything.filter(patient=visit.patient_id).exclude(pk=visit.pk):
        for pair in ((visit, other), (other, visit)):
            shutil.rmtree(comparison_folder(*pair), ignore_errors=True)
    for row in (*Comparison.objects.filter(before=visit), *Comparison.objects.filter(after=visit)):
        row.delete()


def _number(kept: Patient, other: Patient, numbers: list[str]) -> None:
    """Set the numbers of two records, which must never be equal."""
    if [kept.record_number, other.record_number] == numbers:
        return
    _set(other, record_number=str(other.pk))
    _set(kept, record_number=numbers[0])
    _set(other, record_number=numbers[1])


def _set(row: Model | None, **values: Any) -> None:
    """Change a row with its own `save`, so that the audit records it."""
    assert row is not None
    for name, value in values.items():
        setattr(row, name, value)
    row.save(update_fields=list(values))


def _require_idle(visit: Visit) -> None:
    if Job.objects.filter(visit=visit, state__in=Job.OPEN).exists():
        raise CorrectionError("This visit is being measured. Wait until it is done, or cancel it first.")


def _visit(row: Correction) -> Visit:
    assert row.visit is not None
    _require_idle(row.visit)
    return row.visit


def _later() -> CorrectionError:
    return CorrectionError("This record has changed again since. Undo the later correction first.")
