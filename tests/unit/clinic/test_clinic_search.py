"""Search: every spelling finds the patient on both databases, and near duplicates are shown before a new record."""

import datetime
from collections.abc import Callable

import pytest
from django.test import Client
from django.utils import timezone
from tests.clinic_forms import filled

from mammometry.clinic.config import ClinicConfig
from mammometry.clinic.models import Patient, Rig, Visit
from mammometry.clinic.records.search import MANY, matches, search
from mammometry.clinic.records.search_words import read_query
from mammometry.clinic.roles import Role

NOON = datetime.datetime(2026, 3, 1, 12, tzinfo=datetime.UTC)
BORN = datetime.date(1979, 5, 14)


def entered(family: str, given: str = "Anna", number: str = "KIS-4711", born: object = BORN) -> Patient:
    return Patient.objects.create(family_name=family, given_name=given, record_number=number, born=born)


@pytest.mark.parametrize(
    ("family", "given", "query"),
    [
        *(("Müller", "Siobhán", text) for text in ("MÜLLER", "muller", "mueller", "siobhan", "Siobhán müller")),
        *(("Müller-Lüdenscheid", "Ida", text) for text in ("müller lüd", "MULLER-LUDENSCHEID", "ludenscheid, ida")),
        *(("Strauß", "Åse", text) for text in ("strauss", "STRAUSS", "strauß", "ase", "ÅSE")),
        *(("O’Brien", "Zoë", text) for text in ("obrien", "O'BRIEN", "brien zoe")),
        *(("Łuczak", "Øyvind", text) for text in ("luczak", "oyvind", "ŁUCZAK")),
        *(("Иванова", "Ольга", text) for text in ("ИВАНОВА", "ольга иванова")),
    ],
)
def test_case_accents_and_order_do_not_matter(clinic: ClinicConfig, family: str, given: str, query: str) -> None:
    patient = entered(family, given)
    entered("Andere", "Bea", "9", None)
    assert list(search(query)) == [patient]


@pytest.mark.parametrize("query", ["KIS-4711", "kis4711", "kis 4711", "4711", "KIS 47-11"])
def test_a_record_number_is_found_with_and_without_its_hyphen(clinic: ClinicConfig, query: str) -> None:
    for number in ("KIS-4711", "Kis 4711", "KIS4711"):
        patient = entered("Meier", number=number)
        assert list(search(query)) == [patient]
        patient.delete()


@pytest.mark.parametrize(
    "query",
    [
        *("1979-05-14", "14.05.1979", "14.5.79", "14. 5. 1979", "14/05/1979", "14 May 1979", "May 14, 1979"),
        *("14. Mai 1979", "14 may 79", "05/14/1979", "19790514", "14051979", "meier 14.5.79", "14.5.79 ANNA"),
    ],
)
def test_a_birthday_is_found_in_any_common_form(clinic: ClinicConfig, query: str) -> None:
    patient = entered("Meier")
    entered("Meier", number="2", born=datetime.date(1979, 5, 15))
    assert list(search(query)) == [patient]


def test_a_number_that_looks_like_a_day_is_found_too(clinic: ClinicConfig) -> None:
    patient = entered("Meier", number="14.05.1979-M3")
    for query in ("14.05.1979-M3", "14051979M3"):
        assert list(search(query)) == [patient]
    dated = entered("Huber", number="2026-01-02", born=None)
    assert list(search("2026-01-02")) == [dated]


def test_pseudonyms_and_days_of_visits_are_found_and_nothing_else(clinic: ClinicConfig) -> None:
    patient = entered("Zypernkatze", "Quirina")
    rig = Rig.objects.create(name="Room 1")
    Visit.objects.create(patient=patient, rig=rig, taken_at=NOON)
    for query in (patient.pseudonym, patient.pseudonym.lower(), patient.pseudonym[2:], "1 March 2026", "zyp quir"):
        assert list(search(query)) == [patient], query
    for query in ("quirina meier", "2026-03-02", "%", "_", "31.02.1979", "zypernkatzen"):
        assert not search(query).exists(), query


def test_a_day_that_is_none_is_a_word() -> None:
    assert read_query("31.02.1979").days == ()
    assert read_query("31.02.1979").words == ("31021979",)


def test_words_follow_a_change_and_many_that_are_entered_at_once(clinic: ClinicConfig) -> None:
    patient = entered("Meier")
    patient.family_name = "Größer"
    patient.save(update_fields=["family_name"])
    assert list(search("grosser")) == [patient]
    assert not search("meier").exists()
    Patient.objects.bulk_create([Patient(family_name="Ünal", given_name=str(k), record_number=f"U-{k}") for k in "ab"])
    assert search("unal").count() == 2


def test_no_page_lists_more_than_it_shows(
    clinic: ClinicConfig, client_of: Callable[..., Client], django_assert_max_num_queries: Callable[..., object]
) -> None:
    Patient.objects.bulk_create(
        [Patient(family_name="Meier", given_name=str(k), record_number=str(k)) for k in range(MANY + 20)]
    )
    assert len(matches("meier")) == MANY + 1
    client = client_of(Role.TECHNICIAN)
    for path in ("/visits/new/", "/visits/scan/", "/patients/"):
        with django_assert_max_num_queries(20):  # type: ignore[attr-defined]
            text = client.get(path).content.decode()
        assert "<option" not in text, path
        assert text.count('class="row"') <= MANY, path
    part = client.get("/visits/new/?q=meier+11", headers={"HX-Request": "true"}).content.decode()
    assert "<html" not in part
    assert part.count('class="row"') == 1


