"""A Dask worker's task: start its process, pass on its messages.

A process that grows too large is ended.
"""

import os
import platform
import subprocess
import tempfile
import threading
from collections.abc import Collection, Mapping
from contextlib import suppress
from typing import Any

from mammometry.base.child_process import Call, CallError, ChildProcess
from mammometry.base.value import value
from mammometry.batch.record import MEMORY, software

TOPIC = "mammometry"
"""Topic of the workers' progress events."""
_LOOK_S = 0.5  # between two checks of a process's memory: it grows by about 100 MB a second
_LAST_LINES = 3  # of the output of a process that died
_MIB = 1 << 20  # bytes in a MiB

running: dict[tuple[str, str], subprocess.Popen[bytes]] = {}
"""Processes of this worker by batch and task, to stop them."""


@value
class ProcessLimits:
    """Limits of a task's process."""

    batch: str
    """Batch of the task."""
    cores: int
    software: Mapping[str, str]
    """Software of the batch's own machine."""
    report_s: float = 1.0
    """Between two reports on the same stage, s. The scheduler receives those of all workers."""


def supervise(name: str, call: Call, limits: ProcessLimits) -> dict[str, Any]:
    """Run a task in its own process.

    Args:
        name: of the task, for its events.
        call: the task; its function is called with a `StageProgress` first.
        limits: of its process; the memory limit is the worker's offer.

    Returns:
        The answer of the process (`ChildProcess.answer`); ``killed`` with the reason if it died; ``other`` with this
        worker's software if that differs from the batch's. Always ``worker`` and ``memory_mb``.
    """
    from distributed import get_worker

    worker = get_worker()
    about = {"worker": str(worker.name), "host": platform.node()}
    if software() != dict(limits.software):
        return {"other": software(), **about}

    def report(stage: str, fraction: float) -> None:
        worker.log_event(TOPIC, {"task": name, "stage": stage, "fraction": fraction})

    with tempfile.TemporaryFile() as errors, ChildProcess(cores=limits.cores, errors=errors) as child:
        running[limits.batch, name] = child.process
        peak = _Peak(child.process, worker.state.total_resources.get(MEMORY, 0.0))
        try:
            report("start", 0.0)
            answer = child.answer(call, report, limits.report_s)
        except CallError:
            peak.end()
            answer = {"killed": peak.why or _last_words(child.process, errors)}
        finally:
            peak.end()
            running.pop((limits.batch, name), None)
    return {"memory_mb": peak.mb} | answer | about


def stop_all(batch: str) -> int:
    """End a batch's processes on this worker. Return how many there were."""
    return stop(batch, [task for of, task in list(running) if of == batch])


def stop(batch: str, tasks: Collection[str]) -> int:
    """End the processes of some tasks of a batch on this worker. Return how many there were."""
    stopped = [process for (of, task), process in list(running.items()) if of == batch and task in tasks]
    for process in stopped:
        with suppress(OSError):
            process.kill()
    return len(stopped)


def _last_words(process: subprocess.Popen[bytes], errors: Any) -> str:
    """Reason why a process ended without an answer."""
    code = process.wait()
    size = errors.seek(0, os.SEEK_END)
    errors.seek(max(0, size - 4096))
    lines = errors.read().decode("utf-8", errors="replace").strip().splitlines()[-_LAST_LINES:]
    ended = f"it was ended by signal {-code}" if code < 0 else f"it ended with code {code}"
    return " ".join([ended, *([f"its last output: {' / '.join(lines)}"] if lines else [])])


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
                family = [whole, *whole.children(recursive=True)]
                self.mb = max(self.mb, round(sum(process.memory_info().rss for process in family) / _MIB, 1))
            if self._limit_mb and self.mb > self._limit_mb:
                self.why = f"it used {self.mb:.0f} MB of memory, more than its limit of {self._limit_mb:.0f} MB"
                self._process.kill()
                return
            if self._ended.wait(_LOOK_S):
                return
