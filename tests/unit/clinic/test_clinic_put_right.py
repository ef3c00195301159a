"""Exchanged photographs are put right by a click, unnamed ones get their camera, and every choice can be changed."""

import hashlib
import json
import os

import pytest
from tests.clinic_forms import filled
from tests.unit.clinic.test_clinic_uploads import Sender, photograph, rig_visit, sender  # noqa: F401

from mammometry.calibration.judge.camera_names import PairAgreement, PhotographCheck
from mammometry.clinic.intake import photographs
from mammometry.clinic.jobs.results import enter
from mammometry.clinic.models import Calibration, DailyCheck, Job, Upload, Visit
from mammometry.clinic.rig_history import may_queue, today
from mammometry.clinic.roles import Role

LEFT, RIGHT = photograph(1), photograph(2)
TAKEN_BY = {hashlib.sha256(LEFT).hexdigest(): "front_left", hashlib.sha256(RIGHT).hexdigest(): "front_right"}
BOTH = {"front_left": "front_right", "front_right": "front_left"}


@pytest.fixture
def geometry(rig_visit, monkeypatch):  # noqa: F811
    """A calibration that knows of two photographs which camera took them, in place of features in real ones."""
    calibration = Calibration.objects.get()
    for about in calibration.figures["cameras"].values():
        about["serial"] = ""
    calibration.save()
    rig = type("AnyRig", (), {"cameras": BOTH, "pair_names": {"front": ("front_left", "front_right")}})

    def check_names(rig, seen):
        right = all(TAKEN_BY.get(digest, camera) == camera for camera, digest in seen.items())
        fits = PairAgreement(matches=100, fitting=1.0 if right else 0.0, offset_mm=0.0)
        return PhotographCheck(pairs={"front": fits}, exchanged={} if right else BOTH)

    monkeypatch.setattr(photographs, "_rig", lambda calibration: rig)
    monkeypatch.setattr(photographs, "_seen", lambda sha256, path: sha256)
    monkeypatch.setattr(photographs, "check_names", check_names)
    photographs._checked.cache_clear()
    photographs._by_geometry.cache_clear()
    yield
    photographs._checked.cache_clear()
    photographs._by_geometry.cache_clear()


def post(sender, path, table):  # noqa: F811
    return sender.client.post(path, json.dumps(table), content_type="application/json")


def in_place(visit):
    return {path.stem: path.read_bytes() for path in (visit.folder / "capture").iterdir()}


@pytest.mark.requirement("R-RIG-4")
@pytest.mark.usefixtures("geometry")
def test_exchanged_photographs_are_put_right(sender, rig_visit):  # noqa: F811
    sender.send(LEFT, name="front_right.jpg")
    sender.send(RIGHT, name="front_left.jpg")
    state = sender.state()
    assert state["exchanged"] == BOTH
    assert not state["ready"]
    before = {row["camera"]: row["upload"]["id"] for row in state["cameras"]}
    answer = post(sender, f"/visits/{rig_visit.pk}/put-right/", {"exchanged": BOTH})
    assert answer.status_code == 200
    after = answer.json()
    assert {row["camera"]: row["upload"]["id"] for row in after["cameras"]} == {
        "front_left": before["front_right"], "front_right": before["front_left"]
    }  # fmt: skip
    assert in_place(rig_visit) == {"front_left": LEFT, "front_right": RIGHT}
    assert (after["exchanged"], after["ready"]) == ({}, True)
    assert may_queue(Visit.objects.get()) is None
    for row in Upload.objects.all():
        assert hashlib.sha256((rig_visit.folder / row.name).read_bytes()).hexdigest() == row.sha256
        assert row.checks[0]["level"] == "ok"
    # A second press, or a page from before, changes nothing.
    assert post(sender, f"/visits/{rig_visit.pk}/put-right/", {"exchanged": BOTH}).status_code == 409
    assert in_place(rig_visit) == {"front_left": LEFT, "front_right": RIGHT}
    for wrong in ({}, {"front_left": "front_left"}, "x", None):
        assert post(sender, f"/visits/{rig_visit.pk}/put-right/", {"exchanged": wrong}).status_code in (400, 409)


