"""Loop over sessions on a batch's machines, for studies and benchmarks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from mammometry.base.child_process import Call
from mammometry.base.errors import BatchError
from mammometry.base.progress import MapTasks
from mammometry.batch.cluster import Machines
from mammometry.batch.engine import Began, Ended, Engine, StopRequest, Task


def map_tasks_on(
    machines: Machines,
    *,
    megapixels: float | None = None,
    watch: Callable[[Began | Ended], None] = lambda event: None,
    stop: Callable[[], StopRequest] = lambda: StopRequest.NONE,
) -> MapTasks:
    """Make a loop that runs each turn as a Dask task. Each task has its own process.

    Args:
        machines: the workers.
        megapixels: of the photographs in each turn, by which memory is learned.
        watch: called for all that happens.
        stop: what the user wants now.
    """
    known: list[tuple[float, float]] = []

    def map_tasks(function: Callable[..., Any], arguments: Mapping[str, tuple[Any, ...]]) -> dict[str, Any]:
        tasks = [
            Task(name=name, call=Call(function=function, arguments=given), megapixels=megapixels)
            for name, given in arguments.items()
        ]
        done: dict[str, Any] = {}
        for event in Engine(machines, known=known, stop=stop).run(tasks):
            watch(event)
            if isinstance(event, Ended):
                if event.failed:
                    raise BatchError(
                        event.name,
                        found=f"a task that failed ({event.failed.rstrip('.')})",
                        expected="results of all of them",
                        remedy="Remove what stands in the way and run the same command again: what is done is kept",
                    )
                done[event.name] = event.value
                if megapixels and event.memory_mb:
                    known.append((megapixels, event.memory_mb))
        if len(done) < len(tasks):
            raise KeyboardInterrupt
        return done

    return map_tasks
