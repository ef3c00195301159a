"""Corrections: each with its reason, undone within 30 days, and nothing of the bin on any page."""

import datetime
import json
from collections.abc import Callable
from pathlib import Path

import pytest
from auditlog.models import LogEntry
from django.test import Client
from django.urls import reverse
from django.utils import timezone
from tests.clinic_forms import filled
from tests.clinic_seed import DEFINITION

from mammometry.base.errors import SessionError
from mammometry.clinic.config import ClinicConfig
from mammometry.clinic.intake.uploads import ready_folder
from mammometry.clinic.jobs import queue
from mammometry.clinic.maintenance.patient import erase_bin, erase_patient, find_patient, rows_of
from mammometry.clinic.models import (
    Calibration,
    Comparison,
    Consent,
    Correction,
    Delivery,
    Destination,
    Job,
    Measurement,
    Operation,
    Patient,
    Rig,
    Upload,
    Visit,
    VisitOrder,
    Volume,
)
from mammometry.clinic.records import corrections
from mammometry.clinic.records.cohort import study_rows, visits_between
from mammometry.clinic.records.corrections import CorrectionError
from mammometry.clinic.records.search import search
from mammometry.clinic.roles import Role
from mammometry.io.session import Session

NOON = datetime.datetime(2026, 3, 1, 12, tzinfo=datetime.UTC)


@pytest.fixture
def rig(clinic: ClinicConfig) -> Rig:
    rig = Rig.objects.create(name="Room 1", definition=DEFINITION)
    Calibration.objects.create(
        rig=rig, taken_at=NOON - datetime.timedelta(days=9), folder="c", state="done", current=True
    )
    return rig


@pytest.fixture
def anna(clinic: ClinicConfig) -> Patient:
    return Patient.objects.create(
        family_name="Zypernkatze", given_name="Anna", record_number="KIS-1", born="1980-02-29", note="left-handed"
    )


@pytest.fixture
def berta(clinic: ClinicConfig) -> Patient:
    return Patient.objects.create(family_name="Quitte", given_name="Berta", record_number="KIS-2", note="asthma")


def measured(patient: Patient, rig: Rig, days: int = 0) -> Visit:
    """A measured visit whose session folder names the patient in all files that do."""
    visit = Visit.objects.create(
        patient=patient, rig=rig, calibration=rig.calibrations.get(), taken_at=NOON + datetime.timedelta(days=days),
        state="measured", note="Zypernkatze called",
    )  # fmt: skip
    for camera in ("front_left", "front_right"):
        Upload.objects.create(
            visit=visit, camera=camera, name=f"capture/{camera}.jpg", size_bytes=1, state="placed",
            sha256=f"{camera}{visit.pk.hex}"[:64],
        )  # fmt: skip
    measurement = Measurement.objects.create(visit=visit, digest=visit.pk.hex, made_at=timezone.now(), software="1")
    Volume.objects.create(measurement=measurement, side="left", definition="named wall", leads=True, volume_cc=400.0)
    ready_folder(visit)
    folder = visit.folder
    (folder / "results/measure").mkdir(parents=True)
    record = {"products": {"measure": {"subject": patient.pseudonym}}}
    (folder / "results/measure/provenance.json").write_text(json.dumps(record))
    (folder / "results/report").mkdir()
    (folder / "results/report/report.html").write_text(f"Report of {patient.pseudonym}")
    drawn = {"subject": patient.pseudonym, "boundaries": {"left": [[0, 0, 0]]}}
    (folder / "history").mkdir()
    for path in (folder / "boundaries.json", folder / "history/1.json"):
        path.write_text(json.dumps(drawn))
    return visit


def names_nobody_else(visit: Visit) -> None:
    """Fail where a file of the visit's folder names another subject than its patient, as a session is opened."""
    assert Session.open(visit.folder).manifest.subject.id == visit.patient.pseudonym
    others = set(Patient.everything.values_list("pseudonym", flat=True)) - {visit.patient.pseudonym}
    for path in visit.folder.rglob("*"):
        if path.is_file():
            assert not [name for name in others if name in path.read_text()], path


