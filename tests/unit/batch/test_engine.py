"""Tasks on a real worker of Dask: what they return, how they fail, and what becomes of one that takes a worker down."""

import os
import signal
import threading
import time
from pathlib import Path

import batch_work
import psutil
import pytest

from mammometry.base.child_process import Call
from mammometry.base.errors import BatchError
from mammometry.base.machine.cores import CORES, available_cores
from mammometry.batch import cluster
from mammometry.batch import engine as engine_module
from mammometry.batch.batch import map_tasks_on
from mammometry.batch.cluster import machines
from mammometry.batch.engine import Began, Ended, Engine, StopRequest, Task

KNOWN = [(1.0, 100.0)]  # memory of such tasks is known: none goes first alone


@pytest.fixture(scope="module")
def there():
    """A worker of this machine that takes two tasks at a time."""
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join([str(Path(__file__).parent), *([before] if before else [])])
    with machines(None, cores=2, memory_mb=1000) as found:
        yield found
    os.environ.pop("PYTHONPATH") if before is None else os.environ.update(PYTHONPATH=before)


def task(name, function, *arguments, megapixels=1.0):
    return Task(name=name, call=Call(function=function, arguments=arguments), megapixels=megapixels)


def ended(there, *tasks, known=KNOWN, stop=lambda: StopRequest.NONE):
    events = list(Engine(there, known=known, stop=stop).run(tasks))
    return {event.name: event for event in events if isinstance(event, Ended)}


def test_values_failures_and_defects_come_back_each_under_its_name(there):
    found = ended(
        there,
        task("two", batch_work.square, 2),
        task("three", batch_work.square, 3),
        task("bad", batch_work.fail, 7),
        task("ours", batch_work.stumble),
    )
    assert {name: event.value for name, event in found.items()} == {"two": 4, "three": 9, "bad": None, "ours": None}
    assert found["bad"].failed == "left: found 7, expected another number. Choose one."
    assert (found["bad"].kind, found["bad"].exit_code) == ("MeasureError", 8)
    assert (found["ours"].kind, found["ours"].exit_code) == ("Defect", 70)
    assert "RuntimeError:" in found["ours"].failed
    assert found["two"].memory_mb > 5  # a Python that has imported something
    assert found["two"].host == os.uname().nodename


def test_stages_are_said_while_they_run(there):
    name = os.fsdecode(b"caf\xe9")  # Dask's messages cannot carry it
    events = list(Engine(there, known=KNOWN).run([task(name, batch_work.square, 2)]))
    assert any(isinstance(event, Began) and event.stage == "count" and event.fraction == 0.5 for event in events)
    assert {event.name for event in events} == {name}


def test_a_task_has_its_share_of_the_cores_and_no_more(there):
    names = [CORES, "OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"]
    assert ended(there, task("env", batch_work.environment, names))["env"].value == dict.fromkeys(names, "1")


@pytest.mark.parametrize(("said", "expected"), [("1", 1), ("0", 1), ("many", None), ("", None), ("4096", None)])
def test_cores_are_limited_by_the_environment(monkeypatch, said, expected):
    monkeypatch.delenv(CORES, raising=False)
    whole = available_cores()
    monkeypatch.setenv(CORES, said)
    assert available_cores() == (whole if expected is None else expected)


def test_one_that_dies_once_is_tried_again(there, tmp_path):
    assert ended(there, task("weak", batch_work.die_once, str(tmp_path / "notes")))["weak"].value == "lived"


def test_one_that_dies_twice_is_blamed_and_hinders_none(there, tmp_path):
    notes = tmp_path / "notes"
    found = ended(there, task("bad", batch_work.die, str(notes)), task("two", batch_work.square, 2))
    assert found["two"].value == 4
    assert notes.read_text().count("tried") == 2
    assert found["bad"].kind == "Killed"
    assert "twice" in found["bad"].failed
    assert "signal 9" in found["bad"].failed


@pytest.mark.slow
def test_one_that_takes_more_memory_than_there_is_is_ended_and_blamed_with_its_memory(there, tmp_path):
    notes = tmp_path / "notes"
    begun = time.monotonic()
    found = ended(there, task("large", batch_work.swell, 1300, str(notes)))["large"]
    assert time.monotonic() - begun < 25  # it would sleep for 30 s each time
    assert notes.read_text().count("tried") == 2
    assert found.memory_mb > 1000
    assert "1000 MB" in found.failed


@pytest.mark.slow
def test_a_worker_that_is_killed_loses_nothing(there, tmp_path):
    """Both tasks at work die with it, and are done by its successor."""
    notes = [tmp_path / "a", tmp_path / "b"]

    def kill_worker():
        while not all(path.exists() for path in notes):
            time.sleep(0.05)
        (pid,) = there.client.run(os.getpid).values()
        os.kill(pid, signal.SIGKILL)

    killer = threading.Thread(target=kill_worker)
    killer.start()
    found = ended(there, *(task(path.name, batch_work.wait, 1.5, str(path)) for path in notes))
    killer.join()
    assert {name: event.value for name, event in found.items()} == {"a": 1.5, "b": 1.5}
    for path in notes:
        assert path.read_text().split() == ["began", "began", "ended"]  # the first one's process ended with its worker


