"""Work in bands: every thing once, in order."""

import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mammometry.base import cores


@given(count=st.integers(0, 500))
def test_bands_cover_everything_once_and_in_order(count):
    things = range(count)
    parts = cores.in_bands(lambda part: things[part], count)
    assert [thing for part in parts for thing in part] == list(things)
    assert len(parts) >= 1


def test_bands_are_done_at_the_same_time(monkeypatch):
    monkeypatch.setattr(cores, "available_cores", lambda: 2)
    both = threading.Barrier(2)  # which is passed by two threads at once, or never

    def wait(part):
        both.wait(timeout=10)
        return part

    assert len(cores.in_bands(wait, 80)) == 8


def test_an_error_in_a_band_is_the_callers():
    with pytest.raises(ZeroDivisionError):
        cores.in_bands(lambda part: 1 // (part.start - part.start), 10)
