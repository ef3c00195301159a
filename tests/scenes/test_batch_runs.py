"""Batches of real sessions: on this machine, on a cluster of two processes, and with everything that can die dying.

After dask's own tests of chaos, failed workers and workers' memory: nothing is lost, and products are the same bytes.
"""

import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import psutil
import pytest
from playwright.sync_api import sync_playwright
from tests.patience import patient

from mammometry.cli import main
from mammometry.io.results.verify import verify

pytestmark = pytest.mark.slow
SAME = ("calibrate/cameras.json", "surface/mesh.ply", "measure/measurement.json", "measure/model.ply")
CHROMIUM = shutil.which("chromium")


def archive(folder: Path, finished: Path, count: int, *stages: str) -> list[Path]:
    """Sessions that lack the results of some stages."""
    sessions = []
    for number in range(count):
        session = folder / f"s{number:02}"
        shutil.copytree(finished, session)
        for stage in stages:
            shutil.rmtree(session / "results" / stage)
        sessions.append(session)
    return sessions


def contents(session: Path) -> dict[str, bytes]:
    """Products that hold no moment of their making."""
    results = session / "results"
    return {name: (results / name).read_bytes() for name in SAME if (results / name).is_file()}


def lines(text: str) -> list[dict]:
    return [json.loads(line) for line in text.splitlines() if line.startswith("{")]


def started(*arguments: object, **options: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "mammometry", "batch", *map(str, arguments), "--json"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)  # type: ignore[call-overload]


def ran(*arguments: object) -> tuple[int, list[dict]]:
    process = started(*arguments)
    out, err = process.communicate(timeout=600)
    assert "KilledWorker" not in out + err
    assert "Traceback" not in err, err
    return process.returncode, lines(out)


@pytest.fixture
def place(tmp_path: Path, tiny_settings: Path) -> Path:
    shutil.copy(tiny_settings, tmp_path / "tiny.toml")
    return tmp_path


def test_a_batch_measures_says_what_fails_and_resumes(place: Path, tiny_finished_original: Path) -> None:
    sessions = archive(place / "archive", tiny_finished_original, 3, "measure", "report")
    shutil.rmtree(sessions[1] / "capture")
    table = place / "study.csv"
    table.write_text("session,reference_cc\n" + "".join(f"archive/{each.name},426.4\n" for each in sessions))
    common = (table, "--settings", place / "tiny.toml", "--out", place / "out")
    code, said = ran(*common)
    assert code == 11
    assert {event["event"] for event in said[:-1]} == {"begin", "stage", "ended"}
    answer = said[-1]
    assert (answer["measured"], answer["failed"], answer["current"]) == (2, 1, 0)
    assert "capture" in answer["failures"][str(sessions[1])]
    for each in (sessions[0], sessions[2]):
        assert contents(each) == contents(tiny_finished_original)
        assert not verify(each / "results").damaged
    rows = (place / "out" / "batch.csv").read_text().splitlines()
    assert len(rows) == 4
    assert re.search(r"s00,.*,measured,model,\d+\.\d+,.*,426\.4", rows[1])

    begun = time.monotonic()
    code, said = ran(*common)
    assert (code, said[-1]["current"], said[-1]["measured"]) == (11, 2, 0)
    assert time.monotonic() - begun < 60

    shutil.copytree(tiny_finished_original / "capture", sessions[1] / "capture")
    (sessions[0] / "session.toml").write_text((sessions[0] / "session.toml").read_text() + "\n# looked at\n")
    code, said = ran(*common)
    assert (code, said[-1]["current"], said[-1]["measured"]) == (0, 1, 2)
    code, said = ran(*common)
    assert (code, said[-1]["current"]) == (0, 3)
    assert "begin" not in {event.get("event") for event in said}  # no worker was started


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
def test_the_page_sorts_and_shows_agreement(place: Path, tiny_finished_original: Path) -> None:
    sessions = archive(place / "archive", tiny_finished_original, 3)
    table = place / "study.csv"
    values = (430.0, 400.0, 460.0)
    table.write_text(
        "session,reference_cc\n"
        + "".join(f"archive/{each.name},{value}\n" for each, value in zip(sessions, values, strict=True))
    )
    assert ran(table, "--settings", place / "tiny.toml", "--out", place / "out")[0] == 0
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--disable-background-networking"]
        )
        page = patient(browser.new_page())
        page.goto((place / "out" / "batch.html").as_uri())
        names = "[...document.querySelectorAll('#sessions tbody th')].map(each => each.dataset.key)"
        first = page.evaluate(names)
        page.get_by_role("button", name="Session").click()
        assert page.evaluate(names) == sorted(first)
        page.get_by_role("button", name="Session").click()
        assert page.evaluate(names) == sorted(first, reverse=True)
        assert page.locator("#sessions img").count() == 3
        assert page.get_by_text("Agreement with the reference").is_visible()
        assert page.evaluate("document.querySelector('#sessions img').naturalWidth") > 50
        browser.close()