# --- moving ---


@pytest.mark.requirement("R-KEEP-3")
def test_a_moved_visit_carries_the_right_pseudonym_everywhere_and_is_measured_again(
    anna: Patient, berta: Patient, rig: Rig
) -> None:
    visit, other = measured(anna, rig), measured(anna, rig, 30)
    VisitOrder.objects.create(visit=visit, accession="A-1", referring="Dr. Who")
    Comparison.objects.create(before=visit, after=other)
    kept = other.folder / "results/compare" / str(visit.pk)
    kept.mkdir(parents=True)
    digest = visit.measurements.get().digest
    # As it was: the row alone was changed, and the session could not be opened any more.
    Visit.objects.filter(pk=visit.pk).update(patient=berta)
    ready_folder(Visit.objects.get(pk=visit.pk))
    with pytest.raises(SessionError):
        Session.open(visit.folder)
    Visit.objects.filter(pk=visit.pk).update(patient=anna)
    ready_folder(Visit.objects.get(pk=visit.pk))

    done = corrections.move(Visit.objects.get(pk=visit.pk), berta, "taken for the next one", None)
    visit.refresh_from_db()
    assert visit.patient == berta
    assert visit.state == Visit.State.QUEUED
    assert visit.measurements.get().digest == digest  # the numbers are of the same photographs
    names_nobody_else(visit)
    assert not VisitOrder.objects.exists()  # the order is of the former patient
    assert not Comparison.objects.exists()
    assert not kept.exists()
    assert done.patient == anna

    Job.objects.all().delete()
    corrections.undo(done, None)
    visit.refresh_from_db()
    assert visit.patient == anna
    names_nobody_else(visit)
    assert VisitOrder.objects.get().referring == "Dr. Who"
    with pytest.raises(CorrectionError, match="undone"):
        corrections.undo(done, None)


def test_what_is_being_measured_is_not_corrected(anna: Patient, berta: Patient, rig: Rig) -> None:
    visit = measured(anna, rig)
    Job.objects.create(visit=visit, kind="measure", state="running")
    for act in (
        lambda: corrections.move(visit, berta, "x", None),
        lambda: corrections.redate(visit, NOON, "", "x", None),
        lambda: corrections.put_into_bin(visit, "x", None),
        lambda: corrections.merge(berta, anna, berta, "x", None),
    ):
        with pytest.raises(CorrectionError, match="measured"):
            act()
    assert not Correction.objects.exists()


def test_a_later_correction_is_undone_first(anna: Patient, berta: Patient, rig: Rig) -> None:
    visit = measured(anna, rig)
    clara = Patient.objects.create(family_name="C", given_name="C", record_number="KIS-3")
    first = corrections.move(visit, berta, "x", None)
    Job.objects.all().delete()
    second = corrections.move(visit, clara, "y", None)
    Job.objects.all().delete()
    with pytest.raises(CorrectionError, match="later"):
        corrections.undo(first, None)
    corrections.undo(second, None)
    Job.objects.all().delete()
    corrections.undo(first, None)
    assert Visit.objects.get().patient == anna


def test_a_corrected_day_stands_in_the_session_and_the_numbers_stay(anna: Patient, rig: Rig) -> None:
    visit = measured(anna, rig)
    products = visit.folder / "results/measure/provenance.json"
    day_before = NOON - datetime.timedelta(days=1)
    done = corrections.redate(visit, day_before, "other note", "a slip", None)
    assert Session.open(visit.folder).manifest.date == day_before.date()
    assert products.is_file()
    assert not (visit.folder / "results/report").exists()
    visit.refresh_from_db()
    assert (visit.taken_at, visit.note, visit.state) == (day_before, "other note", "queued")
    Job.objects.all().delete()
    corrections.undo(done, None)
    visit.refresh_from_db()
    assert (visit.taken_at, visit.note) == (NOON, "Zypernkatze called")
    Job.objects.all().delete()
    with pytest.raises(CorrectionError, match=r"^Day, "):
        corrections.redate(visit, NOON, visit.note, "x", None)


