"""The audit.

Who saw and who changed what. Entries can be added and read, and never changed.

django-auditlog enters each change of a registered model; `record_view` enters each page that was opened. Entries name a
patient by pseudonym, and hold no names: what is entered of `MASKED` fields is that they changed.
"""

from __future__ import annotations

import getpass
from collections.abc import Iterator, Mapping
from typing import Any, TextIO

from auditlog.models import LogEntry
from auditlog.registry import auditlog
from django.apps import apps
from django.contrib.auth.signals import user_logged_in, user_logged_out
from django.contrib.contenttypes.models import ContentType
from django.db import connection
from django.db.models import Model
from django.dispatch import Signal
from django.http import HttpRequest, HttpResponseBase

from mammometry.base.csv_cells import CsvWriter

TABLE = "auditlog_logentry"
_LEFT_OUT = {
    "Patient": ["search_words"],
    "Person": ["password", "last_login"],
    "Upload": ["received_bytes"],
    "Delivery": ["tries", "next_try"],
    "Job": ["stage", "fraction", "message", "lease_owner", "lease_until"],
}
"""Fields whose changes are no news: secrets, and how far something is."""
MASKED = {
    "Patient": ["family_name", "given_name", "born", "record_number", "note"],
    "Visit": ["note"],
    "VisitOrder": ["referring"],
    "Consent": ["note"],
    "Operation": ["words"],
    "Conclusion": ["text"],
    "Correction": ["reason", "before", "after"],
}
"""Fields of which the audit holds only that they changed: they tell who somebody is."""
_ABOUT = {
    "patient": "Patient", "visit": "Visit", "rig": "Rig", "calibration": "Calibration", "check": "DailyCheck",
    "job": "Job", "upload": "Upload", "measurement": "Measurement", "person": "Person",
    "destination": "Destination", "delivery": "Delivery", "operation": "Operation", "consent": "Consent",
    "correction": "Correction", "comparison": "Comparison",
}  # fmt: skip


def mask(value: str) -> str:
    """A stand-in for a value that shows who somebody is."""
    return "•••" if value and value != "None" else value


def watch_models() -> None:
    """Have each change of the clinic's models entered."""
    for model in apps.get_app_config("clinic").get_models():
        name = model.__name__
        auditlog.register(
            model,
            exclude_fields=list(_LEFT_OUT.get(name, ())),
            mask_fields=list(MASKED.get(name, ())),
            mask_callable="mammometry.clinic.audit.mask",
        )
    for signal in (user_logged_in, user_logged_out):
        signal.connect(record_login, dispatch_uid="clinic audit")


def record_login(sender: object, request: HttpRequest | None, user: Model | None, signal: Signal, **_: object) -> None:
    """Enter that somebody came or left.

    Wrong passwords are counted by axes.
    """
    if user is None:
        return
    _enter_access(user, user, request, {"page": "login" if signal is user_logged_in else "logout"})


def record_view(request: HttpRequest, response: HttpResponseBase, parameters: Mapping[str, Any]) -> None:
    """Enter who opened what.

    The deepest object that the path names, else the page itself.

    A view that shows several objects puts their ids into ``request.shown``.
    """
    person = getattr(request, "user", None)
    if person is None or not person.is_authenticated or request.method not in ("GET", "POST"):
        return
    if response.status_code >= 400 or (request.method == "POST" and 300 <= response.status_code < 400):
        return  # what a POST changed is entered by its change
    named = [key for key in _ABOUT if key in parameters]
    match = request.resolver_match
    additional: dict[str, Any] = {"page": match.view_name if match else "", "method": request.method}
    additional |= {name: str(parameters[name]) for name in named}
    if shown := getattr(request, "shown", None):
        additional["shown"] = [str(each) for each in shown]
    if not named:
        return _enter_access(person, person, request, additional)
    model: type[Model] = apps.get_model("clinic", _ABOUT[named[-1]])
    key = parameters[named[-1]]
    _enter_access(model._base_manager.filter(pk=key).first() or model(pk=key), person, request, additional)
    return None


def _enter_access(what: Model, person: Model | None, request: HttpRequest | None, additional: dict[str, Any]) -> None:
    LogEntry.objects.create(
        content_type=ContentType.objects.get_for_model(what._meta.model),  # through a lazy user
        object_pk=str(what.pk),
        object_repr="" if what._state.adding else str(what),
        action=LogEntry.Action.ACCESS,
        changes={},
        actor=person,
        remote_addr=(request.META.get("REMOTE_ADDR") or None) if request is not None else None,
        additional_data=additional,
    )


def record_command(instance: Model, command: str) -> None:
    """Enter that a command of the command line was used on something."""
    _enter_access(instance, None, None, {"page": f"command {command}", "account": getpass.getuser()})


_SQLITE = [
    f"CREATE TRIGGER IF NOT EXISTS clinic_audit_no_{verb.lower()} BEFORE {verb} ON {TABLE} "
    "BEGIN SELECT RAISE(ABORT, 'the audit is only added to'); END"
    for verb in ("UPDATE", "DELETE")
]
_POSTGRESQL = [
    "CREATE OR REPLACE FUNCTION clinic_audit_only_added_to() RETURNS trigger LANGUAGE plpgsql AS "
    "$$ BEGIN RAISE EXCEPTION 'the audit is only added to'; END $$",
    f"CREATE OR REPLACE TRIGGER clinic_audit_no_change BEFORE UPDATE OR DELETE ON {TABLE} "
    "FOR EACH ROW EXECUTE FUNCTION clinic_audit_only_added_to()",
    f"CREATE OR REPLACE TRIGGER clinic_audit_no_truncate BEFORE TRUNCATE ON {TABLE} "
    "FOR EACH STATEMENT EXECUTE FUNCTION clinic_audit_only_added_to()",
]


def seal() -> None:
    """Make the database itself refuse to change or delete entries.

    Safe to call again.
    """
    with connection.cursor() as cursor:
        for statement in _POSTGRESQL if connection.vendor == "postgresql" else _SQLITE:
            cursor.execute(statement)


def is_sealed() -> bool:
    """Whether the database refuses to change entries."""
    query = (
        "SELECT count(*) FROM pg_trigger WHERE tgname LIKE 'clinic_audit_no_%%' AND tgenabled <> 'D'"
        if connection.vendor == "postgresql"
        else "SELECT count(*) FROM sqlite_master WHERE type = 'trigger' AND name LIKE 'clinic_audit_no_%%'"
    )
    with connection.cursor() as cursor:
        cursor.execute(query)
        row = cursor.fetchone()
    return row is not None and row[0] == 2


COLUMNS = ("id", "time", "who", "action", "what", "which", "pseudonym_or_name", "address", "changes", "page")


def rows() -> Iterator[tuple[str, ...]]:
    """All entries in their order, a row each under `COLUMNS`."""
    entries = LogEntry.objects.select_related("content_type", "actor").order_by("pk")
    for entry in entries.iterator(chunk_size=1000):
        yield (
            str(entry.pk),
            entry.timestamp.isoformat(),
            str(entry.actor or ""),
            str(entry.get_action_display()),
            entry.content_type.model if entry.content_type else "",
            entry.object_pk,
            entry.object_repr,
            entry.remote_addr or "",
            entry.changes_str if entry.changes else "",
            (entry.additional_data or {}).get("page", ""),
        )


def write_audit(file: TextIO) -> int:
    """Write the audit as CSV. Return the number of its entries."""
    writer = CsvWriter(file)
    writer.row(COLUMNS)
    number = 0
    for row in rows():
        writer.row(row)
        number += 1
    return number
