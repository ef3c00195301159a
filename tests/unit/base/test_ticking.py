"""Work that reports nothing is reported all the same."""

import io
import sys
import time

import pytest

from mammometry.base.progress import ticking
from mammometry.cli import common


def test_silent_work_is_reported_and_grows() -> None:
    seen = list[float]()
    with ticking(seen.append, 0.1, tick_s=0.02):
        time.sleep(0.3)
    assert len(seen) >= 5
    assert seen == sorted(seen)
    assert 0.5 < seen[-1] <= 0.9
    count = len(seen)
    time.sleep(0.05)
    assert len(seen) == count  # nothing is reported once the work has ended


def test_what_the_work_reports_counts_and_never_falls() -> None:
    seen = list[float]()
    with ticking(seen.append, 100.0, tick_s=0.02) as report:
        report(0.5)
        time.sleep(0.1)
        report(0.3)
    assert set(seen) == {0.5}
    assert len(seen) >= 3


def test_without_a_terminal_a_line_comes_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    written = io.StringIO()
    monkeypatch.setattr(sys, "stderr", written)
    monkeypatch.setattr(common, "_SPARSE_S", 0.0)
    monkeypatch.setattr(common, "_SILENT_S", 0.1)
    monkeypatch.setattr(common, "TICK_S", 0.02)
    with common.Bars(quiet=False) as bars:
        bars.expect("measure", 2)
        with bars.task("measure", "sides") as progress:
            progress(0.5)
            time.sleep(0.3)  # says that it is at work
        with bars.task("measure", "boundaries"):
            pass
        time.sleep(0.2)  # pictures, which are no product
    lines = written.getvalue().splitlines()
    assert lines[0] == "measure …"
    assert {line.partition(",")[0] for line in lines[1:]} >= {"measure 25 %", "measure 50 %", "measure 100 %"}
    assert len([line for line in lines if line.startswith("measure 25 %")]) >= 2
