"""The audit: who saw and who changed what; nobody changes the audit."""

import csv
import datetime
import io
import re
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from auditlog.models import LogEntry
from django.db import DatabaseError, connection, transaction
from django.db.backends.utils import CursorWrapper
from django.test import Client
from django.urls import URLPattern, get_resolver, resolve, reverse
from django.utils import timezone

from mammometry.cli import doctor
from mammometry.clinic import audit, audit_chain
from mammometry.clinic.audit_entries import COLUMNS, SHOWN, AuditFilter, AuditLine, entries, title_of, write_audit
from mammometry.clinic.config import ClinicConfig, ClinicError
from mammometry.clinic.maintenance import backups
from mammometry.clinic.maintenance.patient import erase_patient
from mammometry.clinic.models import AuditLink, Person, Visit
from mammometry.clinic.roles import Role


@pytest.mark.parametrize(
    "statement", ["UPDATE {} SET object_repr = ''", "DELETE FROM {}", "DELETE FROM {} WHERE id > 0"]
)
@pytest.mark.requirement("R-SEC-5")
def test_the_database_refuses_to_change_it(visit: Visit, statement: str) -> None:
    before = LogEntry.objects.count()
    assert before > 0
    with pytest.raises(DatabaseError, match="audit"), transaction.atomic(), connection.cursor() as cursor:
        cursor.execute(statement.format(audit.TABLE))
    assert LogEntry.objects.count() == before


@pytest.mark.parametrize("table", [audit.TABLE, audit.LINKS])
@pytest.mark.requirement("R-SEC-5")
def test_sqlite_refuses_to_replace_an_entry(visit: Visit, table: str) -> None:
    """REPLACE deletes the old row without a trigger of deletion."""
    if connection.vendor != "sqlite":
        pytest.skip("PostgreSQL has no REPLACE; an upsert is an UPDATE, which is refused")
    audit_chain.extend()
    with connection.cursor() as cursor:
        cursor.execute("PRAGMA recursive_triggers=OFF")  # as another program has it
    with pytest.raises(DatabaseError, match="audit"), transaction.atomic(), connection.cursor() as cursor:
        cursor.execute(f"INSERT OR REPLACE INTO {table} SELECT * FROM {table} LIMIT 1")


def test_triggers_of_the_same_names_are_not_taken_for_ours(visit: Visit) -> None:
    assert audit.is_sealed()
    with connection.cursor() as cursor:
        if connection.vendor == "postgresql":
            cursor.execute("SET CONSTRAINTS ALL IMMEDIATE")  # what the visit left pending
            cursor.execute(
                "CREATE OR REPLACE FUNCTION clinic_audit_only_added_to() RETURNS trigger LANGUAGE plpgsql AS "
                "$$ BEGIN RETURN NEW; END $$"
            )
        else:
            cursor.execute("DROP TRIGGER clinic_audit_no_update")
            cursor.execute(f"CREATE TRIGGER clinic_audit_no_update BEFORE UPDATE ON {audit.TABLE} BEGIN SELECT 1; END")
    assert not audit.is_sealed()
    audit.seal()
    assert audit.is_sealed()


