"""The audit: who saw and who changed what. Entries can be added and read, but never changed.

django-auditlog records each change of a registered model, `record_view` each opened page, `record_refusal` each refused
one, and login signals each login, logout and failed login. Entries contain pseudonyms and no names. For `MASKED` fields
they record only that the value changed. `audit_entries` reads the entries.
"""

import getpass
from collections.abc import Mapping
from typing import Any

from auditlog.models import LogEntry
from auditlog.registry import auditlog
from auditlog.signals import post_log
from axes.signals import user_locked_out
from django.apps import apps
from django.contrib.auth import get_user_model
from django.contrib.auth.signals import user_logged_in, user_logged_out, user_login_failed
from django.contrib.contenttypes.models import ContentType
from django.db import connection
from django.db.models import Model
from django.db.models.signals import pre_delete
from django.dispatch import Signal
from django.http import HttpRequest, HttpResponseBase

TABLE = "auditlog_logentry"
OPENED, LOGIN, FAILED_LOGIN, REFUSED, COMMAND = "opened", "login", "failed login", "refused", "command"
"""Kinds of entries other than changes of rows; `additional_data["kind"]`."""
_LEFT_OUT = {
    "Patient": ["search_words"],
    "Person": ["password", "last_login"],
    "Upload": ["received_bytes"],
    "Job": ["stage", "fraction", "message", "lease_owner", "lease_until", "due"],
}
"""Fields whose changes are not recorded: secrets and progress."""
MASKED = {
    "Patient": ["family_name", "given_name", "born", "record_number", "note"],
    "Visit": ["note"],
    "VisitOrder": ["referring"],
    "Consent": ["note"],
    "Operation": ["words"],
    "Conclusion": ["text"],
    "Correction": ["reason", "before", "after"],
}
"""Fields that identify a person. The audit records only that they changed."""
NOTES = {"Patient": "note", "Visit": "note", "Consent": "note", "Operation": "words"}
"""Fields whose text before and after each change is stored in `NoteChange`, for people who may read notes."""
_UNWATCHED = ("AuditLink", "FormToken", "NoteChange")
"""Rows that are recorded with others or contain no personal data."""
_ABOUT = {
    "patient": "Patient", "visit": "Visit", "rig": "Rig", "calibration": "Calibration", "check": "DailyCheck",
    "job": "Job", "upload": "Upload", "measurement": "Measurement", "person": "Person",
    "destination": "Destination", "delivery": "Delivery", "operation": "Operation", "consent": "Consent",
    "correction": "Correction", "comparison": "Comparison",
}  # fmt: skip


_BOTH_VERSIONS = 409
"""Status of the page for a record that a colleague changed."""
_PATH = 300  # stored characters of an address; the clinic's are shorter


def mask(value: str) -> str:
    """Replacement for a value that identifies a person."""
    return "•••" if value and value != "None" else value


def watch_models() -> None:
    """Record each change of the clinic's models."""
    for model in apps.get_app_config("clinic").get_models():
        name = model.__name__
        if name in _UNWATCHED:
            continue
        if name in NOTES:
            pre_delete.connect(_note_origin, sender=model, dispatch_uid=f"clinic origin of {name}")
            post_log.connect(record_note, sender=model, dispatch_uid=f"clinic notes of {name}")
        auditlog.register(
            model,
            exclude_fields=list(_LEFT_OUT.get(name, ())),
            mask_fields=list(MASKED.get(name, ())),
            mask_callable="mammometry.clinic.audit.mask",
        )
    for signal in (user_logged_in, user_logged_out):
        signal.connect(record_login, dispatch_uid="clinic audit")
    for signal in (user_login_failed, user_locked_out):
        signal.connect(record_failed_login, dispatch_uid="clinic audit")


def record_note(
    sender: type[Model],
    instance: Model,
    instance_old: Model | None,
    action: int,
    log_entry: LogEntry | None,
    **_: object,
) -> None:
    """Store a note before and after a change, unless its patient is being erased."""
    field = NOTES[sender.__name__]
    if log_entry is None or field not in (log_entry.changes_dict or {}):
        return
    is_deleted = action == LogEntry.Action.DELETE
    if is_deleted and not getattr(instance, _ALONE, False):
        return
    before = "" if instance_old is None else getattr(instance_old, field)
    after = "" if is_deleted else getattr(instance, field)
    if before == after:  # the empty note of a new row
        return
    of_visit = sender.__name__ == "Visit"
    patient = instance.pk if sender.__name__ == "Patient" else getattr(instance, "patient_id", None)
    apps.get_model("clinic", "NoteChange").objects.create(
        patient_id=None if of_visit else patient, visit_id=instance.pk if of_visit else None, entry=log_entry.pk,
        field=field, before=before, after=after,
    )  # fmt: skip


