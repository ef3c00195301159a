"""Work in bands: every thing once, in order."""

import os
import subprocess
import sys
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mammometry.base.machine import cores


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


def test_things_are_worked_on_at_once_and_returned_in_order(monkeypatch):
    monkeypatch.setattr(cores, "available_cores", lambda: 2)
    both = threading.Barrier(2, timeout=30)

    def doubled(thing):
        both.wait()
        return 2 * thing

    assert cores.map_in_threads(doubled, [3, 1, 4, 1]) == [6, 2, 8, 2]


LOADED_INSIDE = """
import sys
import numpy
from threadpoolctl import threadpool_info
from mammometry.base.machine.cores import one_blas_thread

assert "scipy.linalg" not in sys.modules
with one_blas_thread():
    import scipy.linalg
    print(*(each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"))
"""


def test_a_blas_that_is_loaded_later_has_one_thread_too():
    """SciPy has its own, which is loaded with the first stage that needs it."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    environment.pop("OPENBLAS_NUM_THREADS", None)
    done = subprocess.run(
        [sys.executable, "-c", LOADED_INSIDE], env=environment, capture_output=True, text=True, check=True, timeout=60
    )
    assert len(done.stdout.split()) >= 2
    assert set(done.stdout.split()) == {"1"}


def test_the_environment_is_as_before(monkeypatch):
    for before in (None, "3"):
        if before is None:
            monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
        else:
            monkeypatch.setenv("OPENBLAS_NUM_THREADS", before)
        with cores.one_blas_thread():
            assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
        assert os.environ.get("OPENBLAS_NUM_THREADS") == before
