"""Visits with photographs by one telephone and a printed board: what comes in, what is refused, what is kept."""

import io
import json
import re
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
from django.http import HttpResponse
from django.test import Client
from django.urls import reverse
from django.utils import timezone
from pypdf import PdfReader
from tests.clinic_forms import filled as filled_form
from tests.telephone_pictures import SIZE_WH, picture, write_prepared
from tests.unit.clinic.test_clinic_uploads import Sender, levels
from tests.unit.io.test_heic import COLOURS

from mammometry.api.photos import read_walk
from mammometry.base.errors import CalibrationError
from mammometry.clinic.config import ClinicConfig
from mammometry.clinic.intake import walks
from mammometry.clinic.jobs import queue, runner, work
from mammometry.clinic.maintenance import patient as records
from mammometry.clinic.models import Consent, Job, Patient, Rig, Upload, Visit, Walk
from mammometry.clinic.records.cohort import study_rows
from mammometry.clinic.roles import Role
from mammometry.walk.inputs import LeftOut, PictureFacts

FEWEST = 12  # photographs of a walk
FACTS = asdict(PictureFacts(stored_wh=SIZE_WH))
IMAGE = {"blur_px": 0.8, "square_px": 42.0}
ANSWER: dict[str, Any] = {
    "digest": "d", "made_at": "2026-11-29T12:00:00+00:00", "software": "1", "curves": {}, "how": {}, "quantities": [],
    "volumes": [{"side": "left", "definition": "measured wall", "volume_cc": 300.0, "low_cc": 280.0, "high_cc": 320.0,
                 "refused": ""}],
}  # fmt: skip


@pytest.fixture
def patient(clinic: ClinicConfig) -> Patient:
    return Patient.objects.create(
        family_name="Zypernkatze", given_name="Quirina", record_number="KIS-4711", born="1980-02-29"
    )


@pytest.fixture
def walk_visit(patient: Patient) -> Visit:
    visit = Visit.objects.create(patient=patient, taken_at=timezone.now(), posture=Visit.Posture.STANDING)
    Walk.objects.create(visit=visit)
    return visit


@pytest.fixture
def sender(client_of: Callable[..., Client], walk_visit: Visit) -> Sender:
    return Sender(client_of(Role.TECHNICIAN), walk_visit)


def start(client: Client, patient: Patient, **changed: str) -> HttpResponse:
    told = {"patient": str(patient.pk), "taken_at": f"{timezone.localtime():%Y-%m-%dT%H:%M}", "posture": "standing"}
    return client.post(reverse("walk-new"), told | changed, follow=True)  # type: ignore[return-value]


def filled(visit: Visit, number: int = FEWEST, *, board: bool = True) -> list[Upload]:
    """Photographs of a walk that have arrived, as rows and files."""
    rows = []
    for index in range(number):
        about = {"check": "format", "level": "ok", "sentence": "", "ok": True, "file": f"IMG_{index:04d}.HEIC"}
        row = Upload.objects.create(
            visit=visit, camera="telephone", size_bytes=3, sha256=f"{index}".zfill(64), state=Upload.State.PLACED,
            checks=[{**about, "taken_s": None, "facts": FACTS, "board": board, "image": IMAGE if board else None}],
        )  # fmt: skip
        row.path.write_bytes(picture(index))
        row.path.with_suffix(".webp").write_bytes(b"RIFF")
        rows.append(row)
    return rows


def measured_now(client: Client, visit: Visit) -> HttpResponse:
    address = reverse("visit-measure", args=[visit.pk])
    return client.post(address, "{}", content_type="application/json")  # type: ignore[return-value]


def test_a_visit_with_a_telephone_is_started_with_posture_and_board(
    client_of: Callable[..., Client], patient: Patient
) -> None:
    page = start(client_of(Role.TECHNICIAN), patient, edge_mm="263.6", edge_std_mm="0.2").content.decode()
    visit = Visit.objects.get()
    assert (visit.is_walk, visit.is_scan, visit.device, visit.posture) == (True, False, "Telephone", "standing")
    assert (visit.walk.edge_mm, visit.walk.edge_std_mm) == (263.6, 0.2)
    assert visit.created_by is not None
    assert f'data-id="{visit.pk}"' in page
    assert "± 6 %" not in page


