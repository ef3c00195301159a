"""The clinic's server is killed, as by kill −9 or a power cut: no upload and no job is lost, and none is done twice."""

import http.client
import json
import os
import signal
import sqlite3
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import closing
from hashlib import sha256
from pathlib import Path
from typing import Any

import psutil
import pytest
from tests import orthanc
from tests.clinic_server import command, served
from tests.scenes.conftest import *  # noqa: F403  # the tiny session's fixtures
from tests.scenes.conftest import TINY_SETTINGS

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("clinic-killed")]
_FILLER = Path(__file__).resolve().parents[1] / "clinic_filled.py"
_WAIT_S = 600.0  # for a job on a machine that does much else


def filled(folder: Path, *what: str) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, str(_FILLER), str(folder), *what], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    answer: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return answer


def until(said: Callable[[], bool], what: str, wait_s: float = _WAIT_S) -> None:
    end = time.monotonic() + wait_s
    while not said():
        assert time.monotonic() < end, f"waited for {what}"
        time.sleep(0.3)


@pytest.fixture
def clinic_folder(tmp_path: Path) -> Path:
    folder = tmp_path / "clinic"
    command("init", str(folder))
    text = (folder / "clinic.toml").read_text().replace('second_factor = "required"', 'second_factor = "offered"')
    (folder / "clinic.toml").write_text(text)
    (folder / "settings.toml").write_text(TINY_SETTINGS)
    return folder


def job_of(folder: Path, key: str) -> dict[str, Any]:
    return next(row for row in rows_of(folder, "job") if row["id"] == key.replace("-", ""))


def rows_of(folder: Path, table: str) -> list[dict[str, Any]]:
    """Read beside the server and without Django, whose start would take a core from the job that is waited for."""
    with closing(sqlite3.connect(folder / "clinic.sqlite3", timeout=60)) as database:
        database.row_factory = sqlite3.Row
        return [dict(row) for row in database.execute(f"SELECT * FROM clinic_{table}")]


def sending_job(folder: Path) -> dict[str, Any]:
    return next(row for row in rows_of(folder, "job") if row["kind"] == "send")


def test_a_server_killed_during_a_job_takes_all_its_processes_and_loses_nothing(
    clinic_folder: Path, tiny_original: Path, tiny_demo: dict[str, Any]
) -> None:
    with served(clinic_folder) as (_, server):
        calibrating = filled(clinic_folder, "calibrate", str(tiny_original))["job"]
        until(lambda: job_of(clinic_folder, calibrating)["state"] in ("done", "failed"), "the calibration")
        assert job_of(clinic_folder, calibrating)["state"] == "done", job_of(clinic_folder, calibrating)
        measuring = filled(clinic_folder, "measure", str(tiny_original))["job"]
        until(lambda: job_of(clinic_folder, measuring)["stage"] in ("match", "surface"), "work")
        family = psutil.Process(server.pid).children(recursive=True)
        assert len(family) >= 3  # the runner, Dask's worker, the process that measures
        os.kill(server.pid, signal.SIGKILL)
        server.wait()
        _, alive = psutil.wait_procs(family, timeout=30)
        assert not alive
    assert job_of(clinic_folder, measuring)["state"] == "running"  # nobody could write that it was not
    with served(clinic_folder):
        until(lambda: job_of(clinic_folder, measuring)["state"] in ("done", "failed"), "the measurement")
    told = filled(clinic_folder, "tell")
    job = next(each for each in told["jobs"] if each["id"] == measuring)
    assert (job["state"], job["attempt"], job["message"]) == ("done", 2, "")
    assert told["measurements"] == 1
    ((side, definition, volume_cc),) = told["volumes"]
    assert (side, definition) == ("model", "closed solid")
    # What a run comes to that nobody interrupts; its manifest tells the radius of the rim, too, which is .2 % of it.
    assert volume_cc == pytest.approx(tiny_demo["volumes_cc"]["model"], rel=0.005)


@pytest.mark.skipif(orthanc.program() is None, reason=orthanc.ABSENT)
def test_a_running_server_sends_what_is_due_when_the_archive_is_there_again(
    clinic_folder: Path, tiny_original: Path, tmp_path: Path
) -> None:
    """The archive is down when the visit is sent, and there a minute later: nobody does anything."""
    (tmp_path / "archive").mkdir()
    archive = orthanc.Orthanc(folder=tmp_path / "archive", dicom=orthanc.free_port(), http=orthanc.free_port())
    try:
        with served(clinic_folder):
            for what in ("calibrate", "measure"):
                job = filled(clinic_folder, what, str(tiny_original))["job"]
                until(lambda job=job: job_of(clinic_folder, job)["state"] in ("done", "failed"), what)  # type: ignore[misc]
                assert job_of(clinic_folder, job)["state"] == "done", job_of(clinic_folder, job)
            filled(clinic_folder, "send", archive.peer)
            until(lambda: sending_job(clinic_folder)["message"] != "", "the end of the first try")
            assert (sending_job(clinic_folder)["attempt"], sending_job(clinic_folder)["state"]) == (1, "queued")
            assert "no answer" in sending_job(clinic_folder)["message"]
            archive.start()
            until(lambda: rows_of(clinic_folder, "delivery")[0]["state"] == "sent", "the second try")
        assert (sending_job(clinic_folder)["attempt"], sending_job(clinic_folder)["state"]) == (2, "done")
        (sent,) = rows_of(clinic_folder, "delivery")
        assert sent["message"] == ""
        assert len(archive.instances()) == sent["sent"] > 0
    finally:
        archive.stop()


