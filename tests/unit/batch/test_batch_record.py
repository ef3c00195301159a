"""A session is current while its files have the sizes and times that its record names, and settings are the same."""

import os
import shutil
import time

import pytest

from mammometry.base.notices import Notice
from mammometry.batch.record import (
    BatchRow,
    Measured,
    SessionRecord,
    key_of,
    look_up,
    need_mb,
    read_record,
    stats_of,
    write_record,
)
from mammometry.settings import Settings

ROW = BatchRow(
    session="one",
    subject="P-17",
    date="2026-11-22",
    measured=(Measured(name="left", volume_cc=512.25, interval_cc=(500.0, 530.5)),),
    no_breast={"right": "flat"},
    notices=(Notice(code="head-not-shown", about=("model",)),),
    made_at="2026-11-22T10:00:00+00:00",
    seconds=12.5,
    peak_memory_mb=900.0,
    megapixels=8.5,
    page="report/report.html",
)


@pytest.fixture
def session(tmp_path):
    folder = tmp_path / "one"
    for name in ("session.toml", "capture/front_left.jpg", "results/measure/provenance.json"):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(name)
    write_record(folder, SessionRecord(key="k", files=stats_of(folder), row=ROW))
    return folder


def test_what_nobody_touched_is_current(session):
    assert look_up(session, "k") == (ROW, True)


def test_hidden_files_do_not_count(session):
    (session / "results" / ".lock").write_text("")
    (session / ".DS_Store").write_text("")
    assert look_up(session, "k") == (ROW, True)


def _rewrite(session):
    path = session / "capture" / "front_left.jpg"
    about = path.stat()
    path.write_text("capture/front_LEFT.jpg")  # as long as before
    os.utime(path, ns=(about.st_atime_ns, about.st_mtime_ns + 1))


def _exchange(session):
    """As a program that copies does: size and time are kept."""
    path = session / "capture" / "front_left.jpg"
    about = path.stat()
    other = session.parent / "other.jpg"
    other.write_text("capture/front_LEFT.jpg")
    os.utime(other, ns=(about.st_atime_ns, about.st_mtime_ns))
    shutil.copy2(other, path)
    assert (path.stat().st_size, path.stat().st_mtime_ns) == (about.st_size, about.st_mtime_ns)


@pytest.mark.parametrize(
    "change",
    [
        _rewrite,
        _exchange,
        lambda session: (session / "capture" / "front_left.jpg").write_text("longer than it was"),
        lambda session: (session / "capture" / "front_left.jpg").unlink(),
        lambda session: (session / "capture" / "front_right.jpg").write_text("new"),
        lambda session: (session / "results" / "measure" / "provenance.json").unlink(),
        lambda session: (session / "boundaries.json").write_text("{}"),
    ],
)
def test_any_change_makes_it_be_looked_at_again_and_what_it_took_is_still_known(session, change):
    change(session)
    assert look_up(session, "k") == (ROW, False)


def test_other_settings_or_software_make_it_be_looked_at_again(session):
    assert look_up(session, "other") == (ROW, False)
    plain = key_of(Settings())
    assert plain == key_of(Settings())
    assert key_of(Settings().overridden(["matching.window_px=11"])) != plain


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": 2}', "[" * 100_000, "\udcff"])
def test_a_record_that_is_none_says_nothing(session, text):
    (session / "results" / "batch.json").write_bytes(text.encode(errors="surrogateescape"))
    assert look_up(session, "k") == (None, False)


def test_there_and_back_is_the_same_and_has_one_digest(session):
    record = SessionRecord(key="k", files=stats_of(session), row=ROW)
    again = read_record(record.model_dump_json().encode())
    assert again == record
    assert again.digest == record.digest
    assert record.model_copy(update={"key": "l"}).digest != record.digest


def test_names_that_are_not_utf_8_and_times_before_1980_are_noted(session):
    (session / os.fsdecode(b"n\xffte.txt")).write_text("")
    os.utime(session / "session.toml", (-1e8, -1e8))
    write_record(session, SessionRecord(key="k", files=stats_of(session), row=ROW))
    assert look_up(session, "k") == (ROW, True)
    (session / os.fsdecode(b"n\xffte.txt")).write_text("more")
    assert look_up(session, "k") == (ROW, False)


def test_thousands_are_looked_at_in_seconds(session):
    """10,000 sessions are to take less than a minute: 6 ms each. This one has few files; a real one has some 150."""
    for number in range(150):
        (session / "calibration" / f"{number:03}.jpg").parent.mkdir(exist_ok=True)
        (session / "calibration" / f"{number:03}.jpg").write_text("")
    write_record(session, SessionRecord(key="k", files=stats_of(session), row=ROW))
    begun = time.process_time()
    for _ in range(20):
        assert look_up(session, "k")[1]
    assert (time.process_time() - begun) / 20 < 6e-3


def test_memory_is_that_of_the_next_larger_or_grows_with_the_pixels():
    known = [(1.0, 300.0), (8.0, 900.0), (8.1, 1000.0), (100.0, 2800.0)]
    margin = need_mb(100.0, known) / 2800.0
    assert 1.0 < margin < 1.3
    assert need_mb(2.0, known) == pytest.approx(margin * 1000.0)
    assert need_mb(0.5, known) == pytest.approx(margin * 300.0)
    assert need_mb(200.0, known) == pytest.approx(margin * 5600.0)
    assert need_mb(None, known) == pytest.approx(margin * 2800.0)
    assert need_mb(5.0, []) is None
