"""Uploads over HTTP: in pieces, cut and gone on with, refused, replaced; what is on the disk agrees with the rows."""

import hashlib
import io
import json
import re
import threading

import numpy as np
import pytest
from django.utils import timezone
from PIL import Image

from mammometry.clinic.intake import uploads
from mammometry.clinic.intake.places import folder_of
from mammometry.clinic.jobs import queue
from mammometry.clinic.models import Calibration, Upload, Visit
from mammometry.clinic.roles import Role
from mammometry.io.manifest import read_manifest

DEFINITION = {
    "rig": {
        "name": "two cameras",
        "pairs": [{"name": "front", "left": "front_left", "right": "front_right"}],
        "mounting": "upright",
    },
    "target": {
        "kind": "charuco",
        "squares": [14, 10],
        "square_mm": 25.0,
        "marker_mm": 18.0,
        "dictionary": "DICT_5X5_250",
    },
}
SIZE_WH = (320, 240)


def photograph(seed=1, size_wh=SIZE_WH, form="JPEG", serial=""):
    """A pale, mottled disc before a dark wall."""
    width, height = size_wh
    x, y = np.meshgrid(np.arange(width) - width / 2, np.arange(height) - height / 2)
    light = np.where(np.hypot(x, y) < 0.35 * height, 160, 8) + np.random.default_rng(seed).normal(
        0, 12, (height, width)
    )
    buffer = io.BytesIO()
    exif = Image.Exif()
    if serial:
        exif.get_ifd(0x8769)[0xA431] = serial
    Image.fromarray(np.clip(light, 0, 255).astype(np.uint8)).convert("RGB").save(buffer, format=form, exif=exif)
    return buffer.getvalue()


@pytest.fixture
def rig_visit(visit):
    """A visit before a rig of two cameras that is calibrated for photographs of that size."""
    rig = visit.rig
    rig.definition = DEFINITION
    rig.save()
    known = {
        name: {"stored_wh": list(SIZE_WH), "orientation": 1, "serial": serial, "clock_s": None}
        for name, serial in (("front_left", "A1"), ("front_right", "B2"))
    }
    calibration = Calibration.objects.create(
        rig=rig,
        taken_at=timezone.now(),
        folder=f"rigs/{rig.pk}/c",
        state=Calibration.State.DONE,
        current=True,
        figures={"cameras": known, "verdict": "pass"},
    )
    visit.calibration = calibration
    visit.save()
    return visit


class Sender:
    """What the page's script does."""

    def __init__(self, client, target, kind="visit"):
        self.client, self.target, self.kind = client, target, kind

    def begin(self, data, *, name="front_left.jpg", camera=None, digest=None, **more):
        table = {
            "for": self.kind,
            "id": str(self.target.pk),
            "name": name,
            "camera": camera,
            "size_bytes": len(data),
            "sha256": hashlib.sha256(data).hexdigest() if digest is None else digest,
            **more,
        }
        return self.client.post("/uploads/", json.dumps(table), content_type="application/json")

    def piece(self, url, offset, data):
        return self.client.patch(
            url, data, content_type="application/offset+octet-stream", headers={"Upload-Offset": str(offset)}
        )

    def send(self, data, *, pieces=3, **more):
        begun = self.begin(data, **more)
        assert begun.status_code == 201, begun.content
        answer, at = begun, 0
        for part in np.array_split(np.frombuffer(data, np.uint8), pieces):
            answer = self.piece(begun.json()["url"], at, part.tobytes())
            assert answer.status_code == (422 if answer.json()["state"] == "refused" else 200), answer.content
            at += len(part)
            if answer.json()["state"] != "receiving":
                break
        return answer.json()

    def state(self):
        return self.client.get(f"/{self.kind}s/{self.target.pk}/uploads/").json()


@pytest.fixture
def sender(client_of, rig_visit):
    return Sender(client_of(Role.TECHNICIAN), rig_visit)


def levels(table):
    return {each["check"]: each["level"] for each in table["checks"]}


def test_a_photograph_in_pieces_lies_in_the_session_as_it_was_sent(sender, rig_visit):
    data = photograph()
    table = sender.send(data, pieces=5)
    assert table["state"] == "placed"
    assert (table["camera"], table["offset"]) == ("front_left", len(data))
    assert levels(table)["camera"] == levels(table)["size"] == levels(table)["format"] == "ok"
    assert (rig_visit.folder / "capture" / "front_left.jpg").read_bytes() == data
    manifest = read_manifest(rig_visit.folder / "session.toml")
    assert manifest.subject.id == rig_visit.patient.pseudonym
    assert "Zypernkatze" not in (rig_visit.folder / "session.toml").read_text()
    rig_visit.refresh_from_db()
    assert rig_visit.state == Visit.State.UPLOADING
    state = sender.state()
    assert state["missing"] == ["front_right"]
    assert not state["ready"]
    assert sender.client.get(table["thumbnail"]).headers["Content-Type"] == "image/webp"


