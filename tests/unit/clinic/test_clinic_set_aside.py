"""Originals are set aside and come back; nothing that was placed is ever deleted, and a measured visit says so."""

import json
import re
from collections.abc import Callable

import pytest
from django.test import Client
from django.utils import timezone
from tests.clinic_seed import DEFINITION
from tests.first_cases import first
from tests.unit.clinic.test_clinic_uploads import SIZE_WH, Sender, photograph

from mammometry.clinic.jobs import queue
from mammometry.clinic.jobs.results import enter
from mammometry.clinic.models import Calibration, DailyCheck, Job, Measurement, Patient, Upload, Visit
from mammometry.clinic.rig_history import may_queue, new_calibration, new_check
from mammometry.clinic.roles import Role
from mammometry.io.write import file_digest

ANSWER = {"digest": "d" * 64, "made_at": None, "software": "1", "volumes": []}


@pytest.fixture
def rig_visit(visit: Visit) -> Visit:
    visit.rig.definition = DEFINITION
    visit.rig.save()
    known = {name: {"stored_wh": list(SIZE_WH), "orientation": 1} for name in ("front_left", "front_right")}
    visit.calibration = Calibration.objects.create(
        rig=visit.rig, taken_at=timezone.now(), folder=f"rigs/{visit.rig.pk}/c", state="done", current=True,
        figures={"cameras": known, "verdict": "pass"},
    )  # fmt: skip
    visit.save()
    return visit


@pytest.fixture
def sender(client_of: Callable[..., Client], rig_visit: Visit) -> Sender:
    return Sender(client_of(Role.TECHNICIAN), rig_visit)


def measured(visit: Visit) -> None:
    """As the runner does, of the photographs that are there."""
    job = queue.enqueue(visit, None)
    Job.objects.filter(pk=job.pk).update(state="done", started=timezone.now(), ended=timezone.now())
    enter(Job.objects.get(pk=job.pk), ANSWER)
    visit.refresh_from_db()


def files(visit: Visit) -> dict[str, str]:
    """Name → digest of every photograph in the visit's folder."""
    found = [path for path in visit.folder.rglob("*") if path.suffix in (".jpg", ".png")]
    return {path.relative_to(visit.folder).as_posix(): file_digest(path) for path in found}


@pytest.mark.slow
def test_what_is_set_aside_keeps_its_bytes_and_comes_back(sender: Sender, rig_visit: Visit) -> None:
    data = photograph(1)
    left = sender.send(data)
    sender.send(photograph(2), name="front_right.jpg")
    before = files(rig_visit)
    measured(rig_visit)
    assert sender.client.delete(left["url"]).status_code == 204
    rig_visit.refresh_from_db()
    assert rig_visit.state == Visit.State.CHANGED
    assert not (rig_visit.folder / "capture/front_left.jpg").exists()
    assert set(files(rig_visit).values()) == set(before.values())
    state = sender.state()
    assert state["missing"] == ["front_left"]
    (aside,) = state["set_aside"]
    assert aside["camera"] == "front_left"
    assert sender.client.get(aside["thumbnail"]).status_code == 200
    assert sender.client.delete(aside["url"]).status_code == 409  # no second press deletes it
    assert sender.client.post(f"{aside['url']}back/").status_code == 200
    assert (rig_visit.folder / "capture/front_left.jpg").read_bytes() == data
    assert sender.state()["ready"]
    rig_visit.refresh_from_db()
    assert rig_visit.state == Visit.State.CHANGED
    measured(rig_visit)  # to the same numbers: it settles
    assert rig_visit.state == Visit.State.MEASURED
    assert Measurement.objects.count() == 1
    assert sender.client.post(f"{aside['url']}back/").status_code == 409


@pytest.mark.parametrize("form", first(1, ["JPEG", "PNG"]))
def test_a_new_photograph_sets_the_old_one_aside(sender: Sender, rig_visit: Visit, form: str) -> None:
    first, second = photograph(1), photograph(3, form=form)
    sender.send(first)
    sender.send(photograph(2), name="front_right.jpg")
    measured(rig_visit)
    assert sender.begin(second).json()["occupied"]  # the page asks
    sender.send(second, replace=True)
    rig_visit.refresh_from_db()
    assert rig_visit.state == Visit.State.CHANGED
    (capture,) = (rig_visit.folder / "capture").glob("front_left.*")
    assert capture.read_bytes() == second
    (aside,) = (rig_visit.folder / "set-aside").iterdir()
    assert aside.read_bytes() == first
    (old,) = sender.state()["set_aside"]
    sender.client.post(f"{old['url']}back/")  # they change places
    (capture,) = (rig_visit.folder / "capture").glob("front_left.*")
    assert capture.read_bytes() == first
    assert sorted(path.read_bytes() for path in (rig_visit.folder / "set-aside").iterdir()) == sorted([first, second])
    assert sorted(rig_visit.uploads.values_list("camera", "state")) == [
        ("front_left", "placed"), ("front_left", "set aside"), ("front_right", "placed"),
    ]  # fmt: skip