@contextmanager
def unsealed() -> Iterator[CursorWrapper]:
    """What somebody can do who may alter the database's tables, and put everything back."""
    with connection.cursor() as cursor:
        if connection.vendor == "postgresql":
            cursor.execute("SET CONSTRAINTS ALL IMMEDIATE")
            for table in (audit.TABLE, audit.LINKS):
                cursor.execute(f"ALTER TABLE {table} DISABLE TRIGGER USER")
        else:
            cursor.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'")
            for (name,) in cursor.fetchall():
                cursor.execute(f'DROP TRIGGER "{name}"')
        yield cursor
    audit.seal()


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE {0} SET object_repr = 'x' WHERE id = {2}",
        "UPDATE {0} SET timestamp = '2020-01-01 00:00:00+00:00' WHERE id = {2}",
        "UPDATE {0} SET changes = '{{}}' WHERE id = {2}",
        "DELETE FROM {0} WHERE id = {2}",
        "DELETE FROM {1} WHERE entry = {2}",
        "DELETE FROM {1} WHERE place = 1",
    ],
)
@pytest.mark.requirement("R-SEC-5")
def test_a_changed_entry_breaks_the_chain(visit: Visit, statement: str) -> None:
    visit.note = "x"
    visit.save()
    end = audit_chain.extend()
    assert end.place == LogEntry.objects.count() >= 4
    assert audit_chain.verify(end) == end
    chosen = AuditLink.objects.get(place=2).entry
    with unsealed() as cursor:
        cursor.execute(statement.format(audit.TABLE, audit.LINKS, chosen))
    assert audit.is_sealed()
    with pytest.raises(ClinicError, match=r"audit: found .*\b\d+\b"):
        audit_chain.verify()


def test_a_new_chain_is_noticed_by_the_end_that_a_backup_holds(visit: Visit) -> None:
    visit.note = "x"
    visit.save()
    end = audit_chain.extend()
    with unsealed() as cursor:
        cursor.execute(f"DELETE FROM {audit.LINKS}")
        cursor.execute(f"UPDATE {audit.TABLE} SET object_repr = 'x'")
    again = audit_chain.extend()
    assert audit_chain.verify() == again
    with pytest.raises(ClinicError, match=r"audit: .*chain"):
        audit_chain.verify(end)


def test_entries_are_chained_once_and_late_ones_too(visit: Visit) -> None:
    first = audit_chain.extend(every=False)
    assert audit_chain.extend(every=False) == audit_chain.extend() == first
    visit.note = "x"
    visit.save()
    assert audit_chain.extend(every=False).place == first.place + 1
    audit_chain.verify(first)