def test_no_lock_of_an_upload_stays(sender, rig_visit, clinic):
    assert sender.send(photograph())["state"] == "placed"
    half = Upload.objects.create(visit=rig_visit, camera="front_right", size_bytes=9)
    kept = clinic.folder / "uploads" / f"{half.pk}.lock"
    kept.touch()
    (clinic.folder / "uploads" / "of-a-killed-server.lock").touch()
    assert uploads.remove_stale_locks() == 1
    assert list((clinic.folder / "uploads").glob("*.lock")) == [kept]


def test_all_photographs_make_a_visit_ready_and_one_taken_away_does_not(sender, rig_visit):
    sender.send(photograph(1))
    right = sender.send(photograph(2), name="front_right.jpg")
    rig_visit.refresh_from_db()
    assert rig_visit.state == Visit.State.READY
    assert sender.state()["ready"]
    assert sender.client.delete(right["url"]).status_code == 204
    rig_visit.refresh_from_db()
    assert rig_visit.state == Visit.State.UPLOADING
    assert not (rig_visit.folder / "capture" / "front_right.jpg").exists()


def test_after_a_cut_it_goes_on_where_it_ended(sender, rig_visit):
    data = photograph()
    url = sender.begin(data).json()["url"]
    assert sender.piece(url, 0, data[:1000]).json()["offset"] == 1000
    again = sender.begin(data)  # the page was loaded anew
    assert again.status_code == 200
    assert (again.json()["url"], again.json()["offset"]) == (url, 1000)
    for wrong in (0, 999, 1001, len(data)):
        refused = sender.piece(url, wrong, data[wrong : wrong + 10])
        assert refused.status_code == 409
        assert refused.json()["offset"] == 1000
    assert sender.piece(url, 1000, data[1000:]).json()["state"] == "placed"
    assert (rig_visit.folder / "capture" / "front_left.jpg").read_bytes() == data