def test_a_visit_begins_with_the_patient_who_was_searched_for(
    clinic: ClinicConfig, client_of: Callable[..., Client]
) -> None:
    patient = entered("Müller")
    rig = Rig.objects.create(name="Room 1", definition={"rig": {"pairs": []}})
    client = client_of(Role.TECHNICIAN)
    found = client.get("/visits/new/?q=MULLER").content.decode()
    assert f"?patient={patient.pk}" in found
    form = client.get(f"/visits/new/?patient={patient.pk}")
    assert "Müller, Anna" in form.content.decode()
    assert f'<option value="{rig.pk}" selected>' in form.content.decode()  # the only rig
    sent = {"patient": str(patient.pk), "rig": str(rig.pk), "taken_at": "2026-03-01T12:00", "subject_kind": "torso"}
    client.post("/visits/new/", sent)
    assert Visit.objects.get().patient == patient
    assert client.get("/visits/new/?patient=nobody").status_code == 404


def test_a_strange_day_is_asked_about_once(clinic: ClinicConfig, client_of: Callable[..., Client]) -> None:
    from mammometry.clinic.models import Calibration

    patient, rig = entered("Müller"), Rig.objects.create(name="Room 1", definition={"rig": {"pairs": []}})
    Calibration.objects.create(rig=rig, taken_at=NOON, folder="c", state="done", current=True)
    client = client_of(Role.TECHNICIAN)
    sent = {"patient": str(patient.pk), "rig": str(rig.pk), "subject_kind": "torso"}
    tomorrow = f"{timezone.localtime() + datetime.timedelta(days=1):%Y-%m-%dT%H:%M}"
    for day, question in ((tomorrow, "in the future"), ("2026-02-01T10:00", "before the first calibration")):
        answer = client.post("/visits/new/", {**sent, "taken_at": day}).content.decode()
        assert question in answer
        assert 'name="anyway"' in answer
        assert not Visit.objects.exists()
        client.post("/visits/new/", {**sent, "taken_at": day, "anyway": "1"})
        Visit.objects.get().delete()
    answer = client.post("/visits/new/", {**sent, "taken_at": "2026-03-01T00:30"})
    assert answer.status_code == 302


@pytest.mark.slow
def test_days_that_no_clinic_has_are_refused_whoever_insists(
    clinic: ClinicConfig, client_of: Callable[..., Client]
) -> None:
    patient, rig = entered("Müller"), Rig.objects.create(name="Room 1", definition={"rig": {"pairs": []}})
    sent = {"patient": str(patient.pk), "rig": str(rig.pk), "subject_kind": "torso", "anyway": "1"}
    client = client_of(Role.TECHNICIAN, Role.CLINICIAN, Role.RESEARCHER, Role.ADMINISTRATOR)
    for day in ("1899-12-31", "0001-01-01", "9999-12-31", f"{timezone.localdate() + datetime.timedelta(days=2)}"):
        assert "1900 and" in client.post("/visits/new/", {**sent, "taken_at": f"{day}T10:00"}).content.decode()
        operation = {"kind": "graft", "side": "left", "day": day}
        assert client.post(f"/patients/{patient.pk}/operations/new/", operation).status_code == 200
        consent = {"purpose": "research", "given_on": day}
        assert client.post(f"/patients/{patient.pk}/consents/new/", consent).status_code == 200
        for page in ("/study/", "/study/cohort.csv"):
            assert client.get(page, {"from": day, "until": day}).status_code == 200, page
        assert client.get("/audit/", {"since": day, "until": day}).status_code == 200
    assert not Visit.objects.exists()
    assert not patient.operations.exists()
    assert not patient.consents.exists()


# --- near duplicates ---


def new(client: Client, **changed: str) -> str:
    table = {"family_name": "Müller", "given_name": "Anna", "born": "1979-05-14", "record_number": "KIS-9", **changed}
    return client.post("/patients/new/", table).content.decode()


@pytest.mark.parametrize("number", ["kis-4711", "KIS 4711", "KIS4711", "KIS-4711"])
def test_a_record_number_is_taken_whatever_its_case_and_hyphens(
    clinic: ClinicConfig, client_of: Callable[..., Client], number: str
) -> None:
    known = entered("Andere", born=None)
    page = new(client_of(Role.TECHNICIAN), record_number=number, anyway="1")
    assert f"/patients/{known.pk}/" in page
    assert 'name="anyway"' not in page  # two records cannot have one number
    assert Patient.objects.count() == 1


@pytest.mark.parametrize(
    ("names", "asked"),
    [
        ({"family_name": "MULLER"}, True),
        ({"family_name": "Mueller", "given_name": "anna"}, True),
        ({"family_name": "Anna", "given_name": "Müller"}, True),
        ({"born": ""}, True),
        ({"born": "1979-05-15"}, False),
        ({"given_name": "Hanna"}, False),
    ],
)
def test_the_same_name_and_birthday_is_shown_and_one_may_go_on(
    clinic: ClinicConfig, client_of: Callable[..., Client], names: dict[str, str], asked: bool
) -> None:
    known = entered("Müller")
    client = client_of(Role.TECHNICIAN)
    page = new(client, **names)
    assert (f"/patients/{known.pk}/" in page) == asked
    assert Patient.objects.count() == (1 if asked else 2)
    if asked:
        assert 'name="anyway"' in page
        new(client, **names, anyway="1")
        assert Patient.objects.count() == 2


def test_an_entry_can_be_changed_without_being_asked_again(
    clinic: ClinicConfig, client_of: Callable[..., Client]
) -> None:
    entered("Müller")
    twin = entered("Müller", number="KIS-2")
    client, address = client_of(Role.TECHNICIAN), f"/patients/{twin.pk}/edit/"
    answer = client.post(address, filled(client, address, note="left-handed"))
    assert answer.status_code == 302
    assert timezone.now() > twin.created
