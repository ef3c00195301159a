"""A confirmation is about one measured result: what takes it away, what does not, and who may still confirm."""

import csv
import errno
import io
import json
import logging
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from django.test import Client
from django.urls import reverse
from django.utils import timezone

from mammometry.base.errors import StorageError
from mammometry.clinic.config import ClinicConfig
from mammometry.clinic.jobs import queue
from mammometry.clinic.models import Confirmation, Consent, Drawing, Job, Measurement, Visit
from mammometry.clinic.records import confirmations
from mammometry.clinic.roles import Role
from mammometry.clinic.site import the_clinic
from mammometry.clinic.views import hospital, results
from mammometry.clinic.views import study as exports
from mammometry.editor.messages import Save
from mammometry.io.drawn_changes import ItemChange, change_drawn, drawn_entries, drawn_entry, entry_digest
from mammometry.io.write import disk_errors

LEFT, RIGHT = "a" * 64, "b" * 64
BOTH = {"left": LEFT, "right": RIGHT}


def answer(digest: str = "d", **curves: str) -> dict[str, Any]:
    row = {"side": "left", "definition": "flat chest", "low_cc": 390.0, "high_cc": 420.0, "refused": ""}
    return {
        "digest": digest * 64,
        "made_at": timezone.now().isoformat(),
        "software": "0",
        "volumes": [{**row, "volume_cc": 407.4}],
        "curves": curves or BOTH,
        "quantities": [],
    }


def measure(visit: Visit, *, digest: str = "d", **curves: str) -> None:
    """Queue a visit, and enter what its job came to."""
    queue.enqueue(visit, None)
    owner = queue.new_owner()
    for job in queue.claim(owner, 5):
        assert queue.done(job.pk, owner, answer(digest, **curves))
    visit.refresh_from_db()


@pytest.fixture
def measured(visit: Visit) -> Visit:
    visit.folder.mkdir()
    Consent.objects.create(patient=visit.patient, purpose="research", given_on="2026-01-01")
    measure(visit)
    assert visit.state == Visit.State.MEASURED
    return visit


def draw(visit: Visit, name: str = "sternal_notch") -> None:
    """Draw a landmark as the page does: the file, then the entry."""
    entry = drawn_entry(np.array([[1.0, 2.0, 3.0]]), method="picked by hand", author="A. Nurse")
    change_drawn(visit.folder, "torso", {("landmarks", name): ItemChange(entry=entry, base=None)})
    Drawing.objects.create(visit=visit, item=f"landmark {name}", action="drawn")


def body(visit: Visit, curves: dict[str, str] | None = None, **base: dict[str, str | None]) -> dict[str, Any]:
    """What the page sends that shows what stands in the session now."""
    shown: dict[str, dict[str, str | None]] = {"boundaries": {"left": None, "right": None}, "landmarks": {}}
    for (group, name), entry in drawn_entries(visit.folder, "torso").items():
        shown[group][name] = entry_digest(entry)
    return {"curves": BOTH if curves is None else curves, "base": {**shown, **base}}


def finish(client: Client, visit: Visit, message: dict[str, Any] | None = None) -> Any:
    sent = json.dumps(body(visit) if message is None else message)
    return client.post(reverse("draw-finish", args=[visit.pk]), sent, content_type="application/json")


def test_one_step_confirms_everything_and_offers_conclusion_and_next_visit(
    client_of: Callable[..., Client], measured: Visit
) -> None:
    other = Visit.objects.create(patient=measured.patient, rig=measured.rig, taken_at=timezone.now(), state="measured")
    client = client_of(Role.CLINICIAN)
    here = {"next": reverse("visit", args=[measured.pk])}
    assert finish(client, measured).json() == here
    page = client.get(here["next"]).content.decode()
    assert 'href="#conclusion"' in page
    assert f'href="{reverse("draw", args=[other.pk])}"' in page
    measured.refresh_from_db()
    assert measured.state == Visit.State.CONFIRMED
    confirmation = Confirmation.objects.get()
    assert (confirmation.curves, str(confirmation.by)) == (BOTH, "clinician")
    items = set(measured.drawings.filter(action="confirmed").values_list("item", "digest"))
    assert items == {("boundary left", LEFT), ("boundary right", RIGHT), ("landmarks", "")}
    Visit.objects.filter(pk=other.pk).update(state="confirmed")
    assert finish(client, measured).json() == here  # pressed twice
    assert reverse("draw", args=[other.pk]) not in client.get(here["next"]).content.decode()
    assert Confirmation.objects.count() == 1