def test_killed_between_the_last_byte_and_the_checks_it_is_finished_when_asked(sender, rig_visit, monkeypatch):
    data = photograph()
    url = sender.begin(data).json()["url"]
    with monkeypatch.context() as patch:
        patch.setattr(uploads, "_finish", lambda upload: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            sender.piece(url, 0, data)
    assert Upload.objects.get().state == Upload.State.RECEIVING
    assert sender.client.get(url).json()["state"] == "placed"
    assert (rig_visit.folder / "capture" / "front_left.jpg").read_bytes() == data


def test_a_damaged_file_is_refused_and_can_be_sent_again(sender, rig_visit):
    data = photograph()
    table = sender.send(data[:500] + b"\x00" + data[501:], digest=hashlib.sha256(data).hexdigest(), pieces=1)
    assert table["state"] == "refused"
    assert levels(table) == {"digest": "refuse"}
    assert not (rig_visit.folder / "capture").exists()
    assert sender.send(data)["state"] == "placed"


@pytest.mark.parametrize(
    ("data", "check"),
    [
        (photograph(serial="B2"), "camera"),
        (photograph(size_wh=(240, 320)), "size"),
        (photograph()[:-200], "format"),
        (photograph()[:-300] + bytes(200) + photograph()[-100:], "format"),
        (photograph() + b"PK\x03\x04PK\x05\x06" + b"\x00" * 18, "format"),
        (b"<html><script>alert(1)</script></html>", "format"),
        (b"\xff\xd8\xff" + b"\x00" * 300, "format"),
        (photograph()[:2] + b"\xff\xfe\x00\x40<html><script>alert(1)</script>".ljust(66) + photograph()[2:], "format"),
        (photograph() + b"<script>alert(1)</script>", "format"),
        (b"<svg xmlns='http://www.w3.org/2000/svg' onload='alert(1)'/>", "format"),
    ],
)
def test_what_cannot_be_used_is_refused_and_not_in_the_session(sender, rig_visit, data, check):
    table = sender.send(data, pieces=1)
    assert table["state"] == "refused"
    assert levels(table)[check] == "refuse"
    assert not list(rig_visit.folder.glob("capture/*"))
    assert not Upload.objects.get().path.exists()


EVIL_NAMES = ("front_left.jpg\r\nX-Evil: 1", "../../front_left.jpg", "<script>alert(1)</script>.jpg")


@pytest.mark.slow
@pytest.mark.parametrize("name", EVIL_NAMES)
def test_a_senders_name_goes_nowhere(sender, rig_visit, name):
    """Not into a header, not into a path, not onto a page."""
    table = sender.send(photograph(), name=name, camera="front_left")
    assert table["state"] == "placed"
    thumbnail = sender.client.get(table["thumbnail"])
    assert thumbnail.status_code == 200
    assert "evil" not in str(thumbnail.headers).lower()
    assert [path.name for path in rig_visit.folder.glob("capture/*")] == ["front_left.jpg"]
    assert "<script>alert(1)" not in sender.client.get(f"/visits/{rig_visit.pk}/").content.decode()
    assert "<script>" not in json.dumps(sender.state())


@pytest.mark.slow
def test_a_bomb_is_refused_by_its_header(sender):
    """A PNG of 400 megapixels that takes half a megabyte: pixels are never decoded."""
    buffer = io.BytesIO()
    Image.new("1", (20_000, 20_000)).save(buffer, format="PNG")
    table = sender.send(buffer.getvalue(), pieces=1)
    assert table["state"] == "refused"
    assert "400 megapixels" in table["checks"][0]["sentence"]


@pytest.mark.slow
def test_eleven_megapixels_of_nothing_are_decoded_and_refused_by_size(sender):
    table = sender.send(photograph(size_wh=(1600, 1200), form="PNG"), pieces=1)
    assert levels(table)["size"] == "refuse"


def test_its_serial_number_places_a_photograph_that_no_name_does(sender):
    assert sender.send(photograph(serial="B2"), name="IMG_0042.JPG")["camera"] == "front_right"


@pytest.mark.slow
def test_a_photograph_of_nobody_knows_whose_waits_to_be_placed(sender, rig_visit):
    table = sender.send(photograph(), name="IMG_0042.JPG")
    assert (table["state"], table["camera"]) == ("checked", None)
    (waiting,) = sender.state()["unplaced"]
    placed = sender.client.post(
        f"{waiting['url']}place/", json.dumps({"camera": "front_right"}), content_type="application/json"
    ).json()
    assert placed["state"] == "placed"
    assert (rig_visit.folder / "capture" / "front_right.jpg").is_file()
    assert not sender.state()["unplaced"]


@pytest.mark.slow
def test_the_same_photograph_twice_is_not_ready(sender):
    sender.send(photograph())
    sender.send(photograph(), name="front_right.jpg")
    state = sender.state()
    assert not state["ready"]
    assert any(each["check"] == "twice" and each["level"] == "refuse" for each in state["together"])


@pytest.mark.slow
def test_a_second_photograph_takes_the_place_of_the_first_even_of_another_kind(sender, rig_visit):
    sender.send(photograph(1))
    sender.send(photograph(2, form="PNG"), name="front_left.png", replace=True)
    assert [path.name for path in (rig_visit.folder / "capture").iterdir()] == ["front_left.png"]
    assert list(Upload.objects.values_list("state", flat=True)) == ["set aside", "placed"]


def test_what_is_asked_for_wrongly_is_one_sentence(sender, rig_visit):
    data = photograph()
    cases = [
        ({"camera": "../../etc"}, 400),
        ({"camera": "floor_left"}, 400),
        ({"size_bytes": 10**12}, 413),
        ({"size_bytes": 0}, 413),
        ({"size_bytes": "many"}, 400),
        ({"digest": "zz"}, 400),
        ({"for": "patient"}, 400),
        ({"id": "../1"}, 400),
        ({"id": "00000000-0000-4000-8000-000000000000"}, 404),
    ]
    for change, status in cases:
        answer = sender.begin(data, **change)
        assert answer.status_code == status, (change, answer.content)
    assert Upload.objects.count() == 0
    url = sender.begin(data).json()["url"]
    assert sender.piece(url, 0, data + b"more").status_code == 413
    assert sender.client.patch(url, b"x", content_type="application/offset+octet-stream").status_code == 400


def test_a_calibration_takes_poses_and_no_path(client_of, rig_visit):
    from mammometry.clinic.rig_history import new_calibration

    sender = Sender(client_of(Role.ADMINISTRATOR), new_calibration(rig_visit.rig, None), "calibration")
    for wrong in ("", "..", "a/b", "-x", "x" * 33):
        assert sender.begin(photograph(), pose=wrong).status_code == 400
    assert sender.send(photograph(), pose="01")["state"] == "placed"
    assert sender.state()["poses"]["01"]["front_left"]["pose"] == "01"
    assert (folder_of(sender.target) / "calibration" / "01" / "front_left.jpg").is_file()


@pytest.mark.slow
def test_an_administrator_sees_no_patients_photographs(client_of, sender):
    table = sender.send(photograph())
    administrator = client_of(Role.ADMINISTRATOR)
    assert administrator.get(table["url"]).status_code == 403
    assert administrator.get(table["thumbnail"]).status_code == 403
    assert Sender(administrator, sender.target).begin(photograph()).status_code == 403


def test_nothing_changes_while_it_is_measured(sender, rig_visit):
    table = sender.send(photograph())
    queue.enqueue(rig_visit, None)
    assert sender.begin(photograph(3)).status_code == 409
    assert sender.client.delete(table["url"]).status_code == 409


@pytest.mark.slow
def test_two_people_send_the_same_place_at_once_and_one_whole_photograph_remains(shared_database, client_of, rig_visit):
    first, second = photograph(1), photograph(2)
    senders = [Sender(client_of(Role.TECHNICIAN, name=name), rig_visit) for name in ("anna", "bert")]
    errors = []

    def send(sender, data):
        try:
            sender.send(data, pieces=7, replace=True)
        except BaseException as error:
            errors.append(error)
        finally:
            from django.db import connection

            connection.close()

    threads = [threading.Thread(target=send, args=pair) for pair in zip(senders, (first, second), strict=True)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not errors
    assert (rig_visit.folder / "capture" / "front_left.jpg").read_bytes() in (first, second)
    assert Upload.objects.filter(state=Upload.State.PLACED).count() == 1


@pytest.mark.slow
def test_a_second_photograph_replaces_the_first_only_where_that_is_said(sender, rig_visit):
    first, second = photograph(1), photograph(2)
    sender.send(first)
    answer = sender.begin(second)
    assert (answer.status_code, answer.json()["occupied"]) == (409, True)
    assert "front_left" in answer.json()["error"]
    # by its serial number: it is asked which camera took it
    table = sender.send(photograph(3, serial="A1"), name="IMG_0001.jpg")
    assert (table["state"], table["camera"]) == ("checked", None)
    assert "front_left" in table["checks"][-1]["sentence"]
    assert (rig_visit.folder / "capture" / "front_left.jpg").read_bytes() == first
    assert sender.send(second, replace=True)["state"] == "placed"
    assert (rig_visit.folder / "capture" / "front_left.jpg").read_bytes() == second


@pytest.mark.slow
def test_a_calibration_says_how_many_poses_it_still_needs(client_of, rig_visit):
    from mammometry.clinic.rig_history import may_queue, new_calibration

    sender = Sender(client_of(Role.ADMINISTRATOR), new_calibration(rig_visit.rig, None), "calibration")
    for pose in (1, 2):
        for camera in ("front_left", "front_right"):
            sender.send(photograph(10 * pose + len(camera)), name=f"{camera}.jpg", pose=f"{pose:02d}")
    state = sender.state()
    assert (state["ready"], state["missing"], state["known"]) == (False, [], ["front_left", "front_right"])
    assert re.search("one more pose.* 3 times", state["needed"])
    assert may_queue(sender.target) == state["needed"]
    occupied = sender.begin(photograph(9), pose="02").json()
    assert occupied["occupied"]
    assert re.search("Pose 02 .*front_left", occupied["error"])
    for camera in ("front_left", "front_right"):
        sender.send(photograph(30 + len(camera)), name=f"{camera}.jpg", pose="03")
    assert sender.state()["ready"]
    assert may_queue(sender.target) is None


@pytest.mark.slow
@pytest.mark.requirement("R-FIRE-5")
def test_exchanged_photographs_are_named_before_they_are_measured(sender, rig_visit, monkeypatch):
    from mammometry.calibration.judge.camera_names import PhotographCheck
    from mammometry.clinic.intake import photographs
    from mammometry.clinic.rig_history import may_queue

    both = {"front_left": "front_right", "front_right": "front_left"}
    rig = type("AnyRig", (), {"cameras": both, "pair_names": {"front": ("front_left", "front_right")}})
    monkeypatch.setattr(photographs, "_rig", lambda calibration: rig)
    monkeypatch.setattr(photographs, "check_names", lambda rig, seen: PhotographCheck(pairs={}, exchanged=both))
    photographs._checked.cache_clear()
    for seed, camera in enumerate(both):
        sender.send(photograph(seed), name=f"{camera}.jpg")
    assert "front_left and front_right: " in may_queue(rig_visit)
    assert not sender.state()["ready"]
    photographs._checked.cache_clear()