def test_workers_and_processes_killed_at_random_lose_nothing(place: Path, tiny_finished_original: Path) -> None:
    """Twenty sessions while every few seconds a worker, or the process of a session, is killed."""
    sessions = archive(place / "archive", tiny_finished_original, 20, "measure", "report")
    process = started(place / "archive", "--settings", place / "tiny.toml", "--out", place / "out", "--at-once", 2)
    chance, over, killed = random.Random(5), threading.Event(), []

    def kill() -> None:
        while not over.wait(chance.uniform(4.0, 9.0)) and len(killed) < 8:
            family = psutil.Process(process.pid).children(recursive=True)
            children = [each for each in family if "mammometry.base.child_process" in _command(each)]
            workers = [each.parent() for each in children]
            prey = chance.choice([*children, *workers[:1]]) if children else None
            if prey is not None:
                killed.append(_command(prey))
                prey.kill()

    killer = threading.Thread(target=kill)
    killer.start()
    out, err = process.communicate(timeout=900)
    over.set()
    killer.join()
    assert len(killed) >= 4
    assert "KilledWorker" not in out + err
    answer = lines(out)[-1]
    # Whoever was hit twice by chance is blamed, by name; a second batch measures it.
    assert all("twice" in said for said in answer["failures"].values())
    code, said = ran(place / "archive", "--settings", place / "tiny.toml", "--out", place / "out")
    assert (code, said[-1]["measured"] + said[-1]["current"]) == (0, 20)
    for each in sessions:
        assert contents(each) == contents(tiny_finished_original)
        assert not verify(each / "results").damaged


def _command(process: psutil.Process) -> list[str]:
    try:
        return process.cmdline()
    except psutil.Error:
        return []


def test_a_killed_client_leaves_no_process_and_loses_nothing(place: Path, tiny_finished_original: Path) -> None:
    sessions = archive(place / "archive", tiny_finished_original, 4, "measure", "report")
    common = (place / "archive", "--settings", place / "tiny.toml", "--out", place / "out")
    process = started(*common)
    assert process.stdout is not None
    for line in process.stdout:
        if json.loads(line).get("stage") == "measure":
            break
    family = psutil.Process(process.pid).children(recursive=True)
    process.kill()
    process.communicate()
    gone, alive = psutil.wait_procs(family, timeout=20)
    assert not alive
    assert gone
    code, said = ran(*common)
    assert (code, said[-1]["measured"] + said[-1]["current"]) == (0, 4)
    for each in sessions:
        assert contents(each) == contents(tiny_finished_original)


def test_ctrl_c_finishes_what_runs_and_twice_stops_it(place: Path, tiny_finished_original: Path) -> None:
    archive(place / "archive", tiny_finished_original, 4, "measure", "report")
    common = (place / "archive", "--settings", place / "tiny.toml", "--out", place / "out", "--at-once", 1)
    for presses, finished in ((2, 0), (1, 1)):
        process = started(*common, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler))
        assert process.stdout is not None
        for line in process.stdout:
            if json.loads(line).get("stage") == "measure":
                break
        for _ in range(presses):
            process.send_signal(signal.SIGINT)
            time.sleep(0.5)
        out, err = process.communicate(timeout=120)
        answer = lines(out)[-1]
        assert process.returncode == 130, err
        assert answer["measured"] == finished
        assert answer["stopped"] == 4 - finished
        assert answer["failed"] == 0
    code, said = ran(*common)
    assert (code, said[-1]["measured"], said[-1]["current"]) == (0, 3, 1)


def test_the_same_sessions_twice_at_once_are_each_measured_well(place: Path, tiny_finished_original: Path) -> None:
    sessions = archive(place / "archive", tiny_finished_original, 2, "measure", "report")
    both = [
        started(place / "archive", "--settings", place / "tiny.toml", "--out", place / f"out{number}")
        for number in range(2)
    ]
    for process in both:
        out, err = process.communicate(timeout=600)
        assert process.returncode == 0, out + err
    for each in sessions:
        assert contents(each) == contents(tiny_finished_original)
        assert not verify(each / "results").damaged


@pytest.fixture
def cluster():
    """A scheduler and a worker as processes of their own; a function that starts another worker."""
    processes: list[subprocess.Popen[bytes]] = []

    def start(*command: str) -> subprocess.Popen[bytes]:
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        process = subprocess.Popen([sys.executable, "-m", "distributed.cli.dask_" + command[0], *command[1:]], **quiet)
        processes.append(process)
        return process

    port = random.Random(os.getpid()).randint(20000, 40000)
    address = f"tcp://127.0.0.1:{port}"
    scheduler = start("scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard")
    start("worker", address, "--nthreads", "2", "--no-dashboard")
    yield address, scheduler, start
    for process in processes:
        for each in [*psutil.Process(process.pid).children(recursive=True), process] if process.poll() is None else []:
            each.kill()
        process.wait()