# --- merging ---


@pytest.mark.parametrize("stays", ["kept", "other"])
def test_two_records_become_one_and_two_again(
    anna: Patient, berta: Patient, rig: Rig, client_of: Callable[..., Client], stays: str
) -> None:
    visit = measured(berta, rig)
    binned = measured(berta, rig, 1)
    corrections.put_into_bin(binned, "blurred", None)
    Operation.objects.create(patient=berta, kind="flap", side="left", day="2026-01-01")
    Consent.objects.create(patient=berta, purpose="research", given_on="2026-01-01")
    done = corrections.merge(anna, berta, anna if stays == "kept" else berta, "one person", None)
    anna.refresh_from_db()
    assert anna.record_number == ("KIS-1" if stays == "kept" else "KIS-2")
    assert anna.note == "left-handed\nasthma"
    assert (anna.visits.count(), anna.operations.count(), anna.consents.count()) == (1, 1, 1)
    visit.refresh_from_db()
    names_nobody_else(visit)
    assert list(Patient.objects.all()) == [anna]
    for query in ("KIS-1", "KIS-2", "quitte", berta.pseudonym):
        assert list(search(query)) == [anna], query
    client = client_of(*Role)
    for name in ("patient", "patient-edit", "compare"):
        answer = client.get(reverse(name, args=[berta.pk]))
        assert answer.headers["Location"] == reverse(name, args=[anna.pk])
    assert find_patient(berta.pseudonym) == anna
    assert {row.pk for row in rows_of(anna)} >= {anna.pk, berta.pk, visit.pk, binned.pk}

    Job.objects.all().delete()
    corrections.undo(done, None)
    for row, number, note in ((anna, "KIS-1", "left-handed"), (berta, "KIS-2", "asthma")):
        row.refresh_from_db()
        assert (row.record_number, row.note, row.merged_into) == (number, note, None)
        assert list(search(number)) == [row]
    assert (berta.visits.count(), berta.operations.count(), berta.consents.count()) == (1, 1, 1)
    assert Visit.everything.filter(patient=berta).count() == 2


def test_erasing_a_patient_erases_what_was_merged_into_it(
    clinic: ClinicConfig, anna: Patient, berta: Patient, rig: Rig
) -> None:
    measured(berta, rig)
    corrections.merge(anna, berta, anna, "one person", None)
    erase_patient(clinic, anna)
    assert not Patient.everything.exists()
    assert not Visit.everything.exists()


# --- the bin ---


def pages_of(visit: Visit) -> list[str]:
    keys = {"visit": visit.pk}
    names = ("visit", "report", "report-pdf", "visit-send", "visit-dicom", "scene", "draw", "visit-uploads")
    return [reverse(name, kwargs=keys) for name in names] + [reverse("visit-fhir", args=[visit.pk, "r4"])]


