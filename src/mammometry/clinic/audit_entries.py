"""Read the audit: filters, pages of entries, and their CSV."""

import datetime
import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TextIO
from uuid import UUID

from auditlog.models import LogEntry
from django.contrib.contenttypes.models import ContentType
from django.db.models import Func, Model, Q, QuerySet, TextField
from django.db.models.functions import Cast
from django.utils import timezone

from mammometry.base.csv_cells import CsvWriter
from mammometry.clinic.audit import COMMAND, FAILED_LOGIN, KIND_POSTGRESQL, KIND_SQLITE, LOGIN, OPENED, REFUSED
from mammometry.clinic.models import Patient, Person, Visit

CHANGED = "changed"
KINDS = {
    OPENED: "opened a page",
    CHANGED: "changed something",
    LOGIN: "logged in or out",
    FAILED_LOGIN: "failed login",
    REFUSED: "refused page",
    COMMAND: "exported or erased",
}
"""Kind of an entry → its text."""
SHOWN = 50
"""Entries on a page."""
COLUMNS = (
    "id", "time", "who", "kind", "page", "address", "what", "which", "pseudonym_or_name", "changes", "from",
)  # fmt: skip
_CHANGES = (LogEntry.Action.CREATE, LogEntry.Action.UPDATE, LogEntry.Action.DELETE)
_VERBS = {LogEntry.Action.CREATE: "entered", LogEntry.Action.UPDATE: "changed", LogEntry.Action.DELETE: "deleted"}
_TITLES = {
    "home": "Today",
    "report-pdf": "Report as PDF",
    "scene": "Three dimensions",
    "visit-dicom": "DICOM of a visit",
    "visit-fhir": "FHIR of a visit",
    "visit-send": "Send to an archive",
    "draw": "Boundaries and landmarks",
    "study-csv": "Study as CSV",
    "study-redcap": "Study for REDCap",
    "study-table": "Study, all numbers",
    "jobs-page": "Jobs",
    "destinations": "Archives",
    "destination-new": "New archive",
    "destination-edit": "Archive",
    "rig-target": "Board to print",
    "audit-csv": "Audit as CSV",
    "audit-entry": "Entry of the audit",
    "person-factor": "Reset of a second factor",
    "person-let-in": "Unlocked",
    "person-invite": "New link for a password",
    "login": "Login",
    "logout": "Logout",
    "login failed": "Wrong name or password",
    "locked out": "Locked out after too many wrong passwords",
    "wrong code": "Wrong code of the second factor",
    "account_change_password": "Own password",
    "account_reauthenticate": "Password asked again",
    "mfa_reauthenticate": "Code asked again",
    "mfa_index": "Own second factor",
    "mfa_activate_totp": "Set up the second factor",
    "mfa_deactivate_totp": "Remove the second factor",
    "mfa_view_recovery_codes": "Codes for a lost telephone",
    "mfa_generate_recovery_codes": "New codes for a lost telephone",
    "mfa_download_recovery_codes": "Codes for a lost telephone, as a file",
}
"""Titles of routes whose names are unsuitable as titles."""
_MODELS = {"dailycheck": "daily check", "visitorder": "order of a visit", "destination": "archive"}


def title_of(page: str) -> str:
    """A page's title by the name of its route, such as "Visit"."""
    plain = page.replace("-", " ").replace("_", " ").removeprefix("command ")
    first, _, last = plain.rpartition(" ")
    if last == "new":
        plain = f"new {first}"
    return _TITLES.get(page) or plain[:1].upper() + plain[1:]


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditFilter:
    """Filter of the audit's entries."""

    person: UUID | None = None
    """User, or the login that was attempted."""
    since: datetime.date | None = None
    """First day."""
    until: datetime.date | None = None
    """Last day."""
    patient: str = ""
    """Pseudonym."""
    kind: str = ""
    """A key of `KINDS`; empty: all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditLine:
    """An entry of the audit as text for the page."""

    number: int
    at: datetime.datetime
    who: str
    kind: str
    """A key of `KINDS`."""
    title: str
    """Title of the page, or the changed object."""
    path: str
    """Address of the page, without a query."""
    about: str
    """Pseudonym and date of a visit, or the name of a rig or person."""
    model: str
    key: str
    fields: tuple[tuple[str, str, str], ...]
    """Name of each changed field, its value before and after."""
    client: str
    """Network address that the request came from."""
    is_new: bool
    """Whether its row is new."""

    @property
    def words(self) -> str:
        """The kind as text."""
        return KINDS[self.kind]

    @property
    def changed(self) -> str:
        """Names of the changed fields, empty for a new row."""
        return "" if self.is_new else ", ".join(name for name, _, _ in self.fields)


class _Kind(Func):
    """Kind of an entry in SQL, as in the index."""

    output_field = TextField()

    def as_sqlite(self, compiler: Any, connection: Any, **context: Any) -> Any:
        """Extract the kind with SQLite's JSON functions."""
        return super().as_sql(compiler, connection, template=KIND_SQLITE % "%(expressions)s", **context)

    def as_postgresql(self, compiler: Any, connection: Any, **context: Any) -> Any:
        """Extract the kind with PostgreSQL's JSON operators."""
        return super().as_sql(compiler, connection, template=f"({KIND_POSTGRESQL % '%(expressions)s'})", **context)