@pytest.mark.slow
@pytest.mark.usefixtures("geometry")
def test_what_is_being_measured_is_not_put_right(sender, rig_visit):  # noqa: F811
    sender.send(LEFT, name="front_right.jpg")
    sender.send(RIGHT, name="front_left.jpg")
    Job.objects.create(visit=rig_visit, kind="measure", state="running")
    assert post(sender, f"/visits/{rig_visit.pk}/put-right/", {"exchanged": BOTH}).status_code == 409
    assert in_place(rig_visit) == {"front_left": RIGHT, "front_right": LEFT}


@pytest.mark.slow
@pytest.mark.parametrize("role", [Role.ADMINISTRATOR, Role.RESEARCHER])
@pytest.mark.usefixtures("geometry")
def test_others_put_nothing_right(sender, client_of, rig_visit, role):  # noqa: F811
    sender.send(LEFT, name="front_right.jpg")
    sender.send(RIGHT, name="front_left.jpg")
    other = Sender(client_of(role), rig_visit)
    assert post(other, f"/visits/{rig_visit.pk}/put-right/", {"exchanged": BOTH}).status_code == 403
    upload = Upload.objects.first()
    assert post(other, f"/uploads/{upload.pk}/place/", {"camera": "front_left"}).status_code == 403


@pytest.mark.slow
@pytest.mark.requirement("R-RIG-4")
@pytest.mark.usefixtures("geometry")
def test_unnamed_photographs_get_the_camera_that_the_calibration_says(sender):  # noqa: F811
    sender.send(RIGHT, name="IMG_0001.JPG")
    assert sender.state()["by_geometry"] == {}  # one alone tells nothing
    sender.send(LEFT, name="Meier links.jpg")
    state = sender.state()
    files = {row["file"]: row for row in state["unplaced"]}
    assert set(files) == {"IMG_0001.JPG", None}  # a name that may be a patient's is not kept
    assert not Upload.objects.filter(checks__icontains="Meier").exists()
    assert state["by_geometry"] == {files["IMG_0001.JPG"]["id"]: "front_right", files[None]["id"]: "front_left"}
    for upload, camera in state["by_geometry"].items():
        assert post(sender, f"/uploads/{upload}/place/", {"camera": camera}).status_code == 200
    assert sender.state()["ready"]


@pytest.mark.usefixtures("geometry")
def test_what_the_calibration_cannot_tell_is_asked(sender, monkeypatch):  # noqa: F811
    sender.send(photograph(3), name="IMG_0001.JPG")
    sender.send(photograph(4), name="IMG_0002.JPG")
    unsure = PhotographCheck(pairs={"front": PairAgreement(matches=3, fitting=0.0, offset_mm=0.0)})
    monkeypatch.setattr(photographs, "check_names", lambda rig, seen: unsure)
    photographs._by_geometry.cache_clear()
    assert sender.state()["by_geometry"] == {}


@pytest.mark.slow
def test_a_choice_is_changed_and_the_other_photograph_makes_room(sender, rig_visit):  # noqa: F811
    first = sender.send(LEFT, camera="front_right", name="IMG_0001.JPG")
    answer = post(sender, f"/uploads/{first['id']}/place/", {"camera": "front_left"})
    assert answer.json()["camera"] == "front_left"
    assert in_place(rig_visit) == {"front_left": LEFT}
    second = sender.send(RIGHT, camera="front_right", name="IMG_0002.JPG")
    post(sender, f"/uploads/{second['id']}/place/", {"camera": "front_left"})
    assert in_place(rig_visit) == {"front_left": RIGHT, "front_right": LEFT}
    assert Upload.objects.get(pk=first["id"]).camera == "front_right"
    assert len(list((rig_visit.folder / "capture").iterdir())) == 2


@pytest.mark.slow
def test_a_camera_of_another_size_or_serial_number_is_no_choice(sender, rig_visit):  # noqa: F811
    row = sender.send(photograph(5, serial="A1"))
    answer = post(sender, f"/uploads/{row['id']}/place/", {"camera": "front_right"})
    assert answer.status_code == 409
    assert "front_left" in answer.json()["error"]
    calibration = Calibration.objects.get()
    calibration.figures["cameras"]["front_right"] |= {"stored_wh": [10, 10], "serial": ""}
    calibration.save()
    plain = sender.send(photograph(6), camera="front_left", replace=True)
    answer = post(sender, f"/uploads/{plain['id']}/place/", {"camera": "front_right"})
    assert "10 × 10" in answer.json()["error"]
    assert set(in_place(rig_visit)) == {"front_left"}