class Browser:
    """A person who is logged in."""

    def __init__(self, address: str, cookies: dict[str, str]) -> None:
        self._connection = http.client.HTTPConnection(address, timeout=120)
        self._headers = {
            "Cookie": "; ".join(f"{name}={value}" for name, value in cookies.items()),
            "X-CSRFToken": cookies["clinic-csrf"],
            "Accept": "application/json",
        }

    def ask(self, method: str, path: str, body: bytes = b"", **headers: str) -> tuple[int, dict[str, Any]]:
        more = {name.replace("_", "-"): value for name, value in headers.items()}
        self._connection.request(method, path, body or None, {**self._headers, **more})
        answer = self._connection.getresponse()
        content = answer.read()
        return answer.status, json.loads(content) if content.startswith(b"{") else {
            "text": content.decode(errors="replace")[:300]
        }

    def close(self) -> None:
        self._connection.close()


def test_a_server_killed_during_an_upload_goes_on_where_it_ended(clinic_folder: Path, tiny_original: Path) -> None:
    told = filled(clinic_folder, "photograph", str(tiny_original))
    data = (tiny_original / "capture" / "front_left.jpg").read_bytes()
    half = len(data) // 2
    begin = {
        "for": "visit", "id": told["visit"], "name": "front_left.jpg", "camera": None, "size_bytes": len(data),
        "sha256": sha256(data).hexdigest(),
    }  # fmt: skip
    with served(clinic_folder, "--no-jobs") as (address, server), closing(Browser(address, told["cookies"])) as browser:
        status, upload = browser.ask("POST", "/uploads/", json.dumps(begin).encode(), Content_Type="application/json")
        assert status == 201, upload
        status, answer = browser.ask("PATCH", upload["url"], data[:half], Upload_Offset="0")
        assert (status, answer["offset"]) == (200, half)
        os.kill(server.pid, signal.SIGKILL)
        server.wait()
    with served(clinic_folder, "--no-jobs") as (address, _), closing(Browser(address, told["cookies"])) as browser:
        status, answer = browser.ask("GET", upload["url"])
        assert (status, answer["offset"]) == (200, half)
        status, answer = browser.ask("PATCH", upload["url"], data[half:], Upload_Offset=str(half))
        assert (status, answer["state"]) == (200, "placed"), answer
    placed = clinic_folder / "sessions" / told["visit"] / "capture" / "front_left.jpg"
    assert placed.read_bytes() == data


