"""Hundreds of simulated workers for Dask's real scheduler, whose tasks wait for random durations.

    python -m benchmarks.speed.crowd ADDRESS --workers 1000 --cores 2

All workers live in one process, on one event loop, each with its own connections to the scheduler: `share_busy` starts
it, and the scheduler in another, and gives the tasks to them through the batch's own engine. Only what a worker does
with a task is replaced.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import logging
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import dask
import numpy as np
import psutil

from mammometry.base.child_process import Call
from mammometry.batch import engine
from mammometry.batch.cluster import machines
from mammometry.batch.engine import Ended, Engine, Task
from mammometry.batch.record import CORES, MEMORY
from mammometry.batch.supervise import TOPIC

_SESSION_MPX = 108.0  # eight photographs of 13.5 megapixels: the reference rig
_SESSION_MB = 3000.0  # that a session of that size holds at its most, about
_WORKER_MB = 16000.0  # offered for each core: enough that cores, not memory, are what tasks wait for
_STAGES = ("calibrate", "match", "surface", "measure", "report")
_SIZES, _SPREAD = 0.4, 0.3  # of the logarithms of sizes, and of durations of one size
_READY_S = 900.0  # a thousand workers in one process come by two or three a second
_TOGETHER = 25  # workers that start at the same time
_QUIET = {  # what every worker does many times a second, a thousand cannot do in one process
    "distributed.admin.tick.interval": "60s",
    "distributed.admin.tick.limit": "1h",
    "distributed.admin.system-monitor.interval": "60s",
    "distributed.worker.profile.enabled": False,
    "distributed.comm.timeouts.connect": "120s",
}


async def wait_for(name: str, call: Call, limits: object) -> dict[str, Any]:
    """Take the place of `supervise`: say five stages and wait as long as the order says."""
    from distributed import get_worker

    worker, (seconds, memory_mb) = get_worker(), call.arguments
    begun = time.time()
    for stage in _STAGES:
        worker.log_event(TOPIC, {"task": name, "stage": stage, "fraction": 0.0})
        await asyncio.sleep(seconds / len(_STAGES))
    return {"done": [begun, time.time()], "memory_mb": memory_mb, "worker": str(worker.name), "host": "crowd"}


def share_busy(workers: int, cores: int, each: int, rate: float, seed: int = 7) -> dict[str, Any]:
    """Give `each` tasks a core to simulated workers, and see how long they have nothing to do.

    Args:
        workers: simulated.
        cores: of each.
        each: tasks for each core.
        rate: tasks that end in a second, all workers together; it sets how long the tasks are.
        seed: of sizes and durations.

    Returns:
        Figures by name; memory of the scheduler's process in MB, shares of 1.
    """
    slots = workers * cores
    draw = np.random.default_rng(seed)
    sizes = draw.lognormal(0.0, _SIZES, slots * each)
    seconds = sizes * draw.lognormal(0.0, _SPREAD, len(sizes))
    seconds *= slots / rate / seconds.mean()
    tasks = [
        Task(
            name=f"/archive/{number:06d}",
            call=Call(function=time.sleep, arguments=(float(wait), _SESSION_MB * float(size))),
            megapixels=_SESSION_MPX * float(size),
        )
        for number, (size, wait) in enumerate(zip(sizes, seconds, strict=True))
    ]
    found: dict[str, Any] = {"workers": workers, "cores": cores, "tasks": len(tasks), "mean_s": float(seconds.mean())}
    with (
        _crowd(workers, cores) as (address, scheduler),
        mock.patch.object(engine, "supervise", wait_for),
        machines(address) as there,
    ):
        _all_there(there.client, workers)
        used, begun = sum(scheduler.cpu_times()[:2]), time.time()
        spans: list[list[float]] = []
        failed = 0
        for event in Engine(there, known=[(_SESSION_MPX, _SESSION_MB)]).run(tasks):
            if not isinstance(event, Ended):
                continue
            if event.value is None:
                failed += 1
                continue
            spans.append(event.value)
            for part in (1, 25, 50, 75, 100):
                if len(spans) == len(tasks) * part // 100:
                    found[f"mb_{part}"] = _memory_mb(scheduler)
        found["scheduler_cpu_ms_a_task"] = 1e3 * (sum(scheduler.cpu_times()[:2]) - used) / len(tasks)
    first, last = min(span[0] for span in spans), max(span[1] for span in spans)
    work = sum(span[1] - span[0] for span in spans)
    starts = np.sort([span[0] for span in spans])
    found |= {
        "failed": failed,
        "asked_s": float(seconds.sum()) / slots,
        "took_s": last - first,
        "first_after_s": first - begun,
        "filled_after_s": float(starts[slots - 1] - first),
        "busy": work / slots / (last - first),
        "busy_until_last_began": float(_by_part(np.array(spans), first, starts[-1], 1)[0]) / slots,
        "busy_by_tenth": [round(each, 3) for each in _by_part(np.array(spans), first, last) / slots],
    }
    return found


def _by_part(spans: np.ndarray, first: float, last: float, parts: int = 10) -> np.ndarray:
    """Mean number of tasks at work in each part of the time. Spans are rows of begin and end."""
    edges = np.linspace(first, last, parts + 1)
    work = np.clip(np.minimum(spans[:, 1:], edges[1:]) - np.maximum(spans[:, :1], edges[:-1]), 0.0, None)
    return np.asarray(work.sum(axis=0) / np.diff(edges))


def _all_there(client: Any, workers: int) -> None:
    """Wait until every worker has come and has said what it offers."""
    until = time.monotonic() + _READY_S
    while (came := client.run_on_scheduler(_offering)) < workers:
        if time.monotonic() > until:
            raise SystemExit(f"{came} of {workers} workers came within {_READY_S:.0f} s: try fewer")
        time.sleep(2.0)


def _offering(dask_scheduler: Any) -> int:
    """How many workers offer cores."""
    return sum(worker.resources.get(CORES, 0.0) > 0 for worker in dask_scheduler.workers.values())


def _memory_mb(process: psutil.Process) -> float:
    return float(process.memory_info().rss) / (1 << 20)


@contextlib.contextmanager
def _crowd(workers: int, cores: int) -> Iterator[tuple[str, psutil.Process]]:
    """A scheduler, and workers, in two processes; the scheduler's address, and its process."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scheduler.json"
        command = ["distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
        with _process([*command, "--scheduler-file", str(file)]) as scheduler:
            until = time.monotonic() + _READY_S
            while not file.exists() and time.monotonic() < until:
                time.sleep(0.1)
            address = json.loads(file.read_text())["address"]
            with _process([__name__, address, "--workers", str(workers), "--cores", str(cores)]):
                yield address, psutil.Process(scheduler.pid)


@contextlib.contextmanager
def _process(command: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen([sys.executable, "-m", *command], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


async def _stand(scheduler: str, workers: int, cores: int, folder: str) -> None:
    """Start the workers, and live until the scheduler is gone."""
    from distributed import Worker

    async def started(number: int) -> Worker:
        return await Worker(
            scheduler,
            name=f"crowd-{number}",
            nthreads=cores,
            memory_limit=0,
            dashboard=False,
            local_directory=folder,
            resources={CORES: float(cores), MEMORY: _WORKER_MB * cores},
        )

    there: list[Worker] = []
    for first in range(0, workers, _TOGETHER):
        numbers = range(first, min(first + _TOGETHER, workers))
        there += await asyncio.gather(*(started(number) for number in numbers))
    await asyncio.gather(*(worker.finished() for worker in there))


def main() -> None:
    """Start simulated workers."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scheduler", help="its address")
    parser.add_argument("--workers", type=int, default=64)
    parser.add_argument("--cores", type=int, default=2, help="of each")
    options = parser.parse_args()
    logging.disable()  # every worker keeps every other worker's lines: a thousand times a thousand
    with tempfile.TemporaryDirectory() as folder, dask.config.set(_QUIET):
        asyncio.run(_stand(options.scheduler, options.workers, options.cores, folder))


if __name__ == "__main__":
    main()