@pytest.mark.slow
def test_a_choice_is_changed_on_a_disk_without_links(sender, rig_visit, monkeypatch):  # noqa: F811
    def refuse(*_):
        raise OSError("no links here")

    monkeypatch.setattr(os, "link", refuse)
    row = sender.send(LEFT, camera="front_right", name="IMG_0001.JPG")
    sender.send(RIGHT, camera="front_left", name="IMG_0002.JPG")
    post(sender, f"/uploads/{row['id']}/place/", {"camera": "front_left"})
    assert in_place(rig_visit) == {"front_left": LEFT, "front_right": RIGHT}


@pytest.mark.slow
def test_a_choice_of_a_check_and_of_a_pose_is_changed(client_of, rig_visit):  # noqa: F811
    client = client_of(Role.TECHNICIAN)
    Calibration.objects.update(figures={"cameras": {}, "verdict": "pass"})
    client.post(f"/rigs/{rig_visit.rig_id}/checks/", "{}", content_type="application/json")
    check = Sender(client, DailyCheck.objects.get(), "check")
    row = check.send(LEFT, camera="front_right", name="IMG_0001.JPG")
    post(check, f"/uploads/{row['id']}/place/", {"camera": "front_left"})
    assert [each["camera"] for each in check.state()["cameras"] if each["upload"]] == ["front_left"]
    Calibration.objects.update(state="uploading")
    calibration = Sender(client, Calibration.objects.get(), "calibration")
    row = calibration.send(photograph(8), camera="front_right", name="IMG_0002.JPG", pose="02")
    calibration.send(photograph(9), camera="front_left", name="IMG_0003.JPG", pose="01")
    post(calibration, f"/uploads/{row['id']}/place/", {"camera": "front_left"})
    assert {pose: set(shots) for pose, shots in calibration.state()["poses"].items()} == {
        "01": {"front_left"}, "02": {"front_left"}
    }  # fmt: skip


@pytest.fixture
def exchanged_check(client_of, rig_visit):  # noqa: F811
    """A check that was judged: its photographs are exchanged."""
    client = client_of(Role.TECHNICIAN)
    Calibration.objects.update(figures={"cameras": {}, "verdict": "pass"})
    client.post(f"/rigs/{rig_visit.rig_id}/checks/", "{}", content_type="application/json")
    check = Sender(client, DailyCheck.objects.get(), "check")
    check.send(LEFT, name="front_right.jpg")
    check.send(RIGHT, name="front_left.jpg")
    figures = {"verdict": "refuse", "reasons": ["the pictures seem to be exchanged"], "cameras": {}, "unseen": []}
    job = Job.objects.create(check_of_day=check.target, kind="check", state="done")
    enter(job, {"figures": {**figures, "exchanged": ["front_left", "front_right"]}})
    return check


@pytest.mark.requirement("R-RIG-4")
def test_a_checks_photographs_are_put_right_and_judged_again(exchanged_check, clinic):
    client, row = exchanged_check.client, DailyCheck.objects.get()
    assert not row.passed
    assert "exchanged" in row.verdict
    assert today(row.rig).verdict == "no"
    assert "exchanged" in today(row.rig).sentence
    path = f"/checks/{row.pk}/put-right/"
    answer = client.post(path, filled(client, f"/checks/{row.pk}/", path))
    assert answer.url == f"/checks/{row.pk}/"
    folder = clinic.folder / row.folder
    assert {each.stem: each.read_bytes() for each in folder.iterdir()} == {"front_left": LEFT, "front_right": RIGHT}
    row.refresh_from_db()
    assert (row.figures, row.passed) == ({}, None)
    assert row.jobs.filter(state="queued").count() == 1
    client.post(path)  # a second press, while it is judged
    assert {each.stem: each.read_bytes() for each in folder.iterdir()} == {"front_left": LEFT, "front_right": RIGHT}


@pytest.mark.slow
def test_others_put_no_check_right(exchanged_check, client_of):
    key = DailyCheck.objects.get().pk
    page = client_of(Role.CLINICIAN).get(f"/checks/{key}/").content.decode()
    assert "put-right" not in page
    for role in (Role.CLINICIAN, Role.RESEARCHER):
        assert client_of(role).post(f"/checks/{key}/put-right/").status_code == 403
    assert DailyCheck.objects.get().figures
