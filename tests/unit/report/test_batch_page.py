"""The page and tables of a batch: nothing is lost between them, and no cell is a formula."""

import csv
import io
import os
import re

import pyarrow.parquet as pq
import pytest

from mammometry.base.notices import Notice
from mammometry.report.documents.batch_page import BatchLine, BatchVolume, batch_files, counted

LINES = (
    BatchLine(
        session="a",
        address="/archive/a",
        state="measured",
        subject="=HYPERLINK(1)",
        volumes=(
            BatchVolume(name="left", volume_cc=512.25, interval_cc=(500.0, 530.5), reference_cc=500.0),
            BatchVolume(name="right", volume_cc=480.0, interval_cc=None, reference_cc=490.0),
        ),
        notices=(Notice(code="boundary-not-confirmed", about=("left",)), Notice(code="boundaries-drawn-with-edit")),
        seconds=12.5,
        peak_memory_mb=900.0,
        page="/archive/a/results/report/report.html",
    ),
    BatchLine(session="<b>", address="/archive/<b>", state="failed", failed="capture/front_left: found no photograph."),
    BatchLine(session="c", address="/archive/c", state="stopped"),
    BatchLine(
        session="d",
        address="/archive/d",
        state="current",
        volumes=(BatchVolume(name="left", volume_cc=700.0, interval_cc=(650.0, 750.0), reference_cc=690.0),),
        no_breast={"right": "flat over the whole side"},
    ),
)


def test_a_row_a_volume_and_one_for_each_session_without_any():
    rows = list(csv.DictReader(io.StringIO(batch_files("trial", LINES)["batch.csv"].decode())))
    assert [(row["session"], row["volume"], row["volume_cc"]) for row in rows] == [
        ("a", "left", "512.25"),
        ("a", "right", "480.0"),
        ("<b>", "", ""),
        ("c", "", ""),
        ("d", "left", "700.0"),
    ]
    assert (rows[0]["low_cc"], rows[0]["high_cc"], rows[1]["low_cc"]) == ("500.0", "530.5", "")
    assert rows[2]["failed"] == "capture/front_left: found no photograph."
    assert rows[4]["no_breast"] == "right: flat over the whole side"


def test_no_cell_is_a_formula():
    text = batch_files("trial", LINES)["batch.csv"].decode()
    assert "'=HYPERLINK(1)" in text
    assert all(not cell or cell[0] not in "=+-@" for row in csv.reader(io.StringIO(text)) for cell in row)


def test_parquet_says_the_same_with_numbers_as_numbers():
    files = batch_files("trial", LINES)
    table = pq.read_table(io.BytesIO(files["batch.parquet"]))
    assert table.column("volume_cc").to_pylist() == [512.25, 480.0, None, None, 700.0]
    assert table.column("subject").to_pylist()[0] == "=HYPERLINK(1)"
    assert table.column_names == files["batch.csv"].decode().splitlines()[0].split(",")


def test_the_page_shows_names_as_text_intervals_failures_and_agreement():
    page = batch_files("trial", LINES)["batch.html"].decode()
    assert "&lt;b&gt;" in page
    assert "/archive/<b>" not in page
    assert "500 … 530" in page.replace("\u00a0", " ")
    assert "found no photograph" in page
    assert "Agreement" not in page  # three breasts, but of two subjects


def test_both_breasts_of_a_woman_are_one_subject_of_the_agreement():
    third = BatchVolume(name="right", volume_cc=300.0, interval_cc=None, reference_cc=310.0)
    page = batch_files("trial", (*LINES, BatchLine(session="e", address="/e", state="current", volumes=(third,))))
    assert "Agreement" in page["batch.html"].decode()
    assert re.search(r"\b4 pairs .*\b3 subjects", page["batch.html"].decode())


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (LINES, "4 sessions: 1 measured now, 1 current already, 1 failed, 1 not measured yet."),
        (LINES[:1], "1 sessions: 1 measured now."),
    ],
)
def test_what_became_of_them_is_counted(lines, words):
    assert counted(lines) == words.replace("1 sessions", "1 session")


def test_a_session_whose_name_is_not_utf_8_is_shown_and_its_report_linked():
    name = os.fsdecode(b"caf\xe9 #1")
    line = BatchLine(session=name, address=f"/a/{name}", state="measured", page=f"/a/{name}/results/report/report.html")
    files = batch_files("trial", [line])
    page = files["batch.html"].decode()
    assert "caf\\xe9 #1" in page
    assert 'href="/a/caf%E9%20%231/results/report/report.html"' in page
    assert "caf\\xe9 #1" in files["batch.csv"].decode()
    assert b"PAR1" in files.get("batch.parquet", b"PAR1")
