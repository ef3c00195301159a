"""The audit: who saw and who changed what; nobody changes the audit."""

import csv
import io
from collections.abc import Callable

import pytest
from auditlog.models import LogEntry
from django.db import DatabaseError, connection, transaction
from django.test import Client
from django.urls import reverse

from mammometry.clinic import audit
from mammometry.clinic.models import Person, Visit
from mammometry.clinic.roles import Role


@pytest.mark.parametrize(
    "statement", ["UPDATE {} SET object_repr = ''", "DELETE FROM {}", "DELETE FROM {} WHERE id > 0"]
)
def test_the_database_refuses_to_change_it(visit: Visit, statement: str) -> None:
    before = LogEntry.objects.count()
    assert before > 0
    with pytest.raises(DatabaseError, match="only added to"), transaction.atomic(), connection.cursor() as cursor:
        cursor.execute(statement.format(audit.TABLE))
    assert LogEntry.objects.count() == before


def test_postgresql_refuses_to_empty_it(visit: Visit) -> None:
    if connection.vendor != "postgresql":
        pytest.skip("SQLite has no TRUNCATE")
    with connection.cursor() as cursor:
        cursor.execute("SET CONSTRAINTS ALL IMMEDIATE")
    with pytest.raises(DatabaseError, match="only added to"), transaction.atomic(), connection.cursor() as cursor:
        cursor.execute(f"TRUNCATE {audit.TABLE} CASCADE")


def test_it_holds_no_name(visit: Visit) -> None:
    patient = visit.patient
    patient.given_name, patient.note = "Ottilie", "allergic to Zypernkatzen"
    patient.save()
    text = repr(list(LogEntry.objects.values_list("object_repr", "changes", "additional_data")))
    for secret in ("Zypernkatz", "Quirina", "Ottilie", "KIS-4711", "1980"):
        assert secret not in text
    change = LogEntry.objects.filter(object_pk=str(patient.pk), action=LogEntry.Action.UPDATE).get()
    assert change.changes["given_name"] == ["•••", "•••"]
    assert change.object_repr == patient.pseudonym


def test_changes_in_a_request_name_who_and_from_where(
    clinic: object, client_of: Callable[..., Client], person_of: Callable[..., Person]
) -> None:
    client = client_of(Role.ADMINISTRATOR)
    data = {"username": "anna", "full_name": "Anna", "email": "", "roles": ["technician"], "is_active": "on"}
    assert client.post(reverse("admin:clinic_person_add"), data).status_code == 302
    entry = LogEntry.objects.filter(object_repr="Anna", action=LogEntry.Action.CREATE).get()
    assert entry.actor == person_of(Role.ADMINISTRATOR)
    assert entry.remote_addr == "127.0.0.1"


def test_opening_a_page_is_entered(client_of: Callable[..., Client], person_of: Callable[..., Person]) -> None:
    client = client_of(Role.ADMINISTRATOR)
    somebody = person_of(Role.TECHNICIAN)
    assert client.get(reverse("admin:clinic_person_changelist")).status_code == 200
    assert client.get(reverse("admin:clinic_person_change", args=[somebody.pk])).status_code == 200
    client.logout()
    seen = LogEntry.objects.filter(action=LogEntry.Action.ACCESS, actor=person_of(Role.ADMINISTRATOR))
    pages = [entry.additional_data["page"] for entry in seen.order_by("pk")]
    assert pages == ["login", "admin:clinic_person_changelist", "admin:clinic_person_change", "logout"]


def test_a_refused_page_is_not_entered_as_seen(client_of: Callable[..., Client]) -> None:
    client_of(Role.TECHNICIAN).get(reverse("admin:index"))
    entries = LogEntry.objects.filter(action=LogEntry.Action.ACCESS)
    assert [entry.additional_data["page"] for entry in entries] == ["login"]


def test_the_export_is_whole_and_no_formula(clinic: object, client_of: Callable[..., Client], visit: Visit) -> None:
    rig = visit.rig
    rig.name = "=cmd|' /C calc'!A0"
    rig.save()
    file = io.StringIO()
    number = audit.write_audit(file)
    table = list(csv.reader(io.StringIO(file.getvalue())))
    assert tuple(table[0]) == audit.COLUMNS
    assert len(table) == number + 1 == LogEntry.objects.count() + 1
    assert not [cell for row in table for cell in row if cell.startswith("=")]