@pytest.mark.requirement("R-SEC-5")
def test_doctor_verifies_the_chain(visit: Visit, clinic: ClinicConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    backups.make_kept_backup(clinic)
    assert doctor._audit(clinic).state == "ok"
    with unsealed() as cursor:
        cursor.execute(f"DELETE FROM {audit.LINKS}")
        cursor.execute(f"UPDATE {audit.TABLE} SET object_repr = 'x'")
    check = doctor._audit(clinic)
    assert check.state == "wrong"
    assert "backup" in check.words


def test_postgresql_refuses_to_empty_it(visit: Visit) -> None:
    if connection.vendor != "postgresql":
        pytest.skip("SQLite has no TRUNCATE")
    with connection.cursor() as cursor:
        cursor.execute("SET CONSTRAINTS ALL IMMEDIATE")
    with pytest.raises(DatabaseError, match="audit"), transaction.atomic(), connection.cursor() as cursor:
        cursor.execute(f"TRUNCATE {audit.TABLE} CASCADE")


@pytest.mark.requirement("R-SEC-5")
def test_it_holds_no_name(visit: Visit) -> None:
    patient = visit.patient
    patient.given_name, patient.note = "Ottilie", "allergic to Zypernkatzen"
    patient.save()
    text = repr(list(LogEntry.objects.values_list("object_repr", "changes", "additional_data")))
    for secret in ("Zypernkatz", "Quirina", "Ottilie", "KIS-4711", "1980-02-29"):
        assert secret not in text
    change = LogEntry.objects.filter(object_pk=str(patient.pk), action=LogEntry.Action.UPDATE).get()
    assert change.changes["given_name"] == ["•••", "•••"]
    assert change.object_repr == patient.pseudonym


def test_changes_in_a_request_name_who_and_from_where(
    clinic: object, client_of: Callable[..., Client], person_of: Callable[..., Person]
) -> None:
    client = client_of(Role.ADMINISTRATOR)
    data = {"username": "anna", "full_name": "Anna", "email": "", "roles": ["technician"], "is_active": "on"}
    assert client.post(reverse("person-new"), data).status_code == 302
    entry = LogEntry.objects.filter(object_repr="Anna", action=LogEntry.Action.CREATE).get()
    assert entry.actor == person_of(Role.ADMINISTRATOR)
    assert entry.remote_addr == "127.0.0.1"


@pytest.mark.requirement("R-SEC-5")
def test_opening_a_page_is_entered(client_of: Callable[..., Client], person_of: Callable[..., Person]) -> None:
    client = client_of(Role.ADMINISTRATOR)
    somebody = person_of(Role.TECHNICIAN)
    assert client.get(reverse("people")).status_code == 200
    assert client.get(reverse("person", args=[somebody.pk])).status_code == 200
    client.logout()
    seen = LogEntry.objects.filter(action=LogEntry.Action.ACCESS, actor=person_of(Role.ADMINISTRATOR))
    pages = [entry.additional_data["page"] for entry in seen.order_by("pk")]
    assert pages == ["login", "people", "person", "logout"]


def test_a_refused_page_is_entered_as_refused(client_of: Callable[..., Client], visit: Visit) -> None:
    client_of(Role.TECHNICIAN).get(reverse("people"))
    client_of(Role.RESEARCHER).get(reverse("visit", args=[visit.pk]))
    refused = LogEntry.objects.filter(additional_data__kind=audit.REFUSED).order_by("pk")
    assert [entry.additional_data["path"] for entry in refused] == ["/people/", f"/visits/{visit.pk}/"]
    assert refused[1].object_repr == str(visit)
    assert not LogEntry.objects.filter(additional_data__kind=audit.OPENED).exists()


def test_the_export_is_whole_and_no_formula(clinic: object, client_of: Callable[..., Client], visit: Visit) -> None:
    rig = visit.rig
    rig.name = "=cmd|' /C calc'!A0"
    rig.save()
    file = io.StringIO()
    number = write_audit(file)
    table = list(csv.reader(io.StringIO(file.getvalue())))
    assert tuple(table[0]) == COLUMNS
    assert len(table) == number + 1 == LogEntry.objects.count() + 1
    assert not [cell for row in table for cell in row if cell.startswith("=")]


def rows_on(client: Client, **query: str) -> list[AuditLine]:
    answer = client.get(reverse("audit"), query)
    assert answer.status_code == 200
    entries: list[AuditLine] = answer.context["entries"]
    return entries


def test_the_page_shows_titles_and_addresses(client_of: Callable[..., Client], visit: Visit) -> None:
    client_of(Role.TECHNICIAN).get(reverse("visit", args=[visit.pk]))
    page = client_of(Role.ADMINISTRATOR).get(reverse("audit")).content.decode()
    assert f"/visits/{visit.pk}/" in page
    entry = next(each for each in rows_on(client_of(Role.ADMINISTRATOR)) if each.path.startswith("/visits/"))
    assert (entry.title, entry.about, entry.who) == ("Visit", str(visit), "technician")


def test_every_audited_page_has_a_title_that_people_read() -> None:
    names = [
        pattern.name or ""
        for pattern in get_resolver().url_patterns
        if isinstance(pattern, URLPattern) and pattern.callback.access.audited  # type: ignore[attr-defined]
    ]
    titles = [title_of(name) for name in names]
    assert len(titles) > 50
    assert [title for title in titles if not re.fullmatch(r"[A-Z][A-Za-z, ]+", title)] == []
    assert title_of("patient-new") == "New patient"


def test_it_is_filtered(client_of: Callable[..., Client], person_of: Callable[..., Person], visit: Visit) -> None:
    technician, administrator = client_of(Role.TECHNICIAN), client_of(Role.ADMINISTRATOR)
    technician.get(reverse("visit", args=[visit.pk]))
    technician.get(reverse("patients"))  # a list on which the patient stands
    technician.get(reverse("rigs"))
    technician.get(reverse("people"))
    Client().post(reverse("account_login"), {"login": "technician", "password": "wrong"})
    visit.note = "x"
    visit.save()

    def pages(**query: str) -> list[str]:
        return [entry.title for entry in reversed(rows_on(administrator, **query))]

    who = str(person_of(Role.TECHNICIAN).pk)
    failed = pages(kind="failed login")
    assert len(failed) == 1
    assert pages(person=who) == ["Login", "Visit", "Patients", "Rigs", "People", *failed]
    assert pages(kind="refused") == ["People"]
    assert pages(kind="login") == ["Login", "Login"]
    assert "Visit changed" in pages(kind="changed")
    about = pages(patient=visit.patient.pseudonym.lower())
    assert about[-3:] == ["Visit", "Patients", "Visit changed"]
    assert "Rigs" not in about
    today, tomorrow = timezone.localdate(), timezone.localdate() + datetime.timedelta(days=1)
    assert pages(since=str(today), until=str(today), kind="refused") == ["People"]
    assert pages(since=str(tomorrow)) == []
    assert pages(kind="no such kind", person="nobody") != []
    text = administrator.get(reverse("audit-csv"), {"kind": "refused"}).content.decode()
    assert len(list(csv.reader(io.StringIO(text)))) == 2


def test_an_erased_patients_entries_are_found_by_the_pseudonym(
    client_of: Callable[..., Client], visit: Visit, clinic: ClinicConfig
) -> None:
    pseudonym = visit.patient.pseudonym
    erase_patient(clinic, visit.patient)
    titles = [entry.title for entry in rows_on(client_of(Role.ADMINISTRATOR), patient=pseudonym)]
    assert {"Patient deleted", "Visit deleted", "Erase"} <= set(titles)


@pytest.mark.slow
def test_its_pages_are_turned_by_key(client_of: Callable[..., Client]) -> None:
    client = client_of(Role.ADMINISTRATOR)
    for _ in range(2 * SHOWN):
        client.get(reverse("help"))
        client.get(reverse("rigs"))
    first = client.get(reverse("audit"), {"kind": "opened"})
    older = client.get(f"{reverse('audit')}?{first.context['older']}")
    numbers = [entry.number for page in (first, older) for entry in page.context["entries"]]
    assert len(numbers) == 2 * SHOWN == len(set(numbers))
    assert numbers == sorted(numbers, reverse=True)


def test_one_entry_by_its_number_is_a_page_or_is_not_there(client_of: Callable[..., Client], visit: Visit) -> None:
    client = client_of(Role.ADMINISTRATOR)
    visit.delete()  # entries about what has gone are pages, too
    for number in LogEntry.objects.values_list("pk", flat=True):
        assert client.get(reverse("audit-entry", args=[number])).status_code == 200
    for number in (0, 10**9, 10**30):
        assert client.get(f"/audit/{number}/").status_code == 404
    for text in ("x", "-1", str(10**30), "１"):
        assert client.get(reverse("audit"), {"before": text}).status_code == 200


def test_thumbnails_do_not_flood_it() -> None:
    access = resolve(reverse("upload-thumbnail", args=[uuid.uuid4()])).func.access  # type: ignore[attr-defined]
    assert not access.audited


def test_what_it_is_filtered_by_is_indexed(clinic: object) -> None:
    """With 100,000 entries, a kind that is rare would be looked for in all of them."""
    query = str(entries(AuditFilter(kind="refused"))[:50].query).replace("= refused", "= 'refused'")
    with connection.cursor() as cursor:
        if connection.vendor == "postgresql":
            cursor.execute("SET enable_seqscan = off")
            cursor.execute(f"EXPLAIN {query}")
        else:
            cursor.execute(f"EXPLAIN QUERY PLAN {query}")
        plan = repr(cursor.fetchall())
    assert "clinic_audit_by_kind" in plan
