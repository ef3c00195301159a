"""A daily check takes photographs of today alone: none that is known in any file, and none that is older."""

import datetime
import io
import shutil

import pytest
from django.utils import timezone
from PIL import Image
from tests.unit.clinic.test_clinic_uploads import Sender, photograph, rig_visit  # noqa: F401

from mammometry.clinic import rig_history
from mammometry.clinic.jobs.results import enter
from mammometry.clinic.models import Calibration, DailyCheck, Job, Upload
from mammometry.clinic.roles import Role

pytestmark = pytest.mark.requirement("R-RIG-1")
CAMERAS = ("front_left", "front_right")


@pytest.fixture
def rig(rig_visit):  # noqa: F811
    calibration = Calibration.objects.get()
    calibration.figures["cameras"] = {
        name: {**about, "serial": ""} for name, about in calibration.figures["cameras"].items()
    }
    calibration.save()
    return rig_visit.rig


@pytest.fixture
def client(client_of):
    return client_of(Role.TECHNICIAN)


def begin(client, rig):
    answer = client.post(f"/rigs/{rig.pk}/checks/", "{}", content_type="application/json")
    assert answer.status_code == 201, answer.content
    return Sender(client, DailyCheck.objects.get(pk=answer.json()["id"]), "check")


def judged(sender, taken_at=None):
    """Have a check judged: nothing moved."""
    check = sender.target
    if taken_at is not None:
        check.taken_at = taken_at
        check.save()
    job = Job.objects.create(check_of_day=check, kind="check")
    enter(job, {"figures": {"verdict": "unmoved", "reasons": ["no camera moved"], "cameras": {}, "unseen": []}})
    check.refresh_from_db()
    return check


def refusal(table):
    assert table["state"] == "refused", table
    (sentence,) = [check["sentence"] for check in table["checks"] if check["level"] == "refuse"]
    return sentence


def saved_again(data, *, quality=None):
    buffer = io.BytesIO()
    with Image.open(io.BytesIO(data)) as picture:
        picture.save(buffer, "PNG" if quality is None else "JPEG", **({} if quality is None else {"quality": quality}))
    return buffer.getvalue()


def timed(seed, taken):
    buffer, exif = io.BytesIO(), Image.Exif()
    exif.get_ifd(0x8769)[0x9003] = taken
    with Image.open(io.BytesIO(photograph(seed))) as picture:
        picture.save(buffer, "JPEG", exif=exif)
    return buffer.getvalue()


def calibrated_with(client, rig, data, name="front_left.jpg"):
    calibration = Calibration.objects.get(current=True)
    calibration.state = Calibration.State.UPLOADING
    calibration.save()
    table = Sender(client, calibration, "calibration").send(data, name=name, pose="01")
    assert table["state"] == "placed", table
    Calibration.objects.filter(pk=calibration.pk).update(state=Calibration.State.DONE)


@pytest.mark.slow
def test_the_calibrations_own_photograph_is_refused_in_any_file_and_place(client, rig):
    data = photograph(1)
    calibrated_with(client, rig, data)
    check = begin(client, rig)
    day = timezone.localdate()
    words = f"front left in pose 01 of the calibration of {day.day} {day:%b %Y}"
    assert f"of {words}" in refusal(check.send(data))
    assert words in refusal(check.send(data, name="front_right.jpg", camera="front_right"))
    png = saved_again(data)
    assert f"of {words}" in refusal(check.send(png, name="front_left.png"))
    assert not list((rig_history.the_clinic().folder / check.target.folder).glob("*"))
    assert check.send(photograph(2))["state"] == "placed"


@pytest.mark.slow
def test_yesterdays_photographs_are_refused(client, rig):
    yesterday = timezone.now() - datetime.timedelta(days=1)
    first = begin(client, rig)
    for seed, camera in enumerate(CAMERAS):
        assert first.send(photograph(seed), name=f"{camera}.jpg")["state"] == "placed"
    judged(first, yesterday)
    second = begin(client, rig)
    local = timezone.localtime(yesterday)
    for seed, camera in enumerate(CAMERAS):
        sentence = refusal(second.send(photograph(seed), name=f"{camera}.jpg"))
        assert f"{local.day} {local:%b %Y, %H:%M}" in sentence
    assert second.state()["missing"] == list(CAMERAS)
    answer = client.post(f"/checks/{second.target.pk}/run/", "{}", content_type="application/json")
    assert answer.status_code == 409


