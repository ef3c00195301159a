"""Two people with one record, and one person who sends a form twice: nothing is lost, nothing is made twice."""

import time
import uuid
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from threading import Barrier
from typing import Any

import pytest
from auditlog.models import LogEntry
from django.core.files.uploadedfile import SimpleUploadedFile
from django.db import connections
from django.db.models import Model
from django.test import Client
from django.urls import reverse
from django.utils import timezone
from tests.clinic_forms import fields_of, filled
from tests.clinic_seed import DEFINITION
from tests.first_cases import first

from mammometry.clinic.config import ClinicConfig
from mammometry.clinic.maintenance.patient import erase_patient
from mammometry.clinic.models import (
    Conclusion,
    Consent,
    Correction,
    DailyCheck,
    Delivery,
    Destination,
    FormToken,
    Measurement,
    NoteChange,
    Operation,
    Patient,
    Person,
    Rig,
    Visit,
)
from mammometry.clinic.roles import CARE, Role
from mammometry.clinic.web import once

Clients = Callable[..., Client]


@dataclass(frozen=True)
class Edited:
    """A record and the page that changes it."""

    row: Model
    page: str
    """On which the form stands."""
    to: str
    """Where it is sent."""
    role: Role
    mine: dict[str, Any]
    """One field as the second person fills it in."""
    theirs: dict[str, Any]
    """Another field as the first person has saved it meanwhile."""
    others: dict[str, Any] = field(default_factory=dict)
    """Filled in besides by both."""

    @property
    def action(self) -> str:
        """The form's own address; empty: its page's."""
        return "" if self.to == self.page else self.to


def edited(what: str, visit: Visit, role: Role | None = None) -> Edited:
    """A record of this kind of a patient's visit."""
    patient, day = visit.patient, "2026-03-02"
    if what == "patient":
        page = reverse("patient-edit", args=[patient.pk])
        theirs = {"note": "allergic to latex"}
        return Edited(patient, page, page, role or Role.TECHNICIAN, {"given_name": "Qirina"}, theirs)
    if what == "operation":
        row: Model = Operation.objects.create(patient=patient, kind="implant", side="left", day=day, words="round")
        page = reverse("operation-edit", args=[row.pk])
        return Edited(row, page, page, role or Role.CLINICIAN, {"volume_cc": "315"}, {"words": "anatomical"})
    if what == "consent":
        row = Consent.objects.create(patient=patient, purpose="pictures", given_on=day)
        page = reverse("consent-edit", args=[row.pk])
        return Edited(row, page, page, role or Role.TECHNICIAN, {"note": "in the file"}, {"withdrawn_on": "2026-04-01"})
    if what == "visit":
        page, to = reverse("visit", args=[visit.pk]), reverse("circumstances", args=[visit.pk])
        return Edited(visit, page, to, role or Role.TECHNICIAN, {"occasion": "later"}, {"posture": "standing"})
    if what == "date":
        page = reverse("visit-date", args=[visit.pk])
        mine = {"taken_at": "2026-03-02T10:00"}
        return Edited(visit, page, page, role or Role.CLINICIAN, mine, {"note": "cold room"}, {"reason": "wrong"})
    if what == "person":
        row = Person.objects.create(username="eva", full_name="Eva Efeu", roles=["technician"])
        page = reverse("person", args=[row.pk])
        mine = {"full_name": "Dr. Eva Efeu"}
        return Edited(row, page, page, Role.ADMINISTRATOR, mine, {"roles": ["clinician", "technician"]})
    if what == "rig":
        row = Rig.objects.create(name="Room 9", definition=DEFINITION)
        page = reverse("rig-edit", args=[row.pk])
        return Edited(row, page, page, role or Role.TECHNICIAN, {"note": "by the window"}, {"name": "Room 10"})
    assert what == "archive"
    row = Destination.objects.create(name="PACS", address="PACS@127.0.0.1:104")
    page = reverse("destination-edit", args=[row.pk])
    return Edited(row, page, page, Role.ADMINISTRATOR, {"name": "Archive"}, {"address": "PACS@127.0.0.2:104"})


KINDS = ("patient", "operation", "consent", "visit", "date", "person", "rig", "archive")


