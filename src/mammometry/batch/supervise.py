"""A Dask worker's task: start its process, pass on its messages.

A process that grows too large is ended.
"""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from mammometry.base.machine.cores import CORES
from mammometry.batch.child import Order
from mammometry.batch.names import MEMORY
from mammometry.batch.record import software

TOPIC = "mammometry"
"""Of the events by which workers say how far their tasks are."""
_LOOK_S = 0.5  # between two looks at the memory of a process: it grows by some 100 MB a second
_LAST_LINES = 3  # of what a process that died has said
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
_MIB = 1 << 20  # bytes in a MiB

running: dict[tuple[str, str], subprocess.Popen[bytes]] = {}
"""Processes of this worker by batch and task, for stopping them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What a task's process may use."""

    batch: str
    """Whose task it is."""
    cores: int
    software: Mapping[str, str]
    """What the batch's own machine runs."""
    say_s: float = 1.0
    """Between two words on the same stage, s. The scheduler hears the words of all workers."""


def supervise(name: str, order: Order, limits: Limits) -> dict[str, Any]:
    """Do a task in a process of its own.

    Args:
        name: of the task, for its events.
        order: what to do.
        limits: of its process, whose memory is limited to what the worker offers.

    Returns:
        What the process answered; ``killed`` with the reason where it did not; ``other`` with what this worker runs
        where that is not what the batch runs. Always ``worker`` and ``memory_mb``.
    """
    from distributed import get_worker

    worker = get_worker()
    about = {"worker": str(worker.name), "host": os.uname().nodename}
    if software() != dict(limits.software):
        return {"other": software(), **about}
    with tempfile.TemporaryFile() as complaints:
        process = subprocess.Popen(
            [sys.executable, "-m", "mammometry.batch.child"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=complaints,
            env=os.environ | dict.fromkeys(_THREADS, str(limits.cores)) | {CORES: str(limits.cores)},
            start_new_session=True,  # Ctrl-C at the terminal is the batch's to answer
        )
        running[limits.batch, name] = process
        try:
            peak = _Peak(process, worker.state.total_resources.get(MEMORY, 0.0))
            pass_on = _seldom(lambda event: worker.log_event(TOPIC, {"task": name, **event}), limits.say_s)
            answer = _conversation(process, order, pass_on)
            peak.end()
            if answer is None:
                answer = {"killed": peak.why or _last_words(process, complaints)}
            return {"memory_mb": peak.mb} | answer | about
        finally:
            process.kill()
            process.wait()
            running.pop((limits.batch, name), None)


def _seldom(say: Callable[[dict[str, Any]], None], every_s: float) -> Callable[[dict[str, Any]], None]:
    """Say each new stage at once, and how far it is at most every so many seconds."""
    stage, at = "", -every_s

    def say_seldom(event: dict[str, Any]) -> None:
        nonlocal stage, at
        now = time.monotonic()
        if event["stage"] != stage or now - at >= every_s:
            stage, at = event["stage"], now
            say(event)

    return say_seldom


def stop_all(batch: str) -> int:
    """End a batch's processes on this worker. Return how many there were."""
    return stop(batch, [task for of, task in list(running) if of == batch])


def stop(batch: str, tasks: Collection[str]) -> int:
    """End the processes of some tasks of a batch on this worker. Return how many there were."""
    there = [process for (of, task), process in list(running.items()) if of == batch and task in tasks]
    for process in there:
        with suppress(OSError):
            process.kill()
    return len(there)


def _conversation(process: subprocess.Popen[bytes], order: Order, pass_on: Any) -> dict[str, Any] | None:
    """Give the order, pass on what is said, and return the answer.

    None where the process ends without one.
    """
    assert process.stdin is not None
    assert process.stdout is not None
    pass_on({"stage": "start", "fraction": 0.0})
    try:
        process.stdin.write(pickle.dumps(order))
        process.stdin.flush()
        for line in process.stdout:
            said = json.loads(line)
            if "stage" not in said:
                answer: dict[str, Any] = said
                return answer
            pass_on(said)
    except (OSError, ValueError):
        pass  # it died while it spoke
    finally:
        for pipe in (process.stdin, process.stdout):
            with suppress(OSError):
                pipe.close()
    return None


def _last_words(process: subprocess.Popen[bytes], complaints: Any) -> str:
    """Why a process ended without an answer."""
    code = process.wait()
    size = complaints.seek(0, os.SEEK_END)
    complaints.seek(max(0, size - 4096))
    lines = complaints.read().decode("utf-8", errors="replace").strip().splitlines()[-_LAST_LINES:]
    ended = f"it was ended by signal {-code}" if code < 0 else f"it ended with code {code}"
    return " ".join([ended, *([f"after saying: {' / '.join(lines)}"] if lines else [])])


class _Peak:
    """Watch a process's memory and end it above its limit."""

    def __init__(self, process: subprocess.Popen[bytes], limit_mb: float) -> None:
        self.mb = 0.0
        self.why = ""
        self._process, self._limit_mb = process, limit_mb
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._thread.start()

    def end(self) -> None:
        self._ended.set()
        self._thread.join()

    def _look(self) -> None:
        import psutil

        while True:
            with suppress(psutil.Error):
                whole = psutil.Process(self._process.pid)
                each = [whole, *whole.children(recursive=True)]
                self.mb = max(self.mb, round(sum(one.memory_info().rss for one in each) / _MIB, 1))
            if self._limit_mb and self.mb > self._limit_mb:
                self.why = f"it took {self.mb:.0f} MB of memory, more than the {self._limit_mb:.0f} MB that it may"
                self._process.kill()
                return
            if self._ended.wait(_LOOK_S):
                return
