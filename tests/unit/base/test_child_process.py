"""A second process gives what the function gives, says why where it cannot, and never outlives the first."""

import math
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import psutil
import pytest

from mammometry.base.child_process import Call, CallCancelledError, CallError, ChildProcess
from mammometry.base.extras import require
from mammometry.base.machine.cores import available_cores
from mammometry.base.progress import StageProgress

_ENDS_WITHIN_S = 20.0  # on a machine that is very busy


def test_it_calls_one_after_another_in_a_process_of_its_own() -> None:
    with ChildProcess() as child:
        assert child.call(math.hypot, 3, 4) == 5
        assert child.call(os.getpid) not in (os.getpid(), None)
        assert child.call(os.getpgrp) != os.getpgrp()  # Ctrl-C at the terminal goes to this process alone
        assert child.call(available_cores) == 1  # the first has the others
        assert child.call(np.put, np.zeros(3), [0], [1.0]) is None  # arguments are the function's own, to write to
        large = np.arange(300_000.0)  # more than a pipe holds, in both directions
        np.testing.assert_array_equal(child.call(np.flip, large), large[::-1])


def test_what_it_prints_is_no_answer() -> None:
    with ChildProcess() as child:
        assert child.call(print, "this goes elsewhere") is None
        assert child.call(math.sqrt, 4) == 2


def silent_stages(report: StageProgress, silent_s: float) -> int:
    for stage in ("match", "surface"):
        report(stage, 0.0)
        time.sleep(silent_s)
    report("surface", 0.95)
    time.sleep(silent_s)
    report("surface", 0.0)  # the next piece of the same stage
    time.sleep(silent_s)
    return 1


@pytest.mark.slow
def test_a_stage_that_reports_nothing_is_reported_all_the_same() -> None:
    """On the road of each job of the clinic and each session of a batch."""
    heard: list[tuple[str, float, float]] = []
    with ChildProcess() as child:
        call = Call(function=silent_stages, arguments=(0.5,))
        answer = child.answer(call, lambda *about: heard.append((*about, time.monotonic())), every_s=0.1)
    assert answer["done"] == 1
    assert [stage for stage, *_ in heard] == sorted(stage for stage, *_ in heard)  # match, then surface alone
    for wanted in ("match", "surface"):
        times = [when for stage, _, when in heard if stage == wanted]
        assert len(times) >= 3
        assert max(np.diff(times)) < 0.4  # ticks of 0.1 s, on a busy machine
    shares = [fraction for stage, fraction, _ in heard if stage == "match"]
    assert 0 < shares[-1] <= 0.9
    assert shares == sorted(shares)
    assert max(fraction for stage, fraction, _ in heard if stage == "surface") == 0.95  # reported by the work itself
    assert heard[-1][1] < 0.5


def test_an_error_there_is_told_and_the_next_call_is_done() -> None:
    with ChildProcess() as child:
        with pytest.raises(CallError, match=r"\bmath\b"):
            child.call(math.sqrt, -1)
        assert child.call(math.sqrt, 4) == 2


def test_a_process_that_is_gone_is_told() -> None:
    with ChildProcess() as child:
        pid = child.call(os.getpid)
        os.kill(pid, signal.SIGKILL)
        with pytest.raises(CallError, match="died"):
            child.call(math.sqrt, 4)


def test_the_end_of_the_block_ends_a_call() -> None:
    with ThreadPoolExecutor(1) as pool:
        with ChildProcess() as child:
            pid = child.call(os.getpid)
            waiting = pool.submit(child.call, time.sleep, 600)
            time.sleep(0.1)
        with pytest.raises(CallCancelledError):
            waiting.result()
    assert not psutil.pid_exists(pid)


_PARENT = """
import os, time
from mammometry.base.child_process import ChildProcess
with ChildProcess() as second:
    print(second.call(os.getpid), flush=True)
    second.call(time.sleep, 600)
"""


def test_it_ends_when_the_first_is_killed_in_the_middle_of_a_call() -> None:
    with subprocess.Popen([sys.executable, "-c", _PARENT], stdout=subprocess.PIPE, text=True) as first:
        assert first.stdout is not None
        pid = int(first.stdout.readline())
        first.kill()
    until = time.monotonic() + _ENDS_WITHIN_S
    while psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < until
        time.sleep(0.05)


def test_the_code_of_an_error_comes_back() -> None:
    with ChildProcess() as child:
        answer = child.answer(Call(function=require, arguments=("edit", "no_such_library")))
    assert (answer["kind"], answer["code"], answer["exit_code"]) == ("MissingLibraryError", "missing-library", 9)