def value_of(row: Model, name: str) -> str:
    """A field's value as a browser would send it."""
    row.refresh_from_db()
    value = getattr(row, name)
    if name == "taken_at":
        return f"{timezone.localtime(value):%Y-%m-%dT%H:%M}"
    return f"{value:g}" if isinstance(value, float) else str(value)


def require_saved(row: Model, values: dict[str, Any]) -> None:
    for name, value in values.items():
        expected = value if isinstance(value, list) else [value]
        if isinstance(value, list):
            row.refresh_from_db()
            assert sorted(getattr(row, name)) == expected
        else:
            assert [value_of(row, name)] == expected, name


@pytest.mark.parametrize("kind", first(3, KINDS))
@pytest.mark.requirement("R-KEEP-6")
def test_a_stale_form_is_answered_with_both_versions_and_loses_nothing(
    visit: Visit, client_of: Clients, kind: str
) -> None:
    what = edited(kind, visit)
    first, second = client_of(what.role, name="first"), client_of(what.role, name="second")
    stale = filled(second, what.page, what.action, **what.others, **what.mine)
    saved = filled(first, what.page, what.action, **what.others, **what.theirs)
    assert first.post(what.to, saved).status_code == 302
    answer = second.post(what.to, stale)
    assert answer.status_code == 409
    page = answer.content.decode()
    assert LogEntry.objects.filter(additional_data__kind="opened").latest("pk").actor == Person.objects.get(
        username="second"
    )  # it showed the record
    for words in ("Keep mine", "Take theirs", "first saved it"):
        assert words in page
    for values in (what.mine, what.theirs):
        for value in values.values():
            words = (value if isinstance(value, str) else "Clinician").replace("T", " ")
            assert words.lower() in page.lower()
    require_saved(what.row, what.theirs)
    assert all(value_of(what.row, name) != value for name, value in what.mine.items())
    # As it stands: what I changed is mine, what I left alone is theirs.
    assert second.post(what.to, fields_of(page, what.to)).status_code == 302
    require_saved(what.row, {**what.theirs, **what.mine})


@pytest.mark.parametrize("choice", ["mine", "theirs", "both"])
@pytest.mark.requirement("R-KEEP-6")
def test_where_both_changed_one_field_somebody_chooses(visit: Visit, client_of: Clients, choice: str) -> None:
    what, patient = edited("patient", visit), visit.patient
    patient.note = "comes by train"
    patient.save()
    first, second = client_of(Role.TECHNICIAN, name="first"), client_of(Role.CLINICIAN, name="second")
    stale = filled(second, what.page, note="prefers\r\nmornings")
    first.post(what.page, filled(first, what.page, note="allergic to latex"))
    page = second.post(what.page, stale).content.decode()
    fields = fields_of(page, what.page)
    assert "choice-note" not in fields  # nothing is proposed
    assert fields["to-choose"] == ["note"]
    unanswered = second.post(what.page, fields)
    assert unanswered.status_code == 409
    assert Patient.objects.get().note == "allergic to latex"
    chosen = {**fields_of(unanswered.content.decode(), what.page), "choice-note": choice}
    assert second.post(what.page, chosen).status_code == 302
    kept = Patient.objects.get().note.replace("\r\n", "\n")
    assert kept == {
        "mine": "prefers\nmornings",
        "theirs": "allergic to latex",
        "both": "allergic to latex\nprefers\nmornings",
    }[choice]  # fmt: skip


@pytest.mark.requirement("R-KEEP-6")
def test_a_third_change_while_somebody_chooses_is_shown_too(visit: Visit, client_of: Clients) -> None:
    what = edited("patient", visit)
    first, second = client_of(Role.TECHNICIAN, name="first"), client_of(Role.TECHNICIAN, name="second")
    stale = filled(second, what.page, given_name="Qirina")
    first.post(what.page, filled(first, what.page, note="allergic to latex"))
    page = second.post(what.page, stale).content.decode()
    first.post(what.page, filled(first, what.page, note="allergic to latex and iodine"))
    again = second.post(what.page, fields_of(page, what.page))
    assert again.status_code == 409
    assert "latex and iodine" in again.content.decode()
    assert second.post(what.page, fields_of(again.content.decode(), what.page)).status_code == 302
    patient = Patient.objects.get()
    assert (patient.given_name, patient.note) == ("Qirina", "allergic to latex and iodine")