_ALONE = "_is_deleted_alone"


def _note_origin(instance: Model, origin: object = None, **_: object) -> None:
    """Remember whether a row is removed separately from its patient."""
    setattr(instance, _ALONE, origin is instance and not hasattr(instance, "note_changes"))


def record_login(sender: object, request: HttpRequest | None, user: Model | None, signal: Signal, **_: object) -> None:
    """Record a login or logout."""
    if user is None:
        return
    _enter_access(user, user, request, LOGIN, {"page": "login" if signal is user_logged_in else "logout"})


def record_failed_login(
    sender: object,
    signal: Signal,
    request: HttpRequest | None = None,
    credentials: dict[str, Any] | None = None,
    **_: object,
) -> None:
    """Record a wrong password, or a lock after too many.

    The entry names the person whose login was attempted. An unknown name is not stored, because it may be a password
    that was typed into the wrong field.
    """
    if signal is user_login_failed and getattr(request, "axes_locked_out", False):
        return  # axes reports this with its own signal
    name = (tried_name(request, credentials) or "").replace("\0", "")
    person = get_user_model()._default_manager.filter(username=name).first()
    page = "login failed" if signal is user_login_failed else "locked out"
    _enter_access(person, person, request, FAILED_LOGIN, {"page": page})


def record_wrong_code(person: Model, request: HttpRequest | None) -> None:
    """Record a correct password with a wrong code of the second factor."""
    _enter_access(person, person, request, FAILED_LOGIN, {"page": "wrong code"})


def record_view(request: HttpRequest, response: HttpResponseBase, parameters: Mapping[str, Any]) -> None:
    """Record an opened page. The entry refers to the last object in the path, or else to the page.

    A view that shows several objects puts their ids into ``request.shown``.
    """
    if request.method not in ("GET", "POST"):
        return
    if response.status_code >= 300 and response.status_code != _BOTH_VERSIONS:
        return  # nothing was shown; a change by a POST has its own entry
    _enter_page(request, OPENED, parameters)


def record_refusal(request: HttpRequest) -> None:
    """Record that a logged-in person asked for a page without having the role."""
    match = request.resolver_match
    _enter_page(request, REFUSED, {} if match is None else match.kwargs)


def _enter_page(request: HttpRequest, kind: str, parameters: Mapping[str, Any]) -> None:
    person = getattr(request, "user", None)
    if person is None or not person.is_authenticated:
        return
    named = [key for key in _ABOUT if key in parameters]
    match = request.resolver_match
    additional: dict[str, Any] = {
        "page": match.view_name if match else "", "method": request.method, "path": request.path[:_PATH],
    }  # fmt: skip
    additional |= {name: str(parameters[name]) for name in named}
    if shown := getattr(request, "shown", None):
        additional["shown"] = [str(key) for key in shown]
    what: Model = person
    if named:
        model: type[Model] = apps.get_model("clinic", _ABOUT[named[-1]])
        key = parameters[named[-1]]
        what = model._base_manager.filter(pk=key).first() or model(pk=key)
    _enter_access(what, person, request, kind, additional)


def _enter_access(
    what: Model | None, person: Model | None, request: HttpRequest | None, kind: str, additional: dict[str, Any]
) -> None:
    model = get_user_model() if what is None else what._meta.model  # also of a lazy user
    LogEntry.objects.create(
        content_type=ContentType.objects.get_for_model(model),
        object_pk="" if what is None else str(what.pk),
        object_repr="" if what is None or what._state.adding else str(what),
        action=LogEntry.Action.ACCESS,
        changes={},
        actor=person,
        remote_addr=(request.META.get("REMOTE_ADDR") or None) if request is not None else None,
        additional_data={"kind": kind, **additional},
    )


def record_command(instance: Model, command: str, person: Model | None = None) -> None:
    """Record an export or erasure, by a person on a page or by a command."""
    by = {} if person is not None else {"account": getpass.getuser()}
    _enter_access(instance, person, None, COMMAND, {"page": f"command {command}", **by})


