"""One video of a walk instead of photographs: what comes in, what is refused, what is kept."""

import json
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from django.http import HttpResponse
from django.test import Client
from django.utils import timezone
from tests.telephone_pictures import boxes, picture, video, write_prepared
from tests.unit.clinic.test_clinic_telephone import ANSWER, measured_now, task_of
from tests.unit.clinic.test_clinic_uploads import Sender, levels

from mammometry.clinic.config import ClinicConfig
from mammometry.clinic.intake import announced, places, walk_video, walks
from mammometry.clinic.jobs import queue, work
from mammometry.clinic.maintenance.backups import make_backup
from mammometry.clinic.models import Patient, Upload, Visit, Walk
from mammometry.clinic.roles import Role
from mammometry.walk.inputs import LeftOut

MB = 10**6
CONTENT = video()
WITHOUT_FRAMES = CONTENT[: boxes(CONTENT)[b"mdat"][0]] + CONTENT[boxes(CONTENT)[b"mdat"][1] :]


@pytest.fixture
def walk_visit(clinic: ClinicConfig) -> Visit:
    patient = Patient.objects.create(family_name="Zypernkatze", given_name="Quirina", born="1980-02-29")
    visit = Visit.objects.create(patient=patient, taken_at=timezone.now(), posture=Visit.Posture.STANDING)
    Walk.objects.create(visit=visit)
    return visit


@pytest.fixture
def sender(client_of: Callable[..., Client], walk_visit: Visit) -> Sender:
    return Sender(client_of(Role.TECHNICIAN), walk_visit)


def sent(sender: Sender, data: bytes, name: str) -> HttpResponse:
    """The answer to a whole file."""
    begun = sender.begin(data, name=name, digest="")
    assert begun.status_code == 201, begun.content
    answer: HttpResponse = sender.piece(begun.json()["url"], 0, data)
    return answer


def begun_with(sender: Sender, name: str, size_bytes: int) -> int:
    table = {"for": "visit", "id": str(sender.target.pk), "name": name, "size_bytes": size_bytes, "sha256": ""}
    return int(sender.client.post("/uploads/", json.dumps(table), content_type="application/json").status_code)


@pytest.mark.requirement("R-PHOTO-4")
def test_a_video_is_checked_and_can_be_measured(sender: Sender, walk_visit: Visit, clinic: ClinicConfig) -> None:
    assert sender.state()["ready"] is False
    table = sender.send(CONTENT, name="Muster Anna.MP4", digest="")
    assert (table["state"], levels(table), table["file"]) == ("placed", {"format": "ok", "board": "ok"}, None)
    state = sender.state()
    assert (state["ready"], [shot["is_video"] for shot in state["shots"]]) == (True, [True])
    assert sender.client.get(state["shots"][0]["thumbnail"]).status_code == 200
    walk_visit.refresh_from_db()
    assert walk_visit.state == Visit.State.READY
    assert not walk_visit.folder.exists()
    assert "Muster" not in json.dumps(list(Upload.objects.values("name", "checks")))
    assert measured_now(sender.client, walk_visit).status_code == 202


@pytest.mark.slow
def test_a_video_without_the_board_is_marked(sender: Sender) -> None:
    table = sender.send(video(board=False), name="IMG_0001.MOV", digest="")
    assert (table["state"], levels(table)["board"], table["file"]) == ("placed", "warn", "IMG_0001.MOV")


@pytest.mark.slow
def test_the_content_decides_what_is_a_video(sender: Sender) -> None:
    first = sender.send(CONTENT, name="IMG_0001.JPG", digest="")
    assert (first["state"], first["is_video"]) == ("placed", True)
    assert sender.client.delete(first["url"]).status_code == 204
    second = sender.send(picture(1), name="IMG_0001.MP4", digest="")
    assert (second["state"], second["is_video"]) == ("placed", False)


