"""Earlier versions of notes about a patient, for people who may read notes.

The audit itself does not contain the text.
"""

import datetime
from dataclasses import dataclass

from auditlog.models import LogEntry
from django.db.models import Q

from mammometry.clinic.models import NoteChange, Patient, Visit


@dataclass(frozen=True, slots=True, kw_only=True)
class NoteLine:
    """One change of a note."""

    title: str
    """Subject of the note: the patient, a visit, a consent or an operation."""
    at: datetime.datetime
    who: str
    """Author. Empty: a command."""
    before: str
    after: str


_TITLES = {"patient": "Note on the patient", "consent": "Remark on a consent", "operation": "Operation in words"}


def history(patient: Patient) -> list[NoteLine]:
    """All changes of notes about a patient, newest first, including merged records."""
    records = [patient, *Patient.everything.filter(merged_into=patient)]
    visits = Visit.objects.filter(patient=patient)
    changes = NoteChange.objects.filter(Q(patient__in=records) | Q(visit__in=visits)).select_related("visit")
    found = LogEntry.objects.select_related("actor", "content_type").in_bulk([change.entry for change in changes])
    return [
        NoteLine(
            title=_title(change, entry), at=entry.timestamp, who=str(entry.actor or ""), before=change.before,
            after=change.after,
        )
        for change in changes
        if (entry := found.get(change.entry)) is not None
    ]  # fmt: skip


def texts_of(entry: LogEntry) -> dict[str, tuple[str, str]]:
    """Text before and after a change, by field, for an audit entry about a note.

    Only for people who may read notes.
    """
    return {row.field: (row.before, row.after) for row in NoteChange.objects.filter(entry=entry.pk)}


def _title(change: NoteChange, entry: LogEntry) -> str:
    if change.visit is not None:
        return f"Note on the visit of {change.visit.taken_at:%Y-%m-%d}"
    return _TITLES.get(entry.content_type.model, "Note")
