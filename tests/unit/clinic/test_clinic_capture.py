"""The clinic's capture page: live pictures, one firing, the visit's photographs and its job. On a virtual rig."""

import hashlib
import json
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from auditlog.models import LogEntry
from django.test import Client
from pytest_django import Settings
from tests.made_once import made_once
from tests.unit.capture.virtual_capture import make_pictures, rig_file

from mammometry.capture.sessions import definition_of, read_rig_file
from mammometry.clinic import cameras
from mammometry.clinic.config import ClinicConfig
from mammometry.clinic.models import Calibration, Job, Upload, Visit
from mammometry.clinic.rig_history import new_calibration
from mammometry.clinic.roles import Role

CAMERAS = 8


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = made_once(tmp_path_factory, "capture", lambda folder: make_pictures(folder / "calibrated"))
    return folder


@pytest.fixture
def before_rig(visit: Visit, made: Path, settings: Settings) -> Iterator[Callable[..., Visit]]:
    """A visit before a rig that this computer drives; with the faults that are asked for."""
    clinic: ClinicConfig = settings.CLINIC
    place = clinic.folder / "cameras"
    shutil.copytree(made / "calibrated", place / "calibrated")
    settings.CLINIC = clinic.model_copy(update={"cameras": {visit.rig.name: "cameras/rig.toml"}})

    def make(faults: str = "") -> Visit:
        visit.rig.definition = definition_of(read_rig_file(rig_file(place, faults=faults)))
        visit.rig.save()
        calibration: Calibration = new_calibration(visit.rig, None)
        calibration.state, calibration.current, calibration.figures = "done", True, {"verdict": "pass"}
        calibration.save()
        shutil.copy(place / "calibrated/cameras.json", clinic.folder / calibration.folder / "cameras.json")
        visit.calibration, visit.subject_kind = calibration, "model"
        visit.save()
        return visit

    yield make
    cameras.close_idle()
    shutil.rmtree(place)


def asked(client: Client, visit: Visit, what: str, body: object = None) -> dict:
    where = f"/visits/{visit.pk}/capture/{what}"
    answer = client.get(where) if body is None else client.post(where, json.dumps(body), "application/json")
    return {"status": answer.status_code, **answer.json()}


@pytest.mark.slow
def test_a_technician_aims_fires_and_measures(
    before_rig: Callable[..., Visit], client_of: Callable[..., Client]
) -> None:
    visit, client = before_rig(), client_of(Role.TECHNICIAN)
    assert f"/visits/{visit.pk}/capture/" in client.get(f"/visits/{visit.pk}/").content.decode()
    assert "mm-capture" in client.get(f"/visits/{visit.pk}/capture/").content.decode()
    state = asked(client, visit, "state")
    assert len(state["cameras"]) == CAMERAS
    assert state["calibrated"]
    seen = asked(client, visit, "look", {"calibrating": False})["cameras"]
    assert all(one["is_whole"] and one["picture"] for one in seen.values())

    begun = time.process_time()
    fired = asked(client, visit, "fire", {})
    assert time.process_time() - begun < 10  # eight small pictures; the wall clock is others' too
    assert fired["accepted"], fired["said"]
    visit.refresh_from_db()
    assert visit.state == Visit.State.READY
    rows = Upload.objects.filter(visit=visit)
    assert rows.count() == CAMERAS
    assert {row.created_by.username for row in rows} == {"technician"}
    for row in rows:
        assert (visit.folder / row.name).stat().st_size == row.size_bytes
        assert client.get(f"/uploads/{row.pk}/thumbnail/").status_code == 200
    told = client.get(f"/visits/{visit.pk}/uploads/").json()
    assert (told["ready"], told["missing"]) == (True, [])
    assert client.post(f"/visits/{visit.pk}/measure/", "{}", "application/json").status_code == 202
    assert Job.objects.get().visit == visit
    assert "measured" in asked(client, visit, "fire", {})["error"]

    pages = [(entry.additional_data or {}).get("page") for entry in LogEntry.objects.filter(action=3)]
    assert {"visit-capture", "visit-fire"} <= set(pages)
    assert "visit-look" not in pages  # five a second


@pytest.mark.slow
def test_a_refused_firing_leaves_the_visit_without_photographs(
    before_rig: Callable[..., Visit], client_of: Callable[..., Client]
) -> None:
    visit, client = before_rig('left_left = "unplugged"'), client_of(Role.CLINICIAN)
    assert "left_left" in asked(client, visit, "state")["faults"]
    fired = asked(client, visit, "fire", {})
    assert not fired["accepted"]
    assert any("left_left" in sentence and "cable" in sentence for sentence in fired["said"])
    assert not Upload.objects.exists()
    assert len(list((visit.folder / "shots/001").glob("*.jpg"))) == CAMERAS - 1  # kept all the same


@pytest.mark.slow
def test_firing_again_replaces_and_never_what_was_sent(
    before_rig: Callable[..., Visit], client_of: Callable[..., Client]
) -> None:
    visit, client = before_rig(), client_of(Role.TECHNICIAN)
    assert asked(client, visit, "fire", {})["accepted"]
    first = {row.pk: row.sha256 for row in Upload.objects.all()}
    assert asked(client, visit, "fire", {})["accepted"]
    aside = Upload.objects.filter(state=Upload.State.SET_ASIDE)
    assert {row.pk: row.sha256 for row in aside} == first
    assert all(hashlib.sha256((visit.folder / row.name).read_bytes()).hexdigest() == row.sha256 for row in aside)
    assert Upload.objects.exclude(state=Upload.State.SET_ASIDE).count() == CAMERAS
    sent = next((visit.folder / "capture").iterdir())
    sent.unlink()
    sent.write_bytes(b"another")
    answer = asked(client, visit, "fire", {})
    assert answer["status"] == 409
    assert "aside" in answer["error"]
    assert sent.read_bytes() == b"another"


def test_cameras_are_let_go_and_opened_again(
    before_rig: Callable[..., Visit], client_of: Callable[..., Client]
) -> None:
    visit = before_rig()
    first = cameras.service_of(visit.rig, visit.calibration)
    assert cameras.service_of(visit.rig, visit.calibration) is first
    assert cameras.close_idle(idle_s=60) == 1
    assert cameras.close_idle() == 0
    assert cameras.service_of(visit.rig, visit.calibration) is not first


def test_a_rig_that_is_driven_elsewhere_or_by_a_wrong_file_is_said(
    before_rig: Callable[..., Visit], client_of: Callable[..., Client], settings: Settings
) -> None:
    visit, client = before_rig(), client_of(Role.TECHNICIAN)
    visit.rig.definition = {**visit.rig.definition, "rig": {"name": "other", "pairs": []}}
    visit.rig.save()
    assert "pairs" in asked(client, visit, "state")["error"]
    settings.CLINIC = settings.CLINIC.model_copy(update={"cameras": {}})
    assert "upload" in asked(client, visit, "state")["error"]
    assert "mm-capture" not in client.get(f"/visits/{visit.pk}/capture/").content.decode()