def test_a_print_that_was_not_measured_is_stated_with_its_effect(
    client_of: Callable[..., Client], patient: Patient
) -> None:
    page = start(client_of(Role.TECHNICIAN), patient).content.decode()
    assert "264 ± 2.6 mm" in page
    assert "± 6 %" in page


@pytest.mark.slow
def test_the_board_is_drawn_for_print(client_of: Callable[..., Client], clinic: ClinicConfig) -> None:
    answer = client_of(Role.TECHNICIAN).get(reverse("walk-target"))
    # With the field for a bank card, as by `mammometry target --telephone`.
    assert "bank card" in PdfReader(io.BytesIO(answer.content)).pages[0].extract_text()


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"edge_mm": "263.6"}, "edge_std_mm"),
        ({"edge_std_mm": "0.2"}, "edge_mm"),
        ({"edge_mm": "500", "edge_std_mm": "0.2"}, "edge_mm"),
        ({"edge_mm": "26.4", "edge_std_mm": "0.2"}, "edge_mm"),
        ({"edge_mm": "nan", "edge_std_mm": "0.2"}, "edge_mm"),
        ({"edge_mm": "264", "edge_std_mm": "0"}, "edge_std_mm"),
        ({"edge_mm": "264", "edge_std_mm": "30"}, "edge_std_mm"),
        ({"posture": "flying"}, "posture"),
        ({"taken_at": ""}, "taken_at"),
        ({"taken_at": "2099-01-01T10:00"}, "taken_at"),
    ],
)
def test_a_wrong_form_names_its_field_and_starts_nothing(
    client_of: Callable[..., Client], patient: Patient, wrong: dict[str, str], field: str
) -> None:
    page = start(client_of(Role.TECHNICIAN), patient, **wrong).content.decode()
    assert re.findall(r'id="id_(\w+?)_error"', page) == [field]
    assert not Visit.objects.exists()


def test_a_form_that_is_sent_twice_starts_one_visit(client_of: Callable[..., Client], patient: Patient) -> None:
    client = client_of(Role.TECHNICIAN)
    page = client.get(reverse("walk-new"), {"patient": str(patient.pk)}).content.decode()
    token = re.findall(r'name="form_token" value="([^"]+)"', page)[-1]
    addresses = {start(client, patient, form_token=token).redirect_chain[-1][0] for _ in range(2)}  # type: ignore[attr-defined]
    assert len(addresses) == Visit.objects.count() == Walk.objects.count() == 1


def test_only_care_starts_and_sends(client_of: Callable[..., Client], patient: Patient, walk_visit: Visit) -> None:
    for role in (Role.RESEARCHER, Role.ADMINISTRATOR):
        client = client_of(role)
        assert start(client, patient).status_code == 403
        assert Sender(client, walk_visit).begin(picture(1)).status_code == 403
        for name in ("walk-board", "walk-again", "visit-measure"):
            assert client.post(reverse(name, args=[walk_visit.pk])).status_code == 403
    assert Visit.objects.count() == 1
    assert not Upload.objects.exists()


def test_each_photograph_is_checked_when_it_arrives(sender: Sender, walk_visit: Visit, clinic: ClinicConfig) -> None:
    good = sender.send(picture(1), name="IMG_0001.JPG")
    assert (good["state"], levels(good)["board"], good["file"]) == ("placed", "ok", "IMG_0001.JPG")
    without = sender.send(picture(2, board=False), name="Muster Anna.jpg")
    assert (without["state"], levels(without)["board"], without["file"]) == ("placed", "warn", None)
    state = sender.state()
    assert [each["by_hand"] for each in state["shots"]] == [False, False]
    assert state["ready"] is False
    assert sender.client.get(state["shots"][0]["thumbnail"]).status_code == 200
    assert not walk_visit.folder.exists()
    assert "Muster" not in json.dumps(list(Upload.objects.values("name", "checks")))
    walk_visit.refresh_from_db()
    assert walk_visit.state == Visit.State.UPLOADING
    assert sender.client.delete(state["shots"][1]["url"]).status_code == 204
    assert len(list((clinic.folder / "uploads").iterdir())) == 2  # the other's file and small picture