@pytest.mark.slow
def test_what_is_in_the_bin_is_nowhere_else(
    anna: Patient, rig: Rig, client_of: Callable[..., Client], person_of: Callable[..., object]
) -> None:
    visit, other = measured(anna, rig), measured(anna, rig, 30)
    upload = visit.uploads.first()
    archive = Destination.objects.create(name="PACS", address="A@h:1")
    delivery = Delivery.objects.create(visit=visit, destination=archive, state="failed")
    job = Job.objects.create(visit=visit, kind="measure", state="done", ended=timezone.now())
    Consent.objects.create(patient=anna, purpose="research", given_on="2026-01-01")
    client = client_of(*Role)
    shown = client.get("/patients/").content.decode()
    assert "2 visits" in shown
    assert len(list(study_rows(visits_between(None, None, confirmed=False)))) == 2
    done = corrections.put_into_bin(visit, "of a dummy", None)

    everywhere = "".join(
        client.get(path).content.decode()
        for path in (
            "/",
            "/patients/",
            f"/patients/{anna.pk}/",
            f"/patients/{anna.pk}/compare/",
            "/jobs/page/",
            "/study/",
        )
    )
    assert str(visit.pk) not in everywhere
    for path in ("/jobs/", "/jobs/page/"):
        assert str(job.pk) not in client.get(path).content.decode()
        assert str(visit.pk) not in client.get(path).content.decode()
    assert "1 visit," in client.get("/patients/").content.decode()
    assert [row.day.isoformat() for row in study_rows(visits_between(None, None, confirmed=False))] == [
        other.taken_at.date().isoformat()
    ]
    assert not search("1 March 2026").exists()
    for path in pages_of(visit):
        assert client.get(path).status_code == 404, path
    assert upload is not None
    for path in (f"/uploads/{upload.pk}/", f"/uploads/{upload.pk}/thumbnail/", f"/jobs/{job.pk}/"):
        assert client.get(path).status_code == 404, path
    client.post(reverse("delivery-retry", args=[delivery.pk]))
    delivery.refresh_from_db()
    assert delivery.state == "failed"
    queue.enqueue(delivery, None)
    assert queue.claim(queue.new_owner(), 1, [Job.Kind.SEND]) == []

    corrections.undo(done, None)
    assert client.get(pages_of(visit)[0]).status_code == 200


def test_a_record_with_visits_stays_out_of_the_bin(anna: Patient, rig: Rig) -> None:
    visit = measured(anna, rig)
    with pytest.raises(CorrectionError, match="visits"):
        corrections.put_into_bin(anna, "x", None)
    of_visit = corrections.put_into_bin(visit, "x", None)
    of_patient = corrections.put_into_bin(anna, "x", None)
    assert not search("KIS-1").exists()
    with pytest.raises(CorrectionError, match="bin"):
        corrections.undo(of_visit, None)
    corrections.undo(of_patient, None)
    corrections.undo(of_visit, None)
    assert list(search("KIS-1")) == [anna]


def test_after_30_days_nothing_is_undone_and_the_administrator_erases(
    anna: Patient, rig: Rig, client_of: Callable[..., Client]
) -> None:
    visit, other = measured(anna, rig), measured(anna, rig, 30)
    done = corrections.put_into_bin(visit, "x", None)
    administrator, technician = client_of(Role.ADMINISTRATOR), client_of(Role.TECHNICIAN)
    assert str(done.pk) in technician.get("/corrections/").content.decode()
    assert anna.pseudonym not in administrator.get("/corrections/").content.decode()
    old = timezone.now() - datetime.timedelta(days=31)
    Correction.objects.update(at=old)
    Visit.everything.filter(pk=visit.pk).update(binned_at=old)
    with pytest.raises(CorrectionError, match="30 days"):
        corrections.undo(done, None)
    assert str(done.pk) not in technician.get("/corrections/").content.decode()
    page = administrator.get("/corrections/").content.decode()
    assert f"{anna.pseudonym} --bin" in page
    assert "Zypernkatze" not in page
    assert visit.folder.exists()
    assert erase_bin(anna) == 1
    assert list(Visit.everything.all()) == [other]
    assert not visit.folder.exists()
    assert other.folder.exists()


# --- pages ---