def entries(chosen: AuditFilter) -> QuerySet[LogEntry]:
    """Entries that match a filter, newest first."""
    rows = LogEntry.objects.alias(kind=_Kind("additional_data")).order_by("-pk")
    if chosen.person is not None:
        rows = rows.filter(actor_id=chosen.person)
    if chosen.since is not None:
        rows = rows.filter(timestamp__gte=_midnight(chosen.since))
    if chosen.until is not None:
        rows = rows.filter(timestamp__lt=_midnight(chosen.until + datetime.timedelta(days=1)))
    if chosen.patient:
        rows = _about_patient(rows, chosen.patient)
    if chosen.kind == CHANGED:
        rows = rows.filter(kind__isnull=True)
    elif chosen.kind:
        rows = rows.filter(kind=chosen.kind)
    return rows


def entry_page(chosen: AuditFilter, before: int | None = None) -> tuple[list[AuditLine], int | None]:
    """Entries older than a number, and the number where the next page starts.

    Args:
        chosen: the filtered entries.
        before: number of the last entry of the previous page; None: start with the newest.
    """
    matching = entries(chosen)
    if before is not None:
        matching = matching.filter(pk__lt=before)
    names = {person.pk: str(person) for person in Person.objects.all()}
    rows = [in_words(row, names) for row in matching[: SHOWN + 1]]
    return rows[:SHOWN], rows[SHOWN - 1].number if len(rows) > SHOWN else None


def in_words(
    row: LogEntry, names: Mapping[UUID, str], texts: Mapping[str, tuple[str, str]] = MappingProxyType({})
) -> AuditLine:
    """One entry as text, even if its object no longer exists.

    Args:
        row: the entry.
        names: key of a person → name shown on pages.
        texts: field → its text before and after, if the reader may see it.
    """
    additional: dict[str, Any] = row.additional_data if isinstance(row.additional_data, dict) else {}
    model = ContentType.objects.get_for_id(row.content_type_id).model
    model = _MODELS.get(model, model)
    changed = row.action in _CHANGES
    # Entries of versions that did not record kinds are of opened pages.
    kind = CHANGED if changed else additional.get("kind") if additional.get("kind") in KINDS else OPENED
    title = f"{model.capitalize()} {_VERBS[row.action]}" if changed else title_of(str(additional.get("page", "")))
    who = names.get(row.actor_id, f"account {additional['account']}" if "account" in additional else "")
    return AuditLine(
        number=row.pk,
        at=row.timestamp,
        who=who,
        kind=str(kind),
        title=title,
        path=str(additional.get("path", "")),
        about=row.object_repr,
        model=model,
        key=row.object_pk,
        fields=tuple((name, *texts.get(name, values)) for name, *values in _field_changes(row.changes)),
        client=row.remote_addr or "",
        is_new=row.action == LogEntry.Action.CREATE,
    )


def change_of(row: Model) -> LogEntry | None:
    """The newest change of a row, with its author and time. None if there is none."""
    of_row = LogEntry.objects.filter(
        content_type=ContentType.objects.get_for_model(row), object_pk=str(row.pk), action__in=_CHANGES
    )
    return of_row.select_related("actor").order_by("-pk").first()


def write_audit(file: TextIO, chosen: AuditFilter | None = None) -> int:
    """Write the audit as CSV, the oldest entry first. Return the number of entries."""
    writer = CsvWriter(file)
    writer.row(COLUMNS)
    names = {person.pk: str(person) for person in Person.objects.all()}
    number = 0
    for row in entries(chosen or AuditFilter()).order_by("pk").iterator(chunk_size=1000):
        entry = in_words(row, names)
        changes = "; ".join(f"{name}: {before} → {after}" for name, before, after in entry.fields)
        writer.row((
            str(entry.number), entry.at.isoformat(), entry.who, entry.kind, entry.title, entry.path, entry.model,
            entry.key, entry.about, changes, entry.client,
        ))  # fmt: skip
        number += 1
    return number


def audit_csv(chosen: AuditFilter) -> str:
    """The chosen entries as CSV."""
    file = io.StringIO()
    write_audit(file, chosen)
    return file.getvalue()


def _about_patient(rows: QuerySet[LogEntry], pseudonym: str) -> QuerySet[LogEntry]:
    """Entries about a patient's rows, and those of pages that listed the patient.

    For an erased patient only the pseudonym is used.
    """
    from mammometry.clinic.maintenance.patient import rows_of

    patient = Patient.everything.filter(pseudonym=pseudonym).first()
    wanted = Q(object_repr__startswith=pseudonym)
    if patient is not None:
        wanted |= Q(object_pk__in=[str(row.pk) for row in rows_of(patient)])
        listed = [patient.pk, *Visit.everything.filter(patient=patient).values_list("pk", flat=True)]
        rows = rows.annotate(additional_text=Cast("additional_data", TextField()))
        for key in listed:
            wanted |= Q(additional_text__contains=str(key))
    return rows.filter(wanted)


def _field_changes(changes: Any) -> Iterator[tuple[str, str, str]]:
    """Field, value before and value after. Several related rows are given by their names."""
    for name, change in changes.items() if isinstance(changes, dict) else ():
        if isinstance(change, list) and len(change) == 2:
            before, after = ("" if value in (None, "None") else str(value) for value in change)
            yield str(name), before, after
        elif isinstance(change, dict):
            yield (
                str(name),
                "",
                f"{change.get('operation', '')} {', '.join(map(str, change.get('objects', ())))}".strip(),
            )


def _midnight(day: datetime.date) -> datetime.datetime:
    return timezone.make_aware(datetime.datetime.combine(day, datetime.time()))
