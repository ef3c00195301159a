"""Loops over captures on a batch's machines: each capture a task, in a process of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from mammometry.base.child_process import Call
from mammometry.batch.cluster import machines
from mammometry.batch.engine import Ended, Engine, Task


def each_as_it_ends(
    function: Callable[..., Any],
    arguments: Mapping[str, tuple[Any, ...]],
    *,
    megapixels: float,
    scheduler: str | None = None,
) -> Iterator[tuple[str, Any]]:
    """Call a function for each capture, on all cores or on a cluster, and yield its results.

    Args:
        function: called with `(progress, *arguments)`, returns plain JSON data; of a module that other processes can
            import, so not of `__main__`.
        arguments: name → what it is called with.
        megapixels: of one capture's photographs: its memory grows with it.
        scheduler: address of a Dask scheduler whose workers see the same folders; None: this machine.

    Raises:
        SystemExit: a capture failed, other than by a refusal that the function returns.
    """
    tasks = [
        Task(name=name, call=Call(function=function, arguments=given), megapixels=megapixels)
        for name, given in arguments.items()
    ]
    with machines(scheduler) as there:
        for event in Engine(there).run(tasks):
            if isinstance(event, Ended):
                if event.failed:
                    raise SystemExit(f"{event.name}: {event.failed}")
                yield event.name, event.value