def test_a_visits_photograph_is_refused_without_saying_whose(client, client_of, rig, rig_visit):  # noqa: F811
    data = photograph(7)
    assert Sender(client, rig_visit).send(data)["state"] == "placed"
    keeper = client_of(Role.ADMINISTRATOR)
    sentence = refusal(begin(keeper, rig).send(data))
    assert "visit" in sentence
    assert rig_visit.patient.pseudonym not in sentence
    assert "Zypernkatze" not in sentence


def test_photographs_of_a_check_that_was_never_judged_may_be_sent_again(client, rig):
    assert begin(client, rig).send(photograph(3))["state"] == "placed"
    assert begin(client, rig).send(photograph(3))["state"] == "placed"


@pytest.mark.slow
def test_of_two_checks_with_the_same_photographs_one_is_judged(client, rig):
    one, other = begin(client, rig), begin(client, rig)
    for sender in (one, other):
        for seed, camera in enumerate(CAMERAS):
            sender.send(photograph(seed), name=f"{camera}.jpg")
    assert other.state()["ready"]
    judged(one)
    state = other.state()
    assert not state["ready"]
    assert "check" in state["together"][-1]["sentence"]
    assert client.post(f"/checks/{other.target.pk}/run/", "{}", content_type="application/json").status_code == 409


@pytest.mark.slow
def test_a_photograph_is_newer_than_its_cameras_last_one(client, rig):
    calibrated_with(client, rig, timed(1, "2026:03:02 08:00:00"))
    check = begin(client, rig)
    sentence = refusal(check.send(timed(2, "2026:03:01 23:59:59")))
    assert "1 Mar 2026, 23:59:59" in sentence
    assert "on 2 Mar 2026, 08:00:00" in sentence
    assert "age" in {each["check"] for each in check.send(timed(3, "2026:03:02 08:00:00"))["checks"]}
    # Another camera has a clock of its own, and files without a time stamp say nothing.
    assert check.send(timed(4, "2026:03:01 10:00:00"), name="front_right.jpg")["state"] == "placed"
    assert check.send(timed(5, "2026:03:02 08:00:01"))["state"] == "placed"
    judged(check)
    later = begin(client, rig)
    assert "check" in refusal(later.send(timed(6, "2026:03:02 08:00:01")))
    assert later.send(photograph(8))["state"] == "placed"


def test_after_another_calibration_of_the_day_its_check_is_not_photographed_again(client, rig):
    first = begin(client, rig)
    assert first.send(photograph(1))["state"] == "placed"
    judged(first)
    old = Calibration.objects.get(current=True)
    Calibration.objects.filter(pk=old.pk).update(current=False)
    Calibration.objects.create(
        rig=rig, taken_at=old.taken_at, folder=f"rigs/{rig.pk}/d", state="done", current=True, figures=old.figures
    )
    assert begin(client, rig).send(photograph(1))["state"] == "placed"
    DailyCheck.objects.filter(pk=first.target.pk).update(taken_at=timezone.now() - datetime.timedelta(days=2))
    assert "check" in refusal(begin(client, rig).send(photograph(1)))


def test_the_same_pixels_in_two_cameras_places_are_one_photograph(client, rig):
    check = begin(client, rig)
    check.send(photograph(1))
    check.send(saved_again(photograph(1)), name="front_right.png")
    assert check.state()["together"][-1]["check"] == "twice"


def test_a_calibration_of_old_photographs_is_no_check_of_today(client, rig):
    calibrated_with(client, rig, photograph(1))
    old = Calibration.objects.get(current=True)
    before = timezone.now() - datetime.timedelta(days=200)
    Upload.objects.filter(calibration=old).update(created=before)
    Calibration.objects.filter(pk=old.pk).update(current=False, taken_at=before)
    new = rig_history.new_calibration(rig, None)
    assert Sender(client, new, "calibration").send(photograph(1), pose="01")["state"] == "placed"
    new.refresh_from_db()
    new.state, new.current, new.figures = "done", True, {"verdict": "pass", "reasons": []}
    new.save()
    assert rig_history.photographed_at(new) == before
    assert rig_history.today(rig).sentence == "Not checked today."
    shutil.rmtree(rig_history.the_clinic().folder / new.folder)