@pytest.mark.parametrize("role", [Role.TECHNICIAN, Role.RESEARCHER, Role.ADMINISTRATOR])
def test_only_a_clinician_confirms(client_of: Callable[..., Client], measured: Visit, role: Role) -> None:
    assert finish(client_of(role), measured).status_code == 403
    assert not Confirmation.objects.exists()


@pytest.mark.parametrize("curves", [{}, {"left": LEFT}, {"left": RIGHT, "right": LEFT}])
@pytest.mark.requirement("R-WHO-6")
def test_only_the_measured_boundaries_can_be_confirmed(
    client_of: Callable[..., Client], measured: Visit, curves: dict[str, str]
) -> None:
    refused = finish(client_of(Role.CLINICIAN), measured, body(measured, curves))
    assert refused.status_code == 409
    assert "measured" in refused.json()["error"]
    assert not Confirmation.objects.exists()


def test_what_a_colleague_changed_meanwhile_is_not_confirmed(client_of: Callable[..., Client], measured: Visit) -> None:
    client, seen = client_of(Role.CLINICIAN), body(measured)
    draw(measured)
    Visit.objects.filter(pk=measured.pk).update(state="changed")
    waiting = finish(client, measured, seen).json()["error"]
    measure(measured)  # the same boundaries: the landmark alone differs from what the page shows
    stale = finish(client, measured, seen)
    assert stale.status_code == 409
    assert stale.json()["error"] != waiting
    assert finish(client, measured).status_code == 200


@pytest.mark.parametrize("state", ["queued", "refused", "ready"])
def test_a_visit_that_is_not_measured_cannot_be_confirmed(
    client_of: Callable[..., Client], measured: Visit, state: str
) -> None:
    Visit.objects.filter(pk=measured.pk).update(state=state)
    assert "measured" in finish(client_of(Role.CLINICIAN), measured).json()["error"]
    assert not Confirmation.objects.exists()


def test_a_body_that_is_no_message_is_refused(client_of: Callable[..., Client], measured: Visit) -> None:
    for message in ({}, {"curves": BOTH}, {"curves": {"nose": LEFT}, "base": {"boundaries": {}, "landmarks": {}}}):
        assert finish(client_of(Role.CLINICIAN), measured, message).status_code == 422


def test_measuring_to_the_same_keeps_the_confirmation_and_to_another_does_not(
    client_of: Callable[..., Client], measured: Visit
) -> None:
    finish(client_of(Role.CLINICIAN), measured)
    measure(measured)
    assert measured.state == Visit.State.CONFIRMED
    job = queue.enqueue(measured, None)
    queue.cancel(job)
    measured.refresh_from_db()
    assert measured.state == Visit.State.CONFIRMED
    measure(measured, digest="e")
    assert measured.state == Visit.State.MEASURED
    assert Measurement.objects.count() == 2


def test_what_is_drawn_while_a_job_is_at_work_is_measured_after_it(measured: Visit) -> None:
    queue.enqueue(measured, None)
    owner = queue.new_owner()
    (job,) = queue.claim(owner, 1)
    draw(measured)
    assert queue.done(job.pk, owner, answer())
    measured.refresh_from_db()
    assert measured.state == Visit.State.QUEUED
    assert measured.is_changed
    measure(measured)
    assert measured.state == Visit.State.MEASURED


@pytest.mark.parametrize("how", ["failed", "cancelled"])
def test_a_drawing_whose_measurement_did_not_end_stays_changed(measured: Visit, how: str) -> None:
    draw(measured)
    queue.enqueue(measured, None)
    owner = queue.new_owner()
    (job,) = queue.claim(owner, 1)
    if how == "failed":
        queue.failed(job.pk, owner, "The boundary crosses itself.", 8)
    else:
        queue.cancel(job)
    measured.refresh_from_db()
    assert measured.state == Visit.State.CHANGED
    assert Job.objects.filter(state__in=Job.OPEN).count() == 0
    measure(measured, digest="e")
    assert measured.state == Visit.State.MEASURED