KIND_SQLITE = "json_extract(%s, '$.kind')"
KIND_POSTGRESQL = "%s ->> 'kind'"
"""SQL for the kind of an entry, from the column of additional data. NULL for a change of a row."""
LINKS = "clinic_auditlink"
_REFUSAL = "the audit is only added to"
_NAMES = {TABLE: "clinic_audit", LINKS: "clinic_audit_links"}
"""Table → prefix of the names of its triggers."""
_BODY = f" BEGIN RAISE EXCEPTION '{_REFUSAL}'; END "
_ROW_CHANGED, _TRUNCATED = 1 + 2 + 8 + 16, 2 + 32
"""PostgreSQL's `tgtype` of a trigger: for each row, before delete and update; and before truncate."""


def _sqlite_triggers(table: str) -> dict[str, str]:
    """Trigger → its definition in SQLite. REPLACE deletes without a trigger, so inserts need a new key."""
    refuse = f"BEGIN SELECT RAISE(ABORT, '{_REFUSAL}'); END"
    key = "place" if table == LINKS else "id"
    there = f"WHEN EXISTS (SELECT 1 FROM {table} WHERE {key} = NEW.{key})"
    events = {"update": "UPDATE", "delete": "DELETE", "replace": "INSERT"}
    return {
        (name := f"{_NAMES[table]}_no_{what}"): " ".join(
            ["CREATE TRIGGER", name, "BEFORE", event, "ON", table, *([there] if what == "replace" else []), refuse]
        )
        for what, event in events.items()
    }


def _seals(table: str) -> list[str]:
    name = _NAMES[table]
    if connection.vendor != "postgresql":
        triggers = _sqlite_triggers(table)
        return [line for name, sql in triggers.items() for line in (f"DROP TRIGGER IF EXISTS {name}", sql)]
    return [
        f"CREATE OR REPLACE FUNCTION clinic_audit_only_added_to() RETURNS trigger LANGUAGE plpgsql AS $${_BODY}$$",
        f"CREATE OR REPLACE TRIGGER {name}_no_change BEFORE UPDATE OR DELETE ON {table} "
        "FOR EACH ROW EXECUTE FUNCTION clinic_audit_only_added_to()",
        f"CREATE OR REPLACE TRIGGER {name}_no_truncate BEFORE TRUNCATE ON {table} "
        "FOR EACH STATEMENT EXECUTE FUNCTION clinic_audit_only_added_to()",
        f"ALTER TABLE {table} ENABLE TRIGGER {name}_no_change, ENABLE TRIGGER {name}_no_truncate",
    ]


def seal() -> None:
    """Make the database refuse to change or delete entries, and add indexes for the filters.

    It may be called again: existing triggers with these names are replaced.
    """
    kind = KIND_POSTGRESQL if connection.vendor == "postgresql" else KIND_SQLITE
    indexes = [
        f"CREATE INDEX IF NOT EXISTS clinic_audit_by_kind ON {TABLE} (({kind % 'additional_data'}), id)",
        f"CREATE INDEX IF NOT EXISTS clinic_audit_by_actor ON {TABLE} (actor_id, id)",
    ]
    there = connection.introspection.table_names()
    seals = [statement for table in (TABLE, LINKS) if table in there for statement in _seals(table)]
    with connection.cursor() as cursor:
        for statement in (*seals, *indexes):
            cursor.execute(statement)


def is_sealed() -> bool:
    """Whether the database has exactly our triggers, which refuse to change entries."""
    with connection.cursor() as cursor:
        if connection.vendor != "postgresql":
            cursor.execute("SELECT name, sql FROM sqlite_master WHERE type = 'trigger'")
            return dict(cursor.fetchall()).items() >= {**_sqlite_triggers(TABLE), **_sqlite_triggers(LINKS)}.items()
        cursor.execute(
            "SELECT tgname, relname, tgtype, prosrc FROM pg_trigger JOIN pg_proc ON pg_proc.oid = tgfoid "
            "JOIN pg_class ON pg_class.oid = tgrelid WHERE tgenabled IN ('O', 'A') AND tgqual IS NULL"
        )
        return set(cursor.fetchall()) >= {
            (f"{name}_no_{what}", table, kind, _BODY)
            for table, name in _NAMES.items()
            for what, kind in (("change", _ROW_CHANGED), ("truncate", _TRUNCATED))
        }


def tried_name(request: HttpRequest | None, credentials: dict[str, Any] | None = None) -> str | None:
    """The name of a failed login, from the credentials or the request."""
    for source in (credentials or {}, getattr(request, "POST", {})):
        for key in ("username", "login"):
            if source.get(key):
                return str(source[key])[:150]
    return None