@pytest.mark.slow
def test_every_correction_has_a_page_a_reason_and_an_undo(
    anna: Patient, berta: Patient, rig: Rig, client_of: Callable[..., Client]
) -> None:
    visit, empty = measured(anna, rig), Visit.objects.create(patient=anna, rig=rig, taken_at=NOON)
    client = client_of(Role.TECHNICIAN)
    found = client.get(f"/visits/{visit.pk}/move/?q=QUITTE").content.decode()
    assert f"?patient={berta.pk}" in found
    assert f"?patient={anna.pk}" not in client.get(f"/visits/{visit.pk}/move/?q=KIS").content.decode()
    acts = [
        (f"/visits/{visit.pk}/move/", {"patient": str(berta.pk)}),
        (f"/visits/{empty.pk}/date/", {"taken_at": "2026-03-02T10:00", "note": "n"}),
        (f"/visits/{empty.pk}/bin/", {}),
        (f"/patients/{berta.pk}/merge/", {"patient": str(anna.pk), "number": str(anna.pk)}),
    ]
    for path, sent in acts:
        before = Correction.objects.count()
        page = client.get(path, {"patient": sent["patient"]} if "patient" in sent else {}).content.decode()
        assert "Reason" in page, path
        shown = f"{path}?patient={sent['patient']}" if "patient" in sent else path
        client.post(path, filled(client, shown, **sent))
        assert Correction.objects.count() == before, path  # a reason is needed
        filled_in = filled(client, shown, **sent, reason="Zypernkatze said so")
        assert client.post(path, filled_in).status_code == 302, path
        assert Correction.objects.count() == before + 1, path
        Job.objects.all().delete()
    assert set(Correction.objects.values_list("kind", flat=True)) == {"moved", "dated", "binned", "merged"}
    page = client.get("/corrections/").content.decode()
    assert page.count("correction-undo") == 0
    for row in Correction.objects.all():  # the newest first
        assert f"/corrections/{row.pk}/undo/" in page
        client.post(f"/corrections/{row.pk}/undo/")
        Job.objects.all().delete()
    assert not Correction.objects.filter(undone_at=None).exists()
    assert Visit.objects.filter(patient=anna).count() == 2
    entries = LogEntry.objects.exclude(changes=None)
    told = json.dumps([(row.changes, row.additional_data, row.object_repr) for row in entries])
    for secret in ("Zypernkatze", "Quitte", "KIS-1", "asthma"):
        assert secret not in told, secret


def test_a_day_in_the_future_is_asked_about_in_a_correction_too(
    anna: Patient, rig: Rig, client_of: Callable[..., Client]
) -> None:
    visit = Visit.objects.create(patient=anna, rig=rig, taken_at=NOON)
    client = client_of(Role.TECHNICIAN)
    tomorrow = f"{timezone.localtime() + datetime.timedelta(days=1):%Y-%m-%dT%H:%M}"
    sent = filled(client, f"/visits/{visit.pk}/date/", taken_at=tomorrow, reason="x")
    assert client.post(f"/visits/{visit.pk}/date/", sent).context["form"].errors
    assert client.post(f"/visits/{visit.pk}/date/", {**sent, "anyway": "1"}).status_code == 302


def test_researchers_and_administrators_correct_nothing(
    anna: Patient, rig: Rig, client_of: Callable[..., Client]
) -> None:
    visit = Visit.objects.create(patient=anna, rig=rig, taken_at=NOON)
    for role in (Role.RESEARCHER, Role.ADMINISTRATOR):
        for path in (f"/visits/{visit.pk}/move/", f"/visits/{visit.pk}/bin/", f"/patients/{anna.pk}/merge/"):
            assert client_of(role).get(path).status_code == 403, path


def test_a_backup_holds_the_bin_and_merged_records(tmp_path: Path, anna: Patient, berta: Patient, rig: Rig) -> None:
    from io import BytesIO

    from mammometry.clinic.maintenance.rows import write_database

    visit = measured(anna, rig)
    corrections.put_into_bin(visit, "x", None)
    corrections.merge(anna, berta, anna, "x", None)
    file = BytesIO()
    write_database(file)
    rows = [json.loads(line) for line in file.getvalue().splitlines()]
    assert {str(anna.pk), str(berta.pk), str(visit.pk)} <= {row["pk"] for row in rows}
    words = {row["fields"]["search_words"] for row in rows if row["model"] == "clinic.patient"}
    assert all(words)
