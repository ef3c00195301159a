"""A visit out of the hospital's worklist."""

import datetime
from collections.abc import Callable
from dataclasses import replace

import pytest
from django.test import Client
from django.urls import reverse

from mammometry.base.errors import ArchiveError
from mammometry.clinic.config import ClinicConfig
from mammometry.clinic.deliveries import order_of
from mammometry.clinic.models import Destination, Patient, Rig, Visit
from mammometry.clinic.roles import Role
from mammometry.clinic.views import hospital
from mammometry.hospital.dicom.worklist import Worklist, WorklistEntry
from mammometry.hospital.exported import ExportedPatient as PatientModule
from mammometry.hospital.exported import Order

ENTRY = WorklistEntry(
    patient=PatientModule(id="KIS-4712", name="Muster^Anna^Maria", born=datetime.date(1971, 5, 4), sex="F"),
    order=Order(accession="A123", study_uid="1.2.3", referring="House^Gregory", procedure="Breast volumes"),
)


@pytest.fixture
def asked(clinic: ClinicConfig, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """A worklist with one entry, and a page's press on its button."""
    monkeypatch.setattr(hospital, "_asked", lambda source, **_: Worklist(entries=(ENTRY,)))
    source = Destination.objects.create(name="RIS", kind="worklist", address="RIS@127.0.0.1:105")
    rig = Rig.objects.create(name="Four cameras")
    return {"worklist": str(source.pk), "rig": str(rig.pk), "accession": "A123", "patient": "KIS-4712"}


def test_an_entry_becomes_patient_visit_and_order(client_of: Callable[..., Client], asked: dict[str, str]) -> None:
    client = client_of(Role.TECHNICIAN)
    assert "Muster, Anna" in client.get(reverse("worklist")).content.decode()
    client.post(reverse("worklist"), asked)
    (visit,) = Visit.objects.all()
    assert visit.patient.name == "Muster, Anna"
    assert visit.patient.born == datetime.date(1971, 5, 4)
    assert order_of(visit) == ENTRY.order
    client.post(reverse("worklist"), asked)  # a second visit of the same patient
    assert (Patient.objects.count(), Visit.objects.count()) == (1, 2)


@pytest.mark.parametrize("known", [{"family_name": "Other"}, {"born": datetime.date(1950, 1, 1)}])
@pytest.mark.requirement("R-KEEP-5")
def test_a_record_number_of_somebody_else_makes_no_visit(
    client_of: Callable[..., Client], asked: dict[str, str], known: dict[str, object]
) -> None:
    Patient.objects.create(**{"family_name": "Muster", "given_name": "Anna", "record_number": "KIS-4712", **known})
    answer = client_of(Role.TECHNICIAN).post(reverse("worklist"), asked, follow=True)
    assert [message.level_tag for message in answer.context["messages"]] == ["error"]
    assert not Visit.objects.exists()


@pytest.mark.parametrize("born", [datetime.date(1899, 12, 31), datetime.date(2999, 1, 1)])
def test_a_birthday_that_cannot_be_makes_no_visit(
    client_of: Callable[..., Client], asked: dict[str, str], monkeypatch: pytest.MonkeyPatch, born: datetime.date
) -> None:
    entry = replace(ENTRY, patient=replace(ENTRY.patient, born=born))
    monkeypatch.setattr(hospital, "_asked", lambda source, **_: Worklist(entries=(entry,)))
    answer = client_of(Role.TECHNICIAN).post(reverse("worklist"), asked, follow=True)
    assert "1900 and" in answer.content.decode()
    assert not Patient.objects.exists()


def test_an_entry_that_cannot_be_used_is_named_beside_the_others(
    client_of: Callable[..., Client], asked: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    refused = ArchiveError("RIS, entry A7", found="the patient's id with a backslash", expected="none", remedy="Ask")
    monkeypatch.setattr(hospital, "_asked", lambda source, **_: Worklist(entries=(ENTRY,), refused=(refused,)))
    page = client_of(Role.TECHNICIAN).get(reverse("worklist")).content.decode()
    assert "RIS, entry A7:" in page
    assert "Muster, Anna" in page


def test_a_name_in_several_letterings_is_taken_from_its_first(
    client_of: Callable[..., Client], asked: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second group was read as part of the given name."""
    listed = replace(ENTRY, patient=replace(ENTRY.patient, name="Yamada^Tarou=山田^太郎=やまだ^たろう"))
    monkeypatch.setattr(hospital, "_asked", lambda source, **_: Worklist(entries=(listed,)))
    client_of(Role.TECHNICIAN).post(reverse("worklist"), asked)
    assert Patient.objects.get().name == "Yamada, Tarou"


def test_an_entry_that_is_gone_makes_no_visit(client_of: Callable[..., Client], asked: dict[str, str]) -> None:
    client_of(Role.TECHNICIAN).post(reverse("worklist"), {**asked, "accession": "A999"})
    assert not Visit.objects.exists()


def test_a_worklist_that_is_down_says_so(
    client_of: Callable[..., Client], asked: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def down(source: Destination, **_: object) -> None:
        raise ArchiveError("RIS", found="no answer", expected="a DICOM application", remedy="Start it")

    monkeypatch.setattr(hospital, "_asked", down)
    assert "answer" in client_of(Role.CLINICIAN).get(reverse("worklist")).content.decode()


def test_the_same_patient_under_another_number_is_shown_first(
    client_of: Callable[..., Client], asked: dict[str, str]
) -> None:
    table = {"family_name": "MUSTER", "given_name": "Anna", "born": datetime.date(1971, 5, 4)}
    other = Patient.objects.create(**table, record_number="OLD-1")
    client = client_of(Role.TECHNICIAN)
    page = client.post(reverse("worklist"), asked).content.decode()
    assert reverse("patient", args=[other.pk]) in page
    assert not Visit.objects.exists()
    assert client.post(reverse("worklist"), {**asked, "anyway": "1"}).status_code == 302
    assert Patient.objects.count() == 2


def test_a_record_number_is_known_without_its_hyphen(client_of: Callable[..., Client], asked: dict[str, str]) -> None:
    known = Patient.objects.create(family_name="Muster", given_name="Anna", record_number="kis 4712")
    client_of(Role.TECHNICIAN).post(reverse("worklist"), asked)
    assert Visit.objects.get().patient == known
