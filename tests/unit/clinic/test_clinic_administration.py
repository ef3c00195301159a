"""Administration in the clinic's own pages: people, backups, disk, erase, and the first day of a fresh clinic."""

import datetime
import html
import os
import re
from collections.abc import Callable
from dataclasses import replace

import pytest
from allauth.mfa.models import Authenticator
from auditlog.models import LogEntry
from django.core.cache import cache
from django.test import Client
from django.urls import reverse
from pytest_django import Settings
from tests.clinic_forms import refused
from tests.clinic_seed import DEFINITION

from mammometry.clinic.config import ClinicConfig
from mammometry.clinic.jobs import queue
from mammometry.clinic.maintenance import backups
from mammometry.clinic.maintenance.disk import measure_usage
from mammometry.clinic.models import Job, Patient, Person, Rig, Upload, Visit
from mammometry.clinic.rig_history import new_calibration
from mammometry.clinic.roles import Role
from mammometry.clinic.views.today import first_day_of, steps

NEW = {"username": "anna", "full_name": "Anna Ahorn", "email": "", "roles": ["technician"], "is_active": "on"}


def text_of(client: Client, path: str, **query: str) -> str:
    answer = client.get(path, query, follow=True)
    assert answer.status_code == 200, path
    return html.unescape(answer.content.decode())


def test_a_person_is_entered_and_the_link_is_shown_once(client_of: Callable[..., Client]) -> None:
    client = client_of(Role.ADMINISTRATOR)
    page = client.post(reverse("person-new"), NEW, follow=True)
    anna = Person.objects.get(username="anna")
    assert "/account/invitation/" in page.content.decode()
    assert not anna.has_usable_password()
    assert "/account/invitation/" not in text_of(client, reverse("person", args=[anna.pk]))
    again = client.post(reverse("person-invite", args=[anna.pk]), follow=True)
    assert "/account/invitation/" in again.content.decode()
    link = LogEntry.objects.filter(changes__icontains="/account/invitation/") | LogEntry.objects.filter(
        additional_data__icontains="/account/invitation/"
    )
    assert not link.exists()


@pytest.mark.parametrize(
    ("changed", "field"),
    [
        ({"roles": []}, "roles"),
        ({"username": "administrator"}, "username"),
        ({"username": "anna anna"}, "username"),
    ],
)
def test_what_cannot_be_entered(client_of: Callable[..., Client], changed: dict[str, object], field: str) -> None:
    page = client_of(Role.ADMINISTRATOR).post(reverse("person-new"), {**NEW, **changed})
    assert set(refused(page)) == {field}
    assert not Person.objects.filter(full_name="Anna Ahorn").exists()


@pytest.mark.slow
def test_a_person_is_let_in_again(client_of: Callable[..., Client], person_of: Callable[..., Person]) -> None:
    client, person = client_of(Role.ADMINISTRATOR), person_of(Role.TECHNICIAN)
    person.set_password("three grey herons wade")
    person.save()
    Authenticator.objects.create(user=person, type=Authenticator.Type.TOTP, data={})
    assert reverse("person-factor", args=[person.pk]) in text_of(client, reverse("person", args=[person.pk]))
    client.post(reverse("person-factor", args=[person.pk]))
    assert not Authenticator.objects.exists()
    guest = Client()
    for _ in range(8):
        answer = guest.post(reverse("account_login"), {"login": person.username, "password": "wrong"})
    assert answer.status_code == 429
    client.post(reverse("person-let-in", args=[person.pk]))
    answer = guest.post(reverse("account_login"), {"login": person.username, "password": "three grey herons wade"})
    assert answer.status_code == 302


def test_nothing_of_the_framework_is_left(clinic: ClinicConfig, settings: Settings) -> None:
    assert "django.contrib.admin" not in settings.INSTALLED_APPS


def test_the_overview_says_what_needs_an_administrator(
    client_of: Callable[..., Client], person_of: Callable[..., Person]
) -> None:
    invited = person_of(Role.TECHNICIAN)
    invited.set_unusable_password()
    invited.save()
    Client().post(reverse("account_login"), {"login": "nobody", "password": "wrong"})
    page = text_of(client_of(Role.ADMINISTRATOR), "/")
    assert reverse("person", args=[invited.pk]) in page
    assert re.search("<strong>1</strong> .*login", page)
    assert reverse("backups") in page


# --- backups ---