@pytest.mark.requirement("R-KEEP-6")
def test_the_same_change_twice_is_no_conflict_and_a_form_without_its_version_is_one(
    visit: Visit, client_of: Clients
) -> None:
    what = edited("patient", visit)
    first, second = client_of(Role.TECHNICIAN, name="first"), client_of(Role.TECHNICIAN, name="second")
    same = filled(second, what.page, given_name="Qirina")
    first.post(what.page, filled(first, what.page, given_name="Qirina"))
    assert second.post(what.page, same).status_code == 302
    for version in ("", "{", "[]", '{"note": 5}'):
        sent = {**filled(second, what.page, given_name="Quirine"), "record_version": version}
        assert second.post(what.page, sent).status_code == 409
    assert Patient.objects.get().given_name == "Qirina"


@pytest.mark.parametrize("first_one", [True, False])
@pytest.mark.requirement("R-KEEP-6")
def test_two_conclusions_at_once_do_not_hide_one_another(visit: Visit, client_of: Clients, first_one: bool) -> None:
    result = Measurement.objects.create(visit=visit, digest="1", made_at=timezone.now(), software="1")
    if not first_one:
        Conclusion.objects.create(visit=visit, measurement=result, text="Symmetrical.")
    page, to = reverse("visit", args=[visit.pk]), reverse("conclude", args=[visit.pk])
    anna, bert = client_of(Role.CLINICIAN, name="anna"), client_of(Role.CLINICIAN, name="bert")
    stale = filled(bert, page, to, text="The left is fuller.")
    assert anna.post(to, filled(anna, page, to, text="Seroma on the left.")).status_code == 302
    answer = bert.post(to, stale)
    assert answer.status_code == 409
    assert "Seroma on the left." in answer.content.decode()
    assert "The left is fuller." in answer.content.decode()
    chosen = {**fields_of(answer.content.decode(), to), "choice-text": "both"}
    assert bert.post(to, chosen).status_code == 302
    newest = Conclusion.objects.first()
    assert newest is not None
    assert newest.text.split() == ["Seroma", "on", "the", "left.", "The", "left", "is", "fuller."]


@pytest.mark.requirement("R-KEEP-6")
def test_a_record_that_was_changed_is_not_removed_moved_or_binned_unseen(visit: Visit, client_of: Clients) -> None:
    what, client = edited("operation", visit), client_of(Role.TECHNICIAN)
    remove = reverse("operation-remove", args=[what.row.pk])
    stale = filled(client, what.page, remove)
    Operation.objects.update(words="anatomical")
    answer = client.post(remove, stale)
    assert answer.status_code == 409
    assert "anatomical" in answer.content.decode()
    assert Operation.objects.exists()
    assert client.post(remove, fields_of(answer.content.decode(), remove)).status_code == 302
    assert not Operation.objects.exists()
    other = Patient.objects.create(family_name="Quitte", given_name="Berta", record_number="KIS-2")
    into_bin = reverse("visit-bin", args=[visit.pk])
    stale = filled(client, into_bin, reason="Taken twice")
    Visit.objects.update(patient=other)
    answer = client.post(into_bin, stale)
    assert answer.status_code == 409
    assert "Quitte, Berta" in answer.content.decode()
    assert "Taken twice" in answer.content.decode()
    assert not Correction.objects.exists()


@pytest.mark.requirement("R-KEEP-6")
def test_a_file_that_came_with_a_stale_form_is_asked_for_again(visit: Visit, client_of: Clients) -> None:
    what, client = edited("rig", visit), client_of(Role.TECHNICIAN)
    stale = filled(client, what.page, **what.mine)
    Rig.objects.filter(pk=what.row.pk).update(name="Room 10")
    file = SimpleUploadedFile("session.toml", b"[rig]")
    page = client.post(what.page, {**stale, "described_by": file}).content.decode()
    assert page.count("file") > client.post(what.page, stale).content.decode().count("file")