@pytest.mark.slow
def test_the_first_of_unknown_memory_goes_alone_and_the_others_learn_from_it(there, tmp_path):
    paths = [tmp_path / name for name in "abc"]
    events = Engine(there).run([task(path.name, batch_work.wait, 0.4, str(path)) for path in paths])
    call = [
        (event.name, type(event).__name__) for event in events if not isinstance(event, Began) or event.stage == "wait"
    ]
    assert call.index(("a", "Ended")) < min(call.index(("b", "Began")), call.index(("c", "Began")))
    assert call.index(("c", "Began")) < max(call.index(("b", "Ended")), call.index(("c", "Ended")))


@pytest.mark.slow
def test_finishing_begins_nothing_new_and_ends_what_runs(there, tmp_path):
    paths = [tmp_path / name for name in "abcdef"]

    def stop():
        return StopRequest.FINISH if any(path.exists() for path in paths) else StopRequest.NONE

    found = ended(there, *(task(path.name, batch_work.wait, 1.0, str(path)) for path in paths), stop=stop)
    begun = [path for path in paths if path.exists()]
    assert 1 <= len(begun) <= 3
    assert all(path.read_text().split() == ["began", "ended"] for path in begun)
    assert set(found) == {path.name for path in begun}


def test_stopping_ends_what_runs(there, tmp_path):
    path = tmp_path / "a"
    begun = time.monotonic()
    found = ended(
        there,
        task("a", batch_work.wait, 20.0, str(path)),
        stop=lambda: StopRequest.STOP if path.exists() else StopRequest.NONE,
    )
    assert time.monotonic() - begun < 15
    assert found == {}
    deadline = time.monotonic() + 5
    while time.monotonic() < deadline and _children_of_worker(there):
        time.sleep(0.1)
    assert not _children_of_worker(there)
    assert path.read_text().split() == ["began"]


@pytest.mark.slow
def test_tasks_are_served_as_they_come_and_one_is_stopped_without_the_others(there, tmp_path):
    """No more are taken than there are cores; what is stopped ends without an event, and its process with it."""
    long, short = tmp_path / "long", [tmp_path / name for name in "abc"]
    waiting = [task("long", batch_work.wait, 30.0, str(long))]
    waiting += [task(path.name, batch_work.wait, 0.2, str(path)) for path in short]
    rooms, found = [], {}

    def claim(room):
        rooms.append(room)
        given, waiting[:] = waiting[:room], waiting[room:]
        return given

    engine = Engine(
        there, known=KNOWN, stop=lambda: StopRequest.FINISH if len(found) == 3 and not waiting else StopRequest.NONE
    )
    for event in engine.serve(claim, lambda: ["long"] if long.exists() and "a" in found else []):
        if isinstance(event, Ended):
            found[event.name] = event
    assert {name: event.value for name, event in found.items()} == dict.fromkeys("abc", 0.2)
    assert max(rooms) == 2
    deadline = time.monotonic() + 5
    while time.monotonic() < deadline and _children_of_worker(there):
        time.sleep(0.1)
    assert not _children_of_worker(there)
    assert long.read_text().split() == ["began"]


def _children_of_worker(there):
    (pid,) = there.client.run(os.getpid).values()
    return [child for child in psutil.Process(pid).children() if _is_child(child)]


def _is_child(process):
    try:
        return "mammometry.base.child_process" in process.cmdline()
    except psutil.NoSuchProcess:  # it ended meanwhile, waited for or not yet
        return False


def test_a_worker_of_another_version_is_refused_by_name(there, monkeypatch):
    other = engine_module.software() | {"results": "000000000000"}
    monkeypatch.setattr(engine_module, "software", lambda: other)
    with pytest.raises(BatchError, match=rf"worker {os.uname().nodename}: found mammometry version .*000000000000\)"):
        ended(there, task("two", batch_work.square, 2))


def test_more_cores_than_a_worker_has_are_refused(there):
    with pytest.raises(BatchError, match=r"\b3 .*\b2\b"):
        list(Engine(there, cores=3, known=KNOWN).run([task("two", batch_work.square, 2)]))


def test_a_loop_gives_each_its_result_and_stops_at_what_fails(there):
    map_tasks = map_tasks_on(there, megapixels=1.0)
    assert map_tasks(batch_work.square, {"two": (2,), "three": (3,)}) == {"two": 4, "three": 9}
    with pytest.raises(BatchError, match=r"^bad: "):
        map_tasks(batch_work.fail, {"bad": (1,)})


@pytest.mark.slow
def test_no_scheduler_is_one_sentence(monkeypatch):
    monkeypatch.setattr(cluster, "_ANSWER_S", 1.0)
    with (
        pytest.raises(BatchError, match=r"tcp://127\.0\.0\.1:9: "),
        machines("tcp://127.0.0.1:9"),
    ):
        pass