@pytest.mark.parametrize(
    "data",
    [
        picture(3)[: len(picture(3)) // 2],
        b"GIF89a" + bytes(99),
        picture(3) + b"PK\x03\x04",
        bytes(4) + b"ftypheic" + bytes(99),
        bytes(4) + b"ftypheic" + bytes(99) + b"PK\x05\x06" + bytes(20),
        b"\xff\xd8\xff" + bytes(99),
    ],
    ids=["half", "gif", "archive", "damaged heic", "heic and archive", "damaged jpeg"],
)
def test_a_file_that_is_no_whole_photograph_is_refused_and_not_kept(
    sender: Sender, clinic: ClinicConfig, data: bytes
) -> None:
    table = sender.send(data, name="IMG_0001.JPG")
    assert (table["state"], levels(table)) == ("refused", {"format": "refuse"})
    assert not list((clinic.folder / "uploads").iterdir())


def test_a_heic_that_cannot_be_read_here_is_refused_with_a_remedy(
    sender: Sender, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mammometry.base.extras import MissingLibraryError

    def missing(*_: object) -> None:
        raise MissingLibraryError("pi_heif", found="none", expected="it", remedy="Install it")

    monkeypatch.setattr(walks, "read_facts", missing)
    table = sender.send(bytes(4) + b"ftypheic" + bytes(99), name="IMG_0001.HEIC")
    assert (table["state"], levels(table)) == ("refused", {"format": "refuse"})


def test_a_heic_is_read(sender: Sender) -> None:
    table = sender.send(COLOURS.read_bytes(), name="IMG_0001.HEIC")
    assert (table["state"], levels(table)) == ("placed", {"format": "ok", "board": "warn"})
    assert sender.client.get(table["thumbnail"]).status_code == 200


def test_the_same_photograph_counts_once(sender: Sender) -> None:
    first = sender.send(picture(1))
    assert sender.begin(picture(1)).json()["id"] == first["id"]
    again = sender.send(picture(1), digest="")  # a page without encryption cannot make the digest
    assert again["state"] == "refused"
    assert [each["state"] for each in sender.state()["shots"]] == ["placed", "refused"]


@pytest.mark.slow
def test_too_few_photographs_are_not_measured(sender: Sender, walk_visit: Visit) -> None:
    rows = filled(walk_visit, FEWEST - 1)
    assert sender.state()["ready"] is False
    assert measured_now(sender.client, walk_visit).status_code == 409
    sender.send(picture(99))
    assert sender.state()["ready"] is True
    walk_visit.refresh_from_db()
    assert walk_visit.state == Visit.State.READY
    assert sender.client.delete(reverse("upload", args=[rows[0].pk])).status_code == 204
    walk_visit.refresh_from_db()
    assert walk_visit.state == Visit.State.UPLOADING


def test_photographs_without_the_board_are_not_measured(sender: Sender, walk_visit: Visit) -> None:
    filled(walk_visit, 20, board=False)
    assert sender.state()["ready"] is False
    assert measured_now(sender.client, walk_visit).status_code == 409


@pytest.mark.slow
def test_a_photograph_of_another_size_is_marked_and_too_many_of_them_are_not_measured(
    sender: Sender, walk_visit: Visit
) -> None:
    rows = filled(walk_visit)
    odd = sender.send(picture(50, size_wh=(720, 480)))
    state = sender.state()
    assert state["ready"] is True
    assert [shot["id"] for shot in state["shots"] if levels(shot).get("board") == "warn"] == [odd["id"]]
    for row in rows[:5]:
        row.checks[0]["facts"] |= {"model": "Another telephone"}
        row.save()
    for row in rows[5:]:
        row.checks[0]["facts"] |= {"model": "Telephone"}
        row.save()
    assert sender.state()["ready"] is False
    assert measured_now(sender.client, walk_visit).status_code == 409


def test_a_blurred_photograph_is_marked_beside_the_others(sender: Sender, walk_visit: Visit) -> None:
    rows = filled(walk_visit)
    rows[3].checks[0]["image"] = {"blur_px": 4.0, "square_px": 42.0}
    rows[3].save()
    marked = [shot["id"] for shot in sender.state()["shots"] if levels(shot).get("board") == "warn"]
    assert marked == [str(rows[3].pk)]


@pytest.mark.slow
def test_no_more_than_sixty(sender: Sender, walk_visit: Visit) -> None:
    filled(walk_visit, 60)
    assert sender.begin(picture(61)).status_code == 409
    assert sender.state()["ready"] is True


def test_what_belongs_to_a_rig_is_refused(sender: Sender, walk_visit: Visit) -> None:
    first = sender.send(picture(1))
    place = sender.client.post(f"{first['url']}place/", '{"camera": "front_left"}', content_type="application/json")
    assert place.status_code == 409
    assert sender.client.get(reverse("visit-capture", args=[walk_visit.pk])).status_code == 404
    for name in ("visit-state", "visit-look", "visit-fire"):
        method = sender.client.get if name == "visit-state" else sender.client.post
        assert method(reverse(name, args=[walk_visit.pk])).status_code == 409
    assert sender.client.get(reverse("upload-screen", args=[first["id"]])).status_code == 404


def test_the_order_is_that_of_the_exposures_if_all_have_a_time(walk_visit: Visit) -> None:
    rows = filled(walk_visit, 3)
    for row, taken_s in zip(rows, (30.0, 10.0, 20.0), strict=True):
        row.checks[0]["taken_s"] = taken_s
        row.save()
    assert [row.pk for row in walks.photographs_of(walk_visit)] == [rows[k].pk for k in (1, 2, 0)]


def test_without_a_time_the_order_is_that_of_the_cameras_names_then_as_they_were_sent(walk_visit: Visit) -> None:
    rows = filled(walk_visit, 3)
    for row, name in zip(rows, ("IMG_1000.HEIC", "IMG_0998.HEIC", "IMG_0999.HEIC"), strict=True):
        row.checks[0]["file"] = name
        row.save()
    assert [row.pk for row in walks.photographs_of(walk_visit)] == [rows[k].pk for k in (1, 2, 0)]
    rows[2].checks[0]["file"] = None  # not a camera's name
    rows[2].save()
    assert [row.pk for row in walks.photographs_of(walk_visit)] == [row.pk for row in rows]


def test_the_board_can_be_measured_later_until_the_walk_is_prepared(
    client_of: Callable[..., Client], walk_visit: Visit
) -> None:
    client, address = client_of(Role.TECHNICIAN), reverse("walk-board", args=[walk_visit.pk])
    page = reverse("visit", args=[walk_visit.pk])
    client.post(address, filled_form(client, page, address, edge_mm="263.6", edge_std_mm="0.2"))
    assert Walk.objects.get().edge_mm == 263.6
    bad = client.post(address, filled_form(client, page, address, edge_mm="1")).content.decode()
    assert re.findall(r'id="id_(\w+?)_error"', bad) == ["edge_mm"]
    late = filled_form(client, page, address, edge_mm="262")
    write_prepared(walk_visit.folder, left_out={}, pictures=12)
    client.post(address, late)
    assert Walk.objects.get().edge_mm == 263.6


def task_of(clinic: ClinicConfig) -> tuple[Job, list[str]]:
    """The queued job and the arguments that its process gets."""
    (job,) = queue.claim("me", 1)
    task = runner.Runner(clinic)._task(job)
    assert task.call.function is work.measure_walk
    return job, [str(argument) for argument in task.call.arguments]


def test_the_job_prepares_numbered_photographs_with_the_board_once(
    sender: Sender, walk_visit: Visit, clinic: ClinicConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    filled(walk_visit)
    Walk.objects.update(edge_mm=263.6, edge_std_mm=0.2)
    assert measured_now(sender.client, walk_visit).status_code == 202
    _, arguments = task_of(clinic)
    seen: dict[str, Any] = {}

    def prepared(folder: Path, out: Path, **given: Any) -> None:
        seen.update(files=sorted(path.name for path in folder.iterdir()), board=(folder / "board.toml").read_text())
        seen.update(posture=given["posture"], subject=given["subject"], first=(folder / "01.jpg").read_bytes())
        given["progress"](0.5)
        write_prepared(out, left_out={"02": LeftOut(code="no-board", found="no target")}, pictures=FEWEST)

    said: list[tuple[str, float]] = []
    monkeypatch.setattr(work, "prepare_walk", prepared)
    monkeypatch.setattr(work, "_measured", lambda progress, session, settings: {"digest": "d"})
    assert work.measure_walk(lambda *now: said.append(now), *arguments) == {"digest": "d"}
    assert seen["files"] == [*(f"{number:02d}.jpg" for number in range(1, FEWEST + 1)), "board.toml"]
    assert "edge_mm = 263.6" in seen["board"]
    assert (seen["posture"], seen["subject"]) == ("unknown", walk_visit.patient.pseudonym)
    assert seen["first"] == picture(0)
    assert ("board", 0.5) in said
    assert runner.whole("board", 0.5) > 0
    seen.clear()
    work.measure_walk(lambda *now: None, *arguments)  # a job that was killed after the preparation
    assert seen == {}
    assert not [path for path in (clinic.folder / "uploads").iterdir() if path.name.startswith("walk-")]


@pytest.mark.slow
@pytest.mark.requirement("R-KEEP-10")
def test_the_sent_files_are_deleted_when_the_session_is_made_and_the_page_lists_what_was_left_out(
    sender: Sender, walk_visit: Visit, clinic: ClinicConfig
) -> None:
    filled(walk_visit)
    measured_now(sender.client, walk_visit)
    job, _ = task_of(clinic)
    write_prepared(walk_visit.folder, left_out={"02": LeftOut(code="no-board", found="no target")}, pictures=FEWEST)
    assert queue.done(job.pk, "me", ANSWER)
    assert not list((clinic.folder / "uploads").iterdir())
    assert set(Upload.objects.values_list("state", flat=True)) == {"prepared"}
    page = sender.client.get(reverse("visit", args=[walk_visit.pk])).content.decode()
    assert f"{FEWEST - 1} of {FEWEST}" in page
    assert "02, IMG_0001.HEIC: no board" in page
    assert "264 ± 2.6 mm" in page
    write_prepared(walk_visit.folder, left_out={}, pictures=FEWEST, card_scale=0.99)
    assert "264 ± 2.6 mm" not in sender.client.get(reverse("visit", args=[walk_visit.pk])).content.decode()
    for change in (sender.begin(picture(7)), sender.client.delete(reverse("upload", args=[Upload.objects.first().pk]))):  # type: ignore[union-attr]
        assert change.status_code == 409
    sender.client.post(reverse("walk-again", args=[walk_visit.pk]))  # it has a result
    assert read_walk(walk_visit.folder) is not None
    assert measured_now(sender.client, walk_visit).status_code == 202  # again, from its session
    for address in (reverse("home"), reverse("patient", args=[walk_visit.patient_id]), reverse("jobs-page")):
        assert sender.client.get(address).status_code == 200


@pytest.mark.slow
def test_a_walk_without_a_session_keeps_its_files_for_another_try(
    sender: Sender, walk_visit: Visit, clinic: ClinicConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    filled(walk_visit)
    measured_now(sender.client, walk_visit)
    job, arguments = task_of(clinic)

    def refused(*_: object, **__: object) -> None:
        raise CalibrationError("the board", found="a bow", expected="none", remedy="Glue it to card")

    monkeypatch.setattr(work, "prepare_walk", refused)
    with pytest.raises(CalibrationError) as raised:
        work.measure_walk(lambda *now: None, *arguments)
    assert queue.failed(job.pk, "me", str(raised.value), 6)
    assert len(list((clinic.folder / "uploads").iterdir())) == 2 * FEWEST
    page = sender.client.get(reverse("visit", args=[walk_visit.pk])).content.decode()
    assert "Glue it to card" in page
    assert "data-uploads" in page
    assert reverse("job-retry", args=[job.pk]) not in page  # the photographs have the button
    assert sender.send(picture(70))["state"] == "placed"
    again = sender.client.post(reverse("job-retry", args=[job.pk]), "{}", content_type="application/json")
    assert again.status_code == 202


@pytest.mark.slow
def test_a_refused_walk_is_taken_again_in_the_same_visit(
    sender: Sender, walk_visit: Visit, clinic: ClinicConfig
) -> None:
    filled(walk_visit)
    measured_now(sender.client, walk_visit)
    address = reverse("walk-again", args=[walk_visit.pk])
    sender.client.post(address)  # it is being measured
    assert Upload.objects.count() == FEWEST
    job, _ = task_of(clinic)
    write_prepared(walk_visit.folder, left_out={}, pictures=FEWEST)
    assert queue.failed(job.pk, "me", "The body moved.", 7)
    assert not list((clinic.folder / "uploads").iterdir())
    page = sender.client.get(reverse("visit", args=[walk_visit.pk])).content.decode()
    assert address in page
    assert "data-uploads" not in page
    sender.client.post(address)
    walk_visit.refresh_from_db()
    assert (walk_visit.state, Upload.objects.count(), walk_visit.folder.exists()) == (Visit.State.NEW, 0, False)
    assert "The body moved." not in sender.client.get(reverse("visit", args=[walk_visit.pk])).content.decode()
    assert sender.send(picture(1))["state"] == "placed"


def test_photographs_of_another_visit_are_asked_about(
    sender: Sender, walk_visit: Visit, client_of: Callable[..., Client], clinic: ClinicConfig
) -> None:
    filled(walk_visit)
    measured_now(sender.client, walk_visit)
    job, _ = task_of(clinic)
    write_prepared(walk_visit.folder, left_out={}, pictures=FEWEST)
    assert queue.done(job.pk, "me", ANSWER)
    other = Visit.objects.create(patient=walk_visit.patient, taken_at=timezone.now())
    Walk.objects.create(visit=other)
    filled(other)
    assert [each["check"] for each in Sender(sender.client, other).state()["together"]] == ["elsewhere"]
    assert measured_now(sender.client, other).status_code == 409
    address = reverse("visit-measure", args=[other.pk])
    assert sender.client.post(address, '{"anyway": true}', content_type="application/json").status_code == 202


@pytest.mark.slow
def test_a_walk_is_in_studies_exports_and_erasure(
    sender: Sender, walk_visit: Visit, clinic: ClinicConfig, tmp_path: Path
) -> None:
    filled(walk_visit)
    measured_now(sender.client, walk_visit)
    job, _ = task_of(clinic)
    write_prepared(walk_visit.folder, left_out={}, pictures=FEWEST)
    assert queue.done(job.pk, "me", ANSWER)
    walk_visit.patient.refresh_from_db()
    Consent.objects.create(patient=walk_visit.patient, purpose="research", given_on="2026-01-01")
    assert [row.rig for row in study_rows(Visit.objects.all())] == ["Telephone"]
    assert any(isinstance(row, Walk) for row in records.rows_of(walk_visit.patient))
    records.export_patient(clinic, walk_visit.patient, tmp_path / "export.zip")
    left = clinic.folder / "uploads" / f"walk-{walk_visit.pk}"  # of a killed job
    left.mkdir()
    (left / "01.jpg").write_bytes(picture(1))
    Job.objects.update(state=Job.State.DONE)
    assert records.erase_patient(clinic, walk_visit.patient) == 1
    assert not list((clinic.folder / "uploads").iterdir())
    assert not Walk.objects.exists()


def test_a_visit_by_a_rig_stays_one(visit: Visit) -> None:
    assert (visit.is_walk, visit.is_scan, visit.device) == (False, False, Rig.objects.get().name)