@pytest.mark.requirement("R-KEEP-6")
def test_of_two_forms_at_the_same_moment_one_is_told(
    clinic: object, shared_database: None, client_of: Clients, visit: Visit
) -> None:
    """In threads, as a server answers: whoever comes second sees what the first has saved."""
    what = edited("patient", visit)
    sent = {}
    for number, values in enumerate(({"note": "allergic to latex"}, {"given_name": "Qirina"})):
        client = client_of(Role.TECHNICIAN, name=f"person-{number}")
        sent[number] = client, filled(client, what.page, **values)
    statuses = at_once(lambda number: sent[number][0].post(what.page, sent[number][1]), 2)
    assert sorted(answer.status_code for answer in statuses) == [302, 409]
    late = next(number for number, answer in enumerate(statuses) if answer.status_code == 409)
    page = statuses[late].content.decode()
    assert sent[late][0].post(what.page, fields_of(page, what.page)).status_code == 302
    patient = Patient.objects.get()
    assert (patient.given_name, patient.note) == ("Qirina", "allergic to latex")


def at_once(act: Callable[[int], Any], number: int) -> list[Any]:
    """What some threads get that begin together."""
    barrier = Barrier(number)

    def begun(each: int) -> Any:
        barrier.wait(20)
        try:
            return act(each)
        finally:
            connections.close_all()

    with ThreadPoolExecutor(number) as threads:
        return list(threads.map(begun, range(number)))


@pytest.mark.slow
@pytest.mark.requirement("R-KEEP-8")
def test_what_a_note_said_before_is_shown_to_those_who_may_read_notes(visit: Visit, client_of: Clients) -> None:
    client, patient = client_of(Role.TECHNICIAN), visit.patient
    page = reverse("patient-edit", args=[patient.pk])
    for text in ("allergic to latex", "allergic to iodine"):
        client.post(page, filled(client, page, note=text))
    day = reverse("visit-date", args=[visit.pk])
    client.post(day, filled(client, day, note="cold room", reason="forgotten"))
    entry = NoteChange.objects.filter(patient=patient)[0].entry
    history, of_audit = reverse("patient-notes", args=[patient.pk]), reverse("audit-entry", args=[entry])
    texts = ("allergic to latex", "allergic to iodine")

    def shown(address: str, *roles: Role) -> list[bool]:
        answer = client_of(*roles).get(address)
        assert answer.status_code in (200, 403)
        return [answer.status_code == 200 and text in answer.content.decode() for text in texts]

    for role in CARE:
        assert shown(history, role) == [True, True]
        assert shown(of_audit, role) == [False, False]  # the audit is the administrator's
    assert "cold room" in client.get(history).content.decode()
    for role in (Role.RESEARCHER, Role.ADMINISTRATOR):
        assert shown(history, role) == [False, False]
    assert shown(of_audit, Role.ADMINISTRATOR) == [False, False]
    assert shown(of_audit, Role.ADMINISTRATOR, Role.CLINICIAN) == [True, True]
    csv = client_of(Role.ADMINISTRATOR, Role.CLINICIAN).get(reverse("audit-csv")).content.decode()
    assert "allergic" not in csv
    assert "allergic" not in "".join(map(str, LogEntry.objects.values_list("changes", "additional_data")))


@pytest.mark.requirement("R-KEEP-8")
def test_notes_are_kept_of_a_removed_operation_and_erased_with_their_patient(
    visit: Visit, client_of: Clients, clinic: ClinicConfig
) -> None:
    what, client = edited("operation", visit), client_of(Role.TECHNICIAN)
    Operation.objects.create(patient=visit.patient, kind="graft", side="left", day="2026-03-02", words="from the thigh")
    visit.note = "cold room"
    visit.save()
    remove = reverse("operation-remove", args=[what.row.pk])
    client.post(remove, filled(client, what.page, remove))
    removed = NoteChange.objects.filter(patient=visit.patient)[0]
    assert (removed.before, removed.after) == ("round", "")
    assert NoteChange.objects.count() == 4
    erase_patient(clinic, visit.patient)
    assert not NoteChange.objects.exists()


# --- one form is carried out once


@dataclass(frozen=True)
class Creating:
    """A form that makes something."""

    model: type[Model]
    page: str
    to: str
    role: Role
    values: dict[str, Any]
    script: bool = False
    """Whether a script sends it, and is answered in JSON."""

    @property
    def action(self) -> str:
        """The form's own address; empty: its page's."""
        return "" if self.to == self.page.partition("?")[0] else self.to