def test_a_cluster_of_processes_and_its_scheduler_dies(place: Path, tiny_finished_original: Path, cluster) -> None:
    address, scheduler, start = cluster
    sessions = archive(place / "archive", tiny_finished_original, 3, "measure", "report")
    common = (place / "archive", "--settings", place / "tiny.toml", "--out", place / "out", "--scheduler", address)
    process = started(*common)
    assert process.stdout is not None
    for line in process.stdout:
        if json.loads(line).get("event") == "ended":
            break
    for each in psutil.Process(scheduler.pid).children(recursive=True):
        each.kill()
    scheduler.kill()
    out, err = process.communicate(timeout=180)
    answer = lines(out)[-1]
    assert process.returncode == 9, (answer, err)
    assert "scheduler" in answer["error"]
    port = address.rpartition(":")[2]
    start("scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard")
    start("worker", address, "--nthreads", "2", "--no-dashboard")
    code, said = ran(*common)
    assert code == 0
    assert said[-1]["current"] >= 1  # what was finished before is kept
    for each in sessions:
        assert contents(each) == contents(tiny_finished_original)


def test_a_full_disk_is_one_sessions_sentence(place: Path, tiny_finished_original: Path) -> None:
    sessions = archive(place / "archive", tiny_finished_original, 2, "measure", "report")
    results = sessions[0] / "results"
    used = sum(-(-path.stat().st_size // 4096) * 4 for path in results.rglob("*")) + 64
    kept = place / "kept"
    shutil.move(results, kept)
    results.mkdir()
    script = (
        f"mount -t tmpfs -o size={used}k none {results} && cp -a {kept}/. {results} && "
        f"{sys.executable} -m mammometry batch {place / 'archive'} --settings {place / 'tiny.toml'} "
        f"--out {place / 'out'} --json"
    )
    done = subprocess.run(["unshare", "-rm", "sh", "-c", script], capture_output=True, text=True)
    if "mount" in done.stderr and not done.stdout:
        pytest.skip("mounting a small disk is not permitted here")
    answer = lines(done.stdout)[-1]
    assert done.returncode == 11, done.stderr
    assert answer["measured"] == 1
    assert "no room to write" in answer["failures"][str(sessions[0])]


def test_sessions_on_s3_are_measured_there(place: Path, tiny_finished_original: Path, monkeypatch) -> None:
    """Twice: the second batch finds them current by the storage's own tags."""
    import socket

    import fsspec

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = subprocess.Popen(
        [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        for name, value in {
            "AWS_ACCESS_KEY_ID": "nobody",
            "AWS_SECRET_ACCESS_KEY": "nothing",
            "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}",
            "AWS_DEFAULT_REGION": "us-east-1",
        }.items():
            monkeypatch.setenv(name, value)
        system = fsspec.filesystem("s3", skip_instance_cache=True)
        for _ in range(100):
            try:
                system.mkdir("trial")
                break
            except Exception:  # it is not listening yet
                time.sleep(0.1)
        for path in sorted(tiny_finished_original.rglob("*")):
            name = path.relative_to(tiny_finished_original)
            if path.is_file() and name.parts[0] in ("capture", "calibration", "session.toml"):
                system.put_file(str(path), f"trial/one/{name.as_posix()}")
        common = ("s3://trial", "--settings", place / "tiny.toml", "--out", place / "out")
        code, said = ran(*common)
        assert (code, said[-1]["measured"]) == (0, 1)
        pointer = json.loads(system.cat_file("trial/one/results.json"))["results"]
        for name in SAME:
            assert (
                system.cat_file(f"trial/one/{pointer}/{name}")
                == (tiny_finished_original / "results" / name).read_bytes()
            )
        code, said = ran(*common)
        assert (code, said[-1]["current"]) == (0, 1)
    finally:
        server.kill()
        server.wait()


def test_the_command_line_is_the_same_here(place: Path, tiny_finished: Path, capsys) -> None:
    """In this process, so that what it prints can be read: no session, a wrong setting, a folder that it reads."""
    assert main.run(["batch", str(place / "none"), "--json"]) == 3
    assert "no such folder" in json.loads(capsys.readouterr().out)["error"]
    assert main.run(["batch", str(tiny_finished), "--set", "measure.wal=plane", "--json"]) == 3
    assert "measure.wal" in json.loads(capsys.readouterr().out)["error"]
    assert main.run(["batch", str(tiny_finished), "--out", str(tiny_finished), "--json"]) == 9
    assert "this command reads" in json.loads(capsys.readouterr().out)["error"]