def test_a_video_has_its_own_limit(sender: Sender, clinic: ClinicConfig) -> None:
    most = clinic.limits.video_mb * MB
    assert most >= 30 * 100e6 / 8  # 30 s of 4K at 60 frames a second, 100 Mbit/s
    assert begun_with(sender, "walk.mp4", most + 1) == 413
    assert begun_with(sender, "walk.jpg", clinic.limits.photograph_mb * MB + 1) == 413
    assert begun_with(sender, "walk.mov", most) == 201


def test_a_large_file_that_is_only_named_as_a_video_is_refused(
    sender: Sender, clinic: ClinicConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = picture(1)
    limits = clinic.limits.model_copy(update={"photograph_mb": 0})
    monkeypatch.setattr(announced, "the_clinic", lambda: clinic.model_copy(update={"limits": limits}))
    answer = sent(sender, data, "walk.mp4")
    assert (answer.status_code, answer.json()["state"]) == (422, "refused")


@pytest.mark.requirement("R-PHOTO-4")
def test_photographs_and_a_video_are_not_mixed(sender: Sender) -> None:
    photograph = sender.send(picture(1))
    assert sender.begin(CONTENT, name="walk.mp4").status_code == 409
    assert sent(sender, CONTENT, "IMG_0002.JPG").status_code == 422
    assert sender.client.delete(photograph["url"]).status_code == 204
    sender.send(CONTENT, name="walk.mp4", digest="")
    assert sender.begin(picture(1)).status_code == 409
    assert sender.begin(video(5), name="another.mov").status_code == 409
    assert [shot["state"] for shot in sender.state()["shots"] if shot["state"] != "refused"] == ["placed"]


@pytest.mark.requirement("R-PHOTO-4")
@pytest.mark.parametrize(
    "data",
    [
        CONTENT[: len(CONTENT) // 2],
        CONTENT[:-100],
        WITHOUT_FRAMES,
        CONTENT[:40],
        b"\0\0\0\x18ftypmp42" + bytes(200),
        b"RIFF" + bytes(4) + b"AVI LIST" + bytes(200),
        b"#EXTM3U\n#EXTINF:1,\nfile:///etc/hostname\n",
    ],
    ids=["half", "end", "without frames", "head", "zeros", "avi", "playlist"],
)
def test_a_file_that_is_no_whole_video_is_refused_and_not_kept(
    sender: Sender, clinic: ClinicConfig, data: bytes
) -> None:
    answer = sent(sender, data, "IMG_0001.MP4")
    assert (answer.status_code, answer.json()["state"]) == (422, "refused")
    assert answer.json()["error"].count("\n") == 0
    assert levels(answer.json()) == {"format": "refuse"}
    assert not list((clinic.folder / "uploads").iterdir())
    assert sender.begin(CONTENT, name="IMG_0001.MP4").status_code == 201


def test_an_interrupted_video_goes_on_without_a_digest(sender: Sender) -> None:
    begun = sender.begin(CONTENT, name="walk.mp4", digest="").json()
    sender.piece(begun["url"], 0, CONTENT[:1000])
    again = sender.begin(CONTENT, name="walk.mp4", digest="")
    assert (again.status_code, again.json()["id"], again.json()["offset"]) == (200, begun["id"], 1000)
    assert sender.begin(video(5) + b"x", name="other.mp4", digest="").status_code == 409


@pytest.mark.requirement("R-PHOTO-4")
def test_the_job_gets_the_video_and_decodes_it_in_the_clinic(
    sender: Sender, walk_visit: Visit, clinic: ClinicConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    sender.send(CONTENT, name="walk.mp4", digest="")
    assert measured_now(sender.client, walk_visit).status_code == 202
    job, arguments = task_of(clinic)
    seen: dict[str, Any] = {}

    def prepared(folder: Path, out: Path, **given: Any) -> None:
        seen.update(files=sorted(path.name for path in folder.iterdir()), scratch=given["scratch"])
        assert (folder / "video.mp4").read_bytes() == CONTENT
        write_prepared(out, left_out={}, pictures=24)

    monkeypatch.setattr(work, "prepare_walk", prepared)
    monkeypatch.setattr(work, "_measured", lambda progress, session, settings: {"digest": "d"})
    work.measure_walk(lambda *now: None, *arguments)
    assert seen["files"] == ["board.toml", "video.mp4"]
    assert seen["scratch"].parent == clinic.folder / "uploads"
    assert not seen["scratch"].exists()
    assert queue.done(job.pk, "me", ANSWER)
    assert not list((clinic.folder / "uploads").iterdir())


@pytest.mark.requirement("R-KEEP-10")
def test_decoded_frames_of_a_killed_job_are_deleted_when_it_has_failed(
    sender: Sender, walk_visit: Visit, clinic: ClinicConfig
) -> None:
    sender.send(CONTENT, name="walk.mp4", digest="")
    measured_now(sender.client, walk_visit)
    job, arguments = task_of(clinic)
    scratch = Path(json.loads(arguments[1])["scratch"])
    (scratch / "frames").mkdir(parents=True)
    (scratch / "frames" / "1.0 s.png").write_bytes(b"face")
    assert queue.failed(job.pk, "me", "It was killed.", 6)
    assert not scratch.exists()
    assert Upload.objects.get().path.is_file()  # for another try


def test_decoded_frames_are_in_no_backup(sender: Sender, clinic: ClinicConfig, tmp_path: Path) -> None:
    sender.send(CONTENT, name="walk.mp4", digest="")
    frames = clinic.folder / "uploads" / "walk-1" / "mammometry-1"
    frames.mkdir(parents=True)
    (frames / "1.0 s.png").write_bytes(b"face")
    make_backup(clinic, tmp_path / "clinic.tar")
    with tarfile.open(tmp_path / "clinic.tar") as archive:
        names = archive.getnames()
    assert f"uploads/{Upload.objects.get().pk}" in names
    assert not [name for name in names if name.endswith(".png")]


@pytest.mark.requirement("R-KEEP-10")
def test_the_page_names_frames_by_their_time(sender: Sender, walk_visit: Visit, clinic: ClinicConfig) -> None:
    sender.send(CONTENT, name="IMG_0001.MOV", digest="")
    times = {f"{number:02d}": f"{number}.5 s" for number in range(1, 25)}
    left = {"07": LeftOut(code="blurred", found="edges blurred by 4 pixels")}
    write_prepared(walk_visit.folder, left_out=left, pictures=24, times=times)
    facts = walks.facts_of(walk_visit)
    assert facts is not None
    assert (facts.is_video, facts.used, facts.pictures) == (True, 23, 24)
    assert [unused.name for unused in facts.left_out] == ["07, 7.5 s"]


@pytest.mark.slow
@pytest.mark.usefixtures("readers_in_a_child")
def test_a_video_is_decoded_in_a_process_of_its_own(sender: Sender) -> None:
    table = sender.send(CONTENT, name="walk.mp4", digest="")
    assert levels(table) == {"format": "ok", "board": "ok"}
    assert sender.client.delete(table["url"]).status_code == 204
    assert sent(sender, CONTENT[:-100], "walk.mp4").status_code == 422


@pytest.mark.slow
@pytest.mark.usefixtures("readers_in_a_child")
def test_a_hanging_decoder_ends_with_its_file(sender: Sender, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(walk_video, "_LONGEST_S", 0.01)
    answer = sent(sender, CONTENT, "walk.mp4")
    assert (answer.status_code, answer.json()["state"]) == (422, "refused")


def test_a_rig_takes_no_video(client_of: Callable[..., Client], visit: Visit) -> None:
    assert places.uploads_of(visit).count() == 0
    begun = Sender(client_of(Role.TECHNICIAN), visit).begin(CONTENT, name="walk.mp4")
    assert begun.status_code == 201
    answer = Sender(client_of(Role.TECHNICIAN), visit).piece(begun.json()["url"], 0, CONTENT)
    assert (answer.status_code, answer.json()["state"]) == (422, "refused")