def creating(what: str, visit: Visit) -> Creating:
    """The form that makes one of these."""
    patient = visit.patient
    if what == "patient":
        page, names = reverse("patient-new"), {"family_name": "Ahorn", "given_name": "Anna", "record_number": "K-1"}
        return Creating(Patient, page, page, Role.TECHNICIAN, names)
    if what == "visit":
        page = f"{reverse('visit-new')}?patient={patient.pk}"
        return Creating(Visit, page, reverse("visit-new"), Role.TECHNICIAN, {"patient": str(patient.pk)})
    if what == "operation":
        page = reverse("operation-new", args=[patient.pk])
        values = {"kind": "implant", "side": "left", "day": "2026-03-02"}
        return Creating(Operation, page, page, Role.CLINICIAN, values)
    if what == "consent":
        page = reverse("consent-new", args=[patient.pk])
        return Creating(Consent, page, page, Role.TECHNICIAN, {"purpose": "pictures"})
    if what == "conclusion":
        Measurement.objects.create(visit=visit, digest="1", made_at=timezone.now(), software="1")
        page, to = reverse("visit", args=[visit.pk]), reverse("conclude", args=[visit.pk])
        return Creating(Conclusion, page, to, Role.CLINICIAN, {"text": "Symmetrical."})
    if what == "delivery":
        Measurement.objects.create(visit=visit, digest="1", made_at=timezone.now(), software="1")
        destination = Destination.objects.create(name="PACS", address="PACS@127.0.0.1:104")
        report = visit.folder / "results" / "report"
        report.mkdir(parents=True)
        (report / "report.pdf").write_bytes(b"%PDF-1.4")
        page = reverse("visit-send", args=[visit.pk])
        return Creating(Delivery, page, page, Role.CLINICIAN, {"destination": str(destination.pk), "anyway": "1"})
    if what == "correction":
        page = reverse("visit-bin", args=[visit.pk])
        return Creating(Correction, page, page, Role.TECHNICIAN, {"reason": "Taken twice"})
    if what == "person":
        page = reverse("person-new")
        return Creating(Person, page, page, Role.ADMINISTRATOR, {"username": "eva", "roles": ["technician"]})
    if what == "archive":
        page, values = reverse("destination-new"), {"name": "PACS", "kind": "dicom", "address": "PACS@10.0.0.5:104"}
        return Creating(Destination, page, page, Role.ADMINISTRATOR, values)
    assert what == "check"
    assert visit.rig is not None
    visit.rig.calibrations.create(taken_at=timezone.now(), folder="calibrations/x", state="done", current=True)
    page, to = reverse("rig", args=[visit.rig_id]), reverse("check-new", args=[visit.rig_id])
    return Creating(DailyCheck, page, to, Role.TECHNICIAN, {}, script=True)


MADE = (
    "patient", "visit", "operation", "consent", "conclusion", "delivery", "correction", "person", "archive", "check",
)  # fmt: skip


def sent_by(client: Client, what: Creating, fields: dict[str, Any]) -> Any:
    if not what.script:
        return client.post(what.to, fields)
    token = fields["form_token"][0]
    return client.post(what.to, "{}", content_type="application/json", headers={"Form-Token": token})


@pytest.mark.parametrize("kind", first(5, MADE))
@pytest.mark.requirement("R-KEEP-7")
def test_a_form_sent_twice_makes_one(visit: Visit, client_of: Clients, kind: str) -> None:
    what = creating(kind, visit)
    client, before = client_of(what.role), what.model._base_manager.count()
    fields = filled(client, what.page, what.action, **what.values)
    answers = [sent_by(client, what, fields) for _ in range(3)]
    assert {answer.status_code for answer in answers} == {201 if what.script else 302}
    assert len({answer.get("Location") for answer in answers}) == 1
    assert len({answer.content for answer in answers}) == 1
    assert what.model._base_manager.count() == before + 1
    # Another form makes another one, if it is meant: the same button was not pressed twice.
    if kind in ("visit", "operation", "check"):
        other = filled(client, what.page, what.action, **what.values)
        sent_by(client, what, other)
        assert what.model._base_manager.count() == before + 2