def test_a_failure_without_a_drawing_is_a_refusal(clinic: ClinicConfig, visit: Visit) -> None:
    job = queue.enqueue(visit, None)
    owner = queue.new_owner()
    queue.claim(owner, 1)
    queue.failed(job.pk, owner, "No breast stands out.", 8)
    visit.refresh_from_db()
    assert visit.state == Visit.State.REFUSED


# --- what the page saves ---


class Page:
    """An editor's page whose surface is not needed: a landmark is saved, or the disk refuses."""

    error: Exception | None = None
    changes = True

    def __init__(self, visit: Visit) -> None:
        self.visit = visit

    def items(self) -> dict[str, Any]:
        return {"boundaries": {"left": {"of": LEFT, "confirmed": None}}, "places": {}}

    def save(self, content: bytes, author: str) -> tuple[Save, tuple[Path, ...]]:
        if self.error is not None:
            raise self.error
        sent = Save.model_validate({**json.loads(content), "author": author})
        return sent, (self.visit.folder / "landmarks.json",) if self.changes else ()


@pytest.fixture
def page(monkeypatch: pytest.MonkeyPatch, measured: Visit) -> Page:
    made = Page(measured)
    monkeypatch.setattr(results, "_DESKS", SimpleNamespace(of=lambda visit: made))
    return made


def save(client: Client, visit: Visit) -> Any:
    message = {"author": "x", "landmarks": {"sternal_notch": {"base": None, "points": [[0, 0, 0]]}}}
    address = reverse("draw-save", args=[visit.pk])
    return client.post(address, json.dumps(message), content_type="application/json")


def test_what_is_saved_is_measured_at_once(
    client_of: Callable[..., Client], page: Page, measured: Visit, monkeypatch: pytest.MonkeyPatch
) -> None:
    client = client_of(Role.CLINICIAN)
    finish(client, measured)
    monkeypatch.setattr(results, "may_queue", lambda *_, **__: None)
    answer = save(client, measured).json()
    assert answer["visit"] == {"state": "queued", "changed": True, "curves": BOTH}
    assert Job.objects.filter(state="queued", visit=measured, created_by__username="clinician").count() == 1
    measured.refresh_from_db()
    assert confirmations.valid_confirmation(measured) is None
    measure(measured, digest="e")
    assert measured.state == Visit.State.MEASURED