def test_a_backup_and_a_restore_test_are_queued(clinic: ClinicConfig, client_of: Callable[..., Client]) -> None:
    client = client_of(Role.ADMINISTRATOR)
    assert client.get(reverse("backup-make")).status_code == 405
    client.post(reverse("backup-make"))
    job = Job.objects.get(kind=Job.Kind.BACKUP)
    assert str(job.created_by) == "administrator"
    assert "waiting" in client.get(reverse("backups")).content.decode()
    assert "running" in client.post(reverse("backup-test"), follow=True).content.decode()
    queue.claim("runner", 1, [Job.Kind.BACKUP])
    assert queue.done(job.pk, "runner", {})
    client.post(reverse("backup-test"))
    assert Job.objects.get(kind=Job.Kind.RESTORE).state == Job.State.QUEUED
    Job.objects.all().delete()
    with backups.exclusive(clinic):
        page = client.post(reverse("backup-make"), follow=True)
    assert [message.level_tag for message in page.context["messages"]][-1] == "warning"
    assert not Job.objects.exists()


def test_the_newest_backups_are_kept(clinic: ClinicConfig, client_of: Callable[..., Client], visit: Visit) -> None:
    for day in range(1, 6):
        (clinic.backups / f"clinic-2026010{day}-023000.tar").write_bytes(b"old")
    (clinic.backups / "before-upgrade.tar").write_bytes(b"kept by hand")
    made = backups.make_kept_backup(clinic)
    names = [file.path.name for file in backups.backup_files(clinic)]
    assert names == [made.name, "clinic-20260105-023000.tar", "clinic-20260104-023000.tar"]
    assert (clinic.backups / "before-upgrade.tar").exists()
    page = text_of(client_of(Role.ADMINISTRATOR), reverse("backups"))
    assert made.name in page


def test_a_backup_without_room_is_refused_and_said(
    clinic: ClinicConfig, client_of: Callable[..., Client], monkeypatch: pytest.MonkeyPatch
) -> None:
    (clinic.backups / "clinic-20260101-023000.tar").write_bytes(b"x" * 1000)
    usage = backups.shutil.disk_usage(clinic.folder)
    monkeypatch.setattr(backups.shutil, "disk_usage", lambda _: usage._replace(free=1100))
    with pytest.raises(backups.ClinicError, match="GB free"):
        backups.make_kept_backup(clinic)
    assert len(backups.backup_files(clinic)) == 1
    assert "failed" in text_of(client_of(Role.ADMINISTRATOR), reverse("backups"))


def test_a_backup_is_due_once_a_day_in_the_clinics_zone(clinic: ClinicConfig) -> None:
    berlin = clinic.model_copy(update={"time_zone": "Europe/Berlin"})
    now = datetime.datetime.now(datetime.UTC) + datetime.timedelta(days=10)
    at = now.replace(hour=1, minute=29, second=59)  # 02:30 in Berlin is 01:30 UTC in winter, 00:30 in summer
    at = at if at.astimezone(datetime.UTC).month in (11, 12, 1, 2) else at.replace(month=1)
    at = at.replace(year=at.year + 1)
    assert backups.is_due(berlin, at)  # yesterday's was not made
    for moment, due in ((at, False), (at + datetime.timedelta(seconds=2), True)):
        backups.note(berlin, "backup", passed=False, sentence="full")
        outcome = backups._outcomes(berlin)["backup"]
        tried = replace(outcome, at=(at - datetime.timedelta(hours=1)).isoformat())
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(backups, "_outcomes", lambda _, tried=tried: {"backup": tried})
            assert backups.is_due(berlin, moment) is due
    off = clinic.backup.model_copy(update={"daily_at": ""})
    assert not backups.is_due(clinic.model_copy(update={"backup": off}), at)


def test_a_backup_of_a_clock_in_the_future_hides_no_other(clinic: ClinicConfig) -> None:
    """A clock that was once set to next year must not stop the backups until then."""
    now = datetime.datetime.now(datetime.UTC)
    (clinic.backups / "clinic-20990101-023000.tar").write_bytes(b"of the future")
    stamp = (now + datetime.timedelta(days=365)).timestamp()
    os.utime(clinic.backups / "clinic-20990101-023000.tar", (stamp, stamp))
    assert backups.is_due(clinic, now + datetime.timedelta(days=2))
    made = backups.make_kept_backup(clinic)
    assert [file.path.name for file in backups.backup_files(clinic)] == [made.name, "clinic-20990101-023000.tar"]


def test_a_fresh_clinic_waits_for_its_first_night(clinic: ClinicConfig) -> None:
    assert not backups.is_due(clinic, datetime.datetime.now(datetime.UTC))


# --- disk ---