@pytest.mark.parametrize("kind", ["visit", "operation", "consent", "check"])
@pytest.mark.requirement("R-KEEP-7")
def test_a_double_click_makes_one(
    clinic: object, shared_database: None, client_of: Clients, visit: Visit, kind: str
) -> None:
    """Requests at the same moment, each in a thread of its own."""
    what = creating(kind, visit)
    client, before = client_of(what.role), what.model._base_manager.count()
    fields = filled(client, what.page, what.action, **what.values)
    copies = [Client() for _ in range(4)]
    for copy in copies:
        copy.cookies = client.cookies
    answers = at_once(lambda number: sent_by(copies[number], what, fields), len(copies))
    assert {answer.status_code for answer in answers} == {201 if what.script else 302}
    assert len({(answer.get("Location"), answer.content) for answer in answers}) == 1
    assert what.model._base_manager.count() == before + 1
    assert FormToken.objects.count() == 1


@pytest.mark.slow
@pytest.mark.requirement("R-KEEP-7")
def test_a_long_request_is_carried_out_once_too(
    clinic: object, shared_database: None, client_of: Clients, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that is no transaction: its token is taken first, and others wait for its answer."""
    client, token = client_of(Role.ADMINISTRATOR), str(uuid.uuid4())
    archive, tested = Destination.objects.create(name="PACS", address="PACS@h:104"), []
    monkeypatch.setattr("mammometry.clinic.deliveries.test", lambda shown: (time.sleep(0.3), tested.append(shown)))
    copies = [Client() for _ in range(3)]
    for copy in copies:
        copy.cookies = client.cookies
    address = reverse("destination-test", args=[archive.pk])
    answers = at_once(lambda number: copies[number].post(address, {"form_token": token}), len(copies))
    assert [(answer.status_code, answer["Location"]) for answer in answers] == [(302, reverse("destinations"))] * 3
    assert tested == [archive]
    # One whose request died is carried out after a while; before, it is said that it is at work.
    monkeypatch.setattr(once, "_WAIT_S", 0.5)
    died = FormToken.objects.create(person=Person.objects.get(username="administrator"), token=uuid.uuid4())
    assert client.post(address, {"form_token": str(died.token)}).status_code == 409
    FormToken.objects.filter(pk=died.pk).update(at=timezone.now() - 2 * once._ABANDONED)
    assert client.post(address, {"form_token": str(died.token)}).status_code == 302
    assert tested == [archive] * 2


@pytest.mark.requirement("R-KEEP-7")
def test_a_form_that_was_not_right_can_be_sent_again(visit: Visit, client_of: Clients) -> None:
    what = creating("operation", visit)
    client = client_of(what.role)
    fields = filled(client, what.page, **what.values)
    assert client.post(what.to, {**fields, "day": "2999-01-01"}).status_code == 200
    assert not FormToken.objects.exists()
    assert client.post(what.to, fields).status_code == 302
    assert Operation.objects.count() == 1


@pytest.mark.requirement("R-KEEP-7")
def test_a_token_is_one_persons_and_is_forgotten_in_time(visit: Visit, client_of: Clients) -> None:
    what = creating("operation", visit)
    fields = filled(client_of(what.role), what.page, **what.values)
    for name in ("anna", "bert"):
        assert client_of(what.role, name=name).post(what.to, fields).status_code == 302
    assert Operation.objects.count() == 2
    FormToken.objects.update(at=timezone.now() - 2 * once._KEPT)
    client = client_of(what.role, name="anna")
    assert client.post(what.to, {**fields, "form_token": str(uuid.uuid4())}).status_code == 302
    assert FormToken.objects.count() == 1
    assert client.post(what.to, {**fields, "form_token": "x"}).status_code == 302  # none: carried out each time
    assert Operation.objects.count() == 4


@pytest.mark.requirement("R-KEEP-7")
def test_the_page_after_a_form_names_it_as_accepted(visit: Visit, client_of: Clients) -> None:
    """By this the page forgets what was typed."""
    what = creating("operation", visit)
    client = client_of(what.role)
    fields = filled(client, what.page, **what.values)
    page = client.post(what.to, fields, follow=True).content.decode()
    assert f'data-accepted="{fields["form_token"][0]}"' in page