def test_who_hears_of_a_jobs_end_hears_its_numbers_too(
    client_of: Callable[..., Client], page: Page, measured: Visit, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The job ends while the old numbers are read: the page must go on asking, or it waits for the new ones forever."""
    queue.enqueue(measured, None)
    (job,) = queue.claim("me", 1)
    of_before = page.items()

    def items() -> dict[str, Any]:
        queue.done(job.pk, "me", answer("e"))
        return of_before

    monkeypatch.setattr(page, "items", items)
    client, address = client_of(Role.CLINICIAN), reverse("draw-items", args=[measured.pk])
    assert client.get(address).json()["job"]["state"] == "running"
    monkeypatch.setattr(page, "items", lambda: of_before)
    assert client.get(address).json()["job"]["state"] == "done"


def test_what_cannot_be_measured_now_stays_changed(
    client_of: Callable[..., Client], page: Page, measured: Visit
) -> None:
    answer = save(client_of(Role.CLINICIAN), measured).json()  # the rig has no calibration
    assert answer["visit"]["state"] == "changed"
    assert not Job.objects.filter(state__in=Job.OPEN).exists()


def test_saving_what_stands_there_already_changes_nothing(
    client_of: Callable[..., Client], page: Page, measured: Visit
) -> None:
    client = client_of(Role.CLINICIAN)
    finish(client, measured)
    page.changes = False
    answer = save(client, measured).json()
    assert answer["visit"]["state"] == "confirmed"
    assert answer["boundaries"]["left"]["confirmed"]["holds"] is True
    assert not measured.drawings.filter(action="drawn").exists()


@pytest.mark.parametrize(("number", "status"), [(errno.ENOSPC, 507), (errno.EACCES, 503), (errno.EIO, 503)])
def test_a_disk_that_refuses_is_a_sentence_and_in_the_log(
    client_of: Callable[..., Client],
    page: Page,
    measured: Visit,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
    number: int,
    status: int,
) -> None:
    with pytest.raises(StorageError) as caught, disk_errors(measured.folder):
        raise OSError(number, os.strerror(number))
    page.error = caught.value
    logger = logging.getLogger("mammometry.web.replies")  # other tests may have cut it off from the root
    monkeypatch.setattr(logger, "disabled", False)
    monkeypatch.setattr(logger, "handlers", [caplog.handler])
    caplog.set_level(logging.ERROR, logger.name)
    answer = save(client_of(Role.CLINICIAN), measured)
    assert answer.status_code == status
    assert answer.json()["error"] == str(caught.value).replace(f"{the_clinic().folder}/", "")
    assert str(caught.value) in caplog.text
    measured.refresh_from_db()
    assert measured.state == Visit.State.MEASURED


# --- what is said of a change that is not measured ---


@pytest.mark.slow
@pytest.mark.requirement("R-WHO-6")
def test_an_unmeasured_change_is_said_everywhere_and_no_number_is_shown(
    client_of: Callable[..., Client], measured: Visit, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    client, researcher = client_of(Role.CLINICIAN), client_of(Role.RESEARCHER)
    Consent.objects.create(patient=measured.patient, purpose="research", given_on="2026-01-01")
    addresses = [reverse("visit", args=[measured.pk]), reverse("patient", args=[measured.patient_id])]
    finish(client, measured)
    for address in addresses:
        assert "407 cc" in client.get(address).content.decode()
    (row,) = csv.DictReader(io.StringIO(researcher.get(reverse("study-csv")).content.decode()))
    assert (row["volume_cc"], row["state"], row["confirmed"]) == ("407.4", "confirmed", "True")
    assert row["confirmed_on"] == timezone.localdate().isoformat()

    draw(measured)
    monkeypatch.setattr(exports, "report_file", lambda *_: tmp_path)
    monkeypatch.setattr(hospital, "report_file", lambda *_: tmp_path)
    for state in ("changed", "queued"):
        Visit.objects.filter(pk=measured.pk).update(state=state)
        for address in addresses:
            shown = client.get(address).content.decode()
            assert confirmations.CHANGED in shown
            assert "407 cc" not in shown
            assert "✓ confirmed" not in shown
        for name in ("visit-dicom", "visit-fhir"):
            where = reverse(name, args=[measured.pk, *(["r4"] if name == "visit-fhir" else [])])
            assert client.get(where, follow=True).redirect_chain
        study = researcher.get(reverse("study")).content.decode()
        assert confirmations.CHANGED in study
        assert "407 cc" not in study
        (row,) = csv.DictReader(io.StringIO(researcher.get(reverse("study-csv")).content.decode()))
        assert (row["volume_cc"], row["state"], row["confirmed"]) == ("", confirmations.CHANGED, "False")
        for name in ("study-redcap", "study-table"):
            with zipfile.ZipFile(io.BytesIO(researcher.get(reverse(name)).content)) as archive:
                assert confirmations.CHANGED in archive.read("left-out.csv").decode()


@pytest.mark.parametrize("state", ["queued", "ready"])
def test_a_visit_without_a_finished_measurement_is_not_drawn_on(
    client_of: Callable[..., Client], visit: Visit, state: str
) -> None:
    if state == "queued":
        queue.enqueue(visit, None)
    answer = client_of(Role.CLINICIAN).get(f"/visits/{visit.pk}/draw/", follow=True)
    assert answer.redirect_chain == [(f"/visits/{visit.pk}/", 302)]
    wanted = "is being measured" if state == "queued" else "is not measured yet"
    assert wanted in answer.content.decode()