@pytest.mark.slow
def test_the_same_photograph_sent_again_changes_nothing(sender: Sender, rig_visit: Visit) -> None:
    sender.send(photograph(1))
    sender.send(photograph(2), name="front_right.jpg")
    measured(rig_visit)
    assert sender.begin(photograph(1)).status_code == 200
    rig_visit.refresh_from_db()
    assert not (rig_visit.folder / "set-aside").exists()
    assert rig_visit.uploads.count() == 2


@pytest.mark.parametrize("kind", ["calibration", "check"])
def test_photographs_of_the_board_are_set_aside_too(
    client_of: Callable[..., Client], rig_visit: Visit, kind: str
) -> None:
    target: Calibration | DailyCheck | None
    target = new_calibration(rig_visit.rig, None) if kind == "calibration" else new_check(rig_visit.rig, None)
    assert target is not None
    sender = Sender(client_of(Role.ADMINISTRATOR), target, kind)
    pose = {"pose": "01"} if kind == "calibration" else {}
    data = photograph(1)
    sent = sender.send(data, **pose)
    assert sender.client.delete(sent["url"]).status_code == 204
    (aside,) = sender.state()["set_aside"]
    assert "data-aside" in sender.client.get(f"/{kind}s/{target.pk}/").content.decode()
    assert aside["pose"] == pose.get("pose")
    assert sender.client.post(f"{aside['url']}back/").status_code == 200
    row = Upload.objects.get()
    assert row.state == Upload.State.PLACED
    from mammometry.clinic.intake.uploads import folder_of

    assert (folder_of(target) / row.name).read_bytes() == data
    assert row.name == ("calibration/01/front_left.jpg" if pose else "front_left.jpg")


@pytest.mark.slow
def test_nothing_comes_back_while_it_is_measured(sender: Sender, rig_visit: Visit) -> None:
    sent = sender.send(photograph(1))
    sender.client.delete(sent["url"])
    queue.enqueue(rig_visit, None)
    assert sender.client.post(f"{sent['url']}back/").status_code == 409


def test_a_full_disk_leaves_the_photograph_in_its_place(
    sender: Sender, rig_visit: Visit, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mammometry.clinic.intake import photographs

    sent = sender.send(photograph(1))

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(photographs.os, "link", full)
        patch.setattr(photographs.shutil, "copy2", full)
        assert sender.client.delete(sent["url"]).status_code == 507
    assert (rig_visit.folder / "capture/front_left.jpg").is_file()
    assert Upload.objects.get().state == Upload.State.PLACED
    assert not sender.state()["set_aside"]


# --- the same photographs in two visits ---


@pytest.mark.slow
def test_photographs_of_another_visit_are_told_before_they_are_measured(sender: Sender, rig_visit: Visit) -> None:
    patient = Patient.objects.create(family_name="Q", given_name="Q", record_number="2")
    other = Visit.objects.create(
        patient=patient, rig=rig_visit.rig, calibration=rig_visit.calibration, taken_at=timezone.now()
    )
    theirs = Sender(sender.client, other)
    theirs.send(photograph(1))
    assert not [row for row in theirs.state()["together"] if row["check"] == "elsewhere"]
    sender.send(photograph(1))
    sender.send(photograph(2), name="front_right.jpg")
    (told,) = [row for row in sender.state()["together"] if row["check"] == "elsewhere"]
    assert told["level"] == "warn"
    assert told["url"] == f"/visits/{other.pk}/"
    assert "Q, Q" in told["sentence"]
    assert re.search("front.left", told["sentence"])
    answer = sender.client.post(f"/visits/{rig_visit.pk}/measure/", "{}", content_type="application/json")
    assert answer.status_code == 409
    assert "Q, Q" in answer.json()["error"]
    anyway = json.dumps({"anyway": True})
    answer = sender.client.post(f"/visits/{rig_visit.pk}/measure/", anyway, content_type="application/json")
    assert answer.status_code == 202
    other.binned_at = timezone.now()
    other.save()
    Job.objects.all().delete()
    assert may_queue(rig_visit) is None  # what is in the bin is nobody's any more
