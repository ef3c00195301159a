"""Sessions on other storage: a disk by its address, and a real S3 server."""

import json
import os
import socket
import subprocess
import sys
import time
import urllib.request

import fsspec
import pytest

from mammometry.base.errors import SessionError, StorageError
from mammometry.batch import storage
from mammometry.batch.record import BatchEntry, BatchRow, SessionRecord

ROW = BatchRow(
    session="one",
    subject=None,
    date=None,
    measured=(),
    made_at=None,
    seconds=1.0,
    peak_memory_mb=None,
    megapixels=1.0,
    page="report/report.html",
)
BROUGHT = ("session.toml", "capture/front_left.jpg", "calibration/00/front_left.jpg")


@pytest.fixture(scope="module")
def server():
    """Address of an S3 server of our own."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    process = subprocess.Popen(
        [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    address = f"http://127.0.0.1:{port}"
    for _ in range(200):
        try:
            urllib.request.urlopen(address, timeout=1)
            break
        except OSError:
            time.sleep(0.1)
    yield address
    process.kill()
    process.wait()


@pytest.fixture
def s3(server, monkeypatch):
    """Address of an empty bucket."""
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "nobody")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "nothing")
    monkeypatch.setenv("AWS_ENDPOINT_URL", server)
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    fsspec.filesystem("s3").clear_instance_cache()
    name = f"trial{time.time_ns()}"
    fsspec.filesystem("s3", skip_instance_cache=True).mkdir(name)
    return f"s3://{name}"


@pytest.fixture(params=["file", "file[1]", pytest.param("s3[1]", marks=pytest.mark.slow)])
def address(request, tmp_path):
    """Address of a session on either storage. Brackets and stars in an address are no pattern."""
    kind, brackets, _ = request.param.partition("[1]")
    base = f"file://{tmp_path}/there" if kind == "file" else request.getfixturevalue("s3")
    base += "/P[1]*" if brackets else ""
    system, root = fsspec.core.url_to_fs(base)
    for name in BROUGHT:
        system.makedirs(f"{root}/trial/one/{name}".rpartition("/")[0], exist_ok=True)
        system.pipe_file(f"{root}/trial/one/{name}", name.encode())
    return f"{base}/trial/one"


def result(folder, text):
    """Results of a run, with a record of what was fetched."""
    (folder / "measure").mkdir(parents=True, exist_ok=True)
    (folder / "measure" / "volumes.json").write_text(text)
    (folder / ".lock").write_text("")
    return folder


def record_into(folder, entry, key="k"):
    record = SessionRecord(key=key, files=storage.stats(entry), row=ROW)
    (folder / "batch.json").write_text(record.model_dump_json())
    return record.digest


def content(entry, name):
    return storage.read(f"{storage.results_of(entry)}/{name}")


def test_sessions_are_found_there_and_below(address):
    assert storage.sessions_at(address) == [address]
    assert storage.sessions_at(address.rpartition("/")[0]) == [address]
    with pytest.raises(SessionError, match=r"session\.toml"):
        storage.sessions_at(f"{address}/capture")


def test_a_session_is_fetched_and_its_results_come_back(address, tmp_path):
    entry = BatchEntry(address=address)
    there = storage.fetch(entry, tmp_path / "one")
    assert sorted(there) == sorted(BROUGHT)
    assert {name: (tmp_path / "one" / name).read_text() for name in BROUGHT} == {name: name for name in BROUGHT}
    assert storage.look_up(entry, "k") == (None, False)
    results = result(tmp_path / "one" / "results", "1")
    storage.put(entry, results, record_into(results, entry))
    assert content(entry, "measure/volumes.json") == b"1"
    assert storage.look_up(entry, "k") == (ROW, True)
    assert storage.look_up(entry, "other") == (ROW, False)
    assert not any(".lock" in name for name in storage.stats(entry))
    # a second run has the former results at hand, so that it makes only what has changed
    storage.fetch(entry, tmp_path / "again")
    assert (tmp_path / "again" / "results" / "measure" / "volumes.json").read_text() == "1"


def test_what_people_change_there_makes_it_stale(address, tmp_path):
    entry = BatchEntry(address=address)
    results = result(tmp_path / "results", "1")
    storage.put(entry, results, record_into(results, entry))
    system, root = fsspec.core.url_to_fs(address)
    time.sleep(0.01)
    system.pipe_file(f"{root}/capture/front_left.jpg", b"CAPTURE/front_left.jpg")
    assert storage.look_up(entry, "k") == (ROW, False)


def test_results_are_put_back_whole_or_not_at_all(address, tmp_path, monkeypatch):
    """However far the putting came when it was cut off, the former results are there, whole."""
    entry = BatchEntry(address=address)
    first = result(tmp_path / "first", "1")
    storage.put(entry, first, record_into(first, entry))
    second = result(tmp_path / "second", "2")
    digest = record_into(second, entry, key="l")
    system, _ = fsspec.core.url_to_fs(address)
    put, calls = system.put_file, []

    def torn(*arguments, **options):
        calls.append(1)
        if len(calls) == 2:
            raise OSError("the line was cut")
        return put(*arguments, **options)

    def unreplaced(*_):
        raise OSError("the line was cut")

    for owner, name, cut in ((system, "put_file", torn), (storage, "_replace", unreplaced)):
        with monkeypatch.context() as patch:
            patch.setattr(owner, name, cut)
            with pytest.raises(StorageError, match="the line was cut"):
                storage.put(entry, second, digest)
        assert content(entry, "measure/volumes.json") == b"1"
        assert storage.look_up(entry, "k") == (ROW, True)
    storage.put(entry, second, digest)
    assert content(entry, "measure/volumes.json") == b"2"
    listed = [path.rpartition("/")[2] for path in system.ls(address.partition("//")[2], detail=False)]
    assert sum(name.startswith("results-") for name in listed) == 1  # former ones are removed


def test_results_go_elsewhere_where_that_is_wanted(address, tmp_path):
    entry = BatchEntry(address=address, results=str(tmp_path / "out" / "one"))
    results = result(tmp_path / "results", "1")
    storage.put(entry, results, record_into(results, entry))
    assert storage.look_up(entry, "k") == (ROW, True)
    pointer = json.loads((tmp_path / "out" / "one" / "results.json").read_text())
    assert (tmp_path / "out" / "one" / pointer["results"] / "measure" / "volumes.json").read_text() == "1"


@pytest.mark.parametrize("address", ["file"], indirect=True)  # a pointer is read alike on either
@pytest.mark.parametrize(
    "text", ["", "[]", '{"results": "../../other"}', '{"results": 5}', '{"results": "results-/../.."}']
)
def test_a_pointer_of_somebody_else_points_nowhere(address, text):
    system, root = fsspec.core.url_to_fs(address)
    system.pipe_file(f"{root}/results.json", text.encode())
    assert storage.results_of(BatchEntry(address=address)) is None


def test_storage_that_is_not_there_is_one_sentence(s3):
    with pytest.raises((StorageError, SessionError), match="s3://no-such-bucket-here"):
        storage.sessions_at("s3://no-such-bucket-here/trial")
    with pytest.raises(StorageError, match="storage"):
        storage.sessions_at("nonsense://somewhere/trial")
    assert os.environ["AWS_ENDPOINT_URL"]