def test_the_disk_is_counted_and_foretold(clinic: ClinicConfig, client_of: Callable[..., Client], visit: Visit) -> None:
    (visit.folder / "capture").mkdir(parents=True)
    (visit.folder / "results" / "report").mkdir(parents=True)
    (visit.folder / "capture" / "a.jpg").write_bytes(b"x" * 3000)
    (visit.folder / "results" / "report" / "r.html").write_bytes(b"x" * 500)
    usage = measure_usage(clinic)
    assert (usage.photographs, usage.results) == (3000, 500)
    assert usage.per_day == 3500 / usage.rate_days
    assert usage.days_left == int(usage.free / usage.per_day)
    cache.clear()
    assert "3.0 kB" in text_of(client_of(Role.ADMINISTRATOR), reverse("disk"))
    short = replace(usage, free=usage.total // 2, per_day=usage.total / 100)
    assert (short.days_left, short.is_short, short.lasts) == (50, True, "50 days")
    assert replace(usage, per_day=0.0).days_left is None


# --- erase ---


def test_a_patient_is_erased_by_the_pseudonym_typed_twice(
    clinic: ClinicConfig, client_of: Callable[..., Client], person_of: Callable[..., Person], visit: Visit
) -> None:
    client = client_of(Role.ADMINISTRATOR)
    pseudonym = visit.patient.pseudonym
    Upload.objects.create(visit=visit, camera="front_left", size_bytes=9, state="placed")
    page = text_of(client, reverse("erase"), pseudonym=pseudonym.lower())
    assert pseudonym in page
    assert "Zypernkatze" not in page
    for again in ("", "P-AAAAAA"):
        client.post(reverse("erase"), {"pseudonym": pseudonym, "again": again})
        assert Patient.objects.exists()
    done = client.post(reverse("erase"), {"pseudonym": pseudonym, "again": pseudonym})
    assert pseudonym in done.content.decode()
    assert not Patient.objects.exists()
    entry = LogEntry.objects.get(additional_data__page="command erase")
    assert entry.actor == person_of(Role.ADMINISTRATOR)


def test_a_patient_who_is_being_measured_stays(client_of: Callable[..., Client], visit: Visit) -> None:
    from django.utils import timezone

    until = timezone.now() + datetime.timedelta(minutes=1)
    Job.objects.create(visit=visit, kind=Job.Kind.MEASURE, state=Job.State.RUNNING, lease_until=until)
    pseudonym = visit.patient.pseudonym
    page = client_of(Role.ADMINISTRATOR).post(reverse("erase"), {"pseudonym": pseudonym, "again": pseudonym})
    assert "measured" in html.unescape(page.content.decode())
    assert Patient.objects.exists()


# --- the first day ---


@pytest.mark.slow
def test_the_first_day_goes_step_by_step_and_ends_by_itself(
    client_of: Callable[..., Client], person_of: Callable[..., Person]
) -> None:
    boss = person_of(Role.ADMINISTRATOR)
    client = client_of(Role.ADMINISTRATOR)

    def next_step() -> tuple[str, bool] | None:
        day = first_day_of(boss)
        return None if day is None else (day.next_step.title, day.may_do)

    assert next_step() == ("People", True)
    assert reverse("person-new") in text_of(client, "/")
    technician = client_of(Role.TECHNICIAN)
    assert next_step() == ("Rig", True)
    rig = Rig.objects.create(name="Room 1", definition=DEFINITION)
    assert next_step() == ("Board to print", True)
    board = client.get(reverse("rig-target", args=[rig.pk]))
    assert board.headers["Content-Type"] == "application/pdf"
    assert board.content.startswith(b"%PDF")
    assert next_step() == ("Calibration", True)
    calibration = new_calibration(rig, None)
    calibration.state, calibration.current = "done", True
    calibration.save()
    assert next_step() == ("First patient", False)
    assert reverse("patient-new") not in text_of(client, "/")
    assert reverse("patient-new") in text_of(technician, "/")
    Patient.objects.create(family_name="Meier", given_name="Eva", record_number="1")
    assert next_step() is None
    assert steps() == []
    assert "first day" not in text_of(technician, "/")


def test_a_rig_without_a_board_says_so(client_of: Callable[..., Client]) -> None:
    rig = Rig.objects.create(name="Room 1", definition={"target": {"kind": "none of these"}})
    page = client_of(Role.ADMINISTRATOR).get(reverse("rig-target", args=[rig.pk]), follow=True)
    assert [message.level_tag for message in page.context["messages"]] == ["error"]


# --- menus ---


@pytest.mark.parametrize(
    ("roles", "first"),
    [
        ((Role.TECHNICIAN,), ["Today", "Patients", "Worklist", "Rigs", "Jobs"]),
        ((Role.CLINICIAN, Role.TECHNICIAN), ["Today", "Patients", "Worklist", "Study", "Rigs", "Jobs"]),
        ((Role.RESEARCHER,), ["Study"]),
        ((Role.ADMINISTRATOR,), ["Administration", "Rigs"]),
    ],
)
def test_the_menu_is_the_roles(client_of: Callable[..., Client], roles: tuple[Role, ...], first: list[str]) -> None:
    answer = client_of(*roles).get(reverse("help"))
    titles = [place.title for place in answer.context["places"]]
    assert titles[: len(first)] == first
    assert titles[-1] == "Help"