def sent(browser: Browser, target: str, key: str, path: Path, *, pose: str = "", half: bool = False) -> dict[str, Any]:
    """Upload one photograph, or its first half; goes on where a former try ended."""
    data = path.read_bytes()
    about = {
        "for": target, "id": key, "name": path.name, "camera": path.stem, "pose": pose, "size_bytes": len(data),
        "sha256": sha256(data).hexdigest(),
    }  # fmt: skip
    status, upload = browser.ask("POST", "/uploads/", json.dumps(about).encode(), Content_Type="application/json")
    assert status in (200, 201), upload
    if upload["state"] == "receiving":
        begin = upload["offset"]
        piece = data[begin : len(data) // 2] if half else data[begin:]
        status, upload = browser.ask("PATCH", upload["url"], piece, Upload_Offset=str(begin))
        assert status == 200, upload
    assert upload["state"] == ("receiving" if half else "placed"), upload
    return upload


def test_a_rigs_day_is_whole_although_the_server_is_killed_thrice(clinic_folder: Path, tiny_original: Path) -> None:
    """Calibration and daily check by HTTP alone: photographs of the board, jobs, verdicts, chart of drift."""
    told = filled(clinic_folder, "rig", str(tiny_original))
    rig, cookies = f"/rigs/{told['rig']}/", told["cookies"]
    poses = sorted((tiny_original / "calibration").iterdir())
    # The first pose is kept for the check, which takes no photographs of the calibration's own.
    boards = [(path, pose.name) for pose in poses[1:] for path in sorted(pose.glob("*.jpg"))]

    def asked(browser: Browser, path: str, method: str = "GET", *, status: int = 200) -> dict[str, Any]:
        got, answer = browser.ask(method, path, b"{}" if method == "POST" else b"")
        assert got == status, answer
        return answer

    def killed(server: "subprocess.Popen[bytes]") -> None:
        family = psutil.Process(server.pid).children(recursive=True)
        os.kill(server.pid, signal.SIGKILL)
        server.wait()
        assert not psutil.wait_procs(family, timeout=30)[1]

    with served(clinic_folder, "--no-jobs") as (address, server), closing(Browser(address, cookies)) as browser:
        assert asked(browser, f"{rig}today/")["verdict"] == "no"
        key = asked(browser, f"{rig}calibrations/", "POST", status=201)["id"]
        for path, pose in boards[:5]:
            sent(browser, "calibration", key, path, pose=pose)
        sent(browser, "calibration", key, boards[5][0], pose=boards[5][1], half=True)
        killed(server)
    with served(clinic_folder) as (address, server), closing(Browser(address, cookies)) as browser:
        there = asked(browser, f"/calibrations/{key}/uploads/")["poses"]
        assert sum(upload is not None for cameras in there.values() for upload in cameras.values()) >= 5
        for path, pose in boards:
            sent(browser, "calibration", key, path, pose=pose)
        job = asked(browser, f"/calibrations/{key}/run/", "POST", status=202)["id"]
        until(lambda: asked(browser, f"/jobs/{job}/")["stage"] == "calibrate", "work")
        killed(server)
    with served(clinic_folder) as (address, server), closing(Browser(address, cookies)) as browser:
        until(lambda: asked(browser, f"/jobs/{job}/")["state"] in ("done", "failed"), "the calibration")
        done = asked(browser, f"/jobs/{job}/")
        assert (done["state"], done["attempt"]) == ("done", 2), done["message"]
        assert asked(browser, f"{rig}today/")["verdict"] in ("yes", "care")  # calibrated today, and not yet checked
        asked(browser, f"{rig}drift.png", status=404)
        check = asked(browser, f"{rig}checks/", "POST", status=201)["id"]
        for path in sorted(poses[0].glob("*.jpg")):
            sent(browser, "check", check, path)
        job = asked(browser, f"/checks/{check}/run/", "POST", status=202)["id"]
        until(lambda: asked(browser, f"/jobs/{job}/")["state"] in ("running", "done"), "work")
        killed(server)
    with served(clinic_folder) as (address, _), closing(Browser(address, cookies)) as browser:
        until(lambda: asked(browser, f"/jobs/{job}/")["state"] in ("done", "failed"), "the check")
        assert asked(browser, f"/jobs/{job}/")["state"] == "done"
        assert (
            asked(browser, f"{rig}today/")["verdict"] != "no"
        )  # "care": so few poses calibrate this rig with a warning
        assert "PNG" in asked(browser, f"{rig}drift.png")["text"]
        placed = clinic_folder / filled(clinic_folder, "tell")["calibrations"][0] / "calibration"
    for path, pose in boards:
        assert (placed / pose / path.name).read_bytes() == path.read_bytes()
    told = filled(clinic_folder, "tell")
    assert [job["state"] for job in told["jobs"]] == ["done", "done"]
    (checked,) = told["checks"]
    assert checked["passed"], checked  # judged once: one check, one entry of the history
    history = [line for line in next(placed.parent.rglob("history.jsonl")).read_text().splitlines() if line.strip()]
    assert len(history) == 1


_PEOPLE, _VISITS, _LOOKS = 50, 200, 4
_MEDIAN_S = 0.3
_READS_S = 2.0  # somebody looks at each page for so long, which is hasty


def test_fifty_people_queue_two_hundred_visits(
    clinic_folder: Path, tiny_original: Path, record_property: Callable[[str, object], None]
) -> None:
    """Bounded: loopback, 50 people, 4 visits each, 4 looks a visit: 1000 requests in all."""
    told = filled(clinic_folder, "load", f"{_PEOPLE},{_VISITS}", str(tiny_original))
    taken: list[float] = []
    wrong: list[object] = []
    text = (clinic_folder / "clinic.toml").read_text()
    (clinic_folder / "clinic.toml").write_text(text + "\n[limits]\nrequests_per_second = 100000\n")

    def person(address: str, number: int) -> None:
        try:
            with closing(Browser(address, told["cookies"][number])) as browser:
                for visit in told["visits"][number::_PEOPLE]:
                    asked = [("POST", f"/visits/{visit}/measure/"), *[("GET", f"/visits/{visit}/uploads/")] * 2]
                    asked += [("GET", "/")] * (_LOOKS - 2)
                    for method, path in asked:
                        begun = time.monotonic()
                        status, answer = browser.ask(method, path, b"{}" if method == "POST" else b"")
                        taken.append(time.monotonic() - begun)
                        if status not in (200, 202):
                            wrong.append((status, path, answer))
                        time.sleep(_READS_S)
        except Exception as error:
            wrong.append(error)

    with served(clinic_folder, "--no-jobs") as (address, _):
        people = [threading.Thread(target=person, args=(address, number)) for number in range(_PEOPLE)]
        for each in people:
            each.start()
        for each in people:
            each.join()
    assert not wrong, wrong[:3]
    jobs = filled(clinic_folder, "tell")["jobs"]
    assert len(jobs) == _VISITS
    assert {job["state"] for job in jobs} == {"queued"}
    slow = f"median {statistics.median(taken):.3f} s, 95 % within {statistics.quantiles(taken, n=20)[-1]:.3f} s"
    record_property("answers", slow)
    assert statistics.median(taken) < _MEDIAN_S, slow
