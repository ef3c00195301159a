"""Progress callbacks and loops that do not depend on a terminal or a machine."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from threading import Event, Lock, Thread
from typing import Any, TypeAlias

Progress: TypeAlias = Callable[[float], None]
"""Called with the fraction done, 0 to 1, which never decreases within a stage."""
StageProgress: TypeAlias = Callable[[str, float], None]
"""Called with the current stage and its fraction done."""
MapTasks: TypeAlias = Callable[[Callable[..., Any], Mapping[str, tuple[Any, ...]]], dict[str, Any]]
"""Calls a function with ``(progress, *arguments)`` for each name. Returns name → result.

The function may run in another process or on another machine. So it is defined in a module, its arguments can be
pickled, and its result is plain JSON data.
"""


def no_progress(fraction: float) -> None:
    """Ignore the progress. This is the default."""


def part(progress: Progress, start: float, stop: float) -> Progress:
    """Map the progress 0…1 of a sub-task onto `start`…`stop` of the whole task."""
    return lambda fraction: progress(start + (stop - start) * fraction)


TICK_S = 0.5
"""Interval of reports if the work itself reports nothing, s."""
_USUAL_S = 20.0  # assumed duration of a product that was never timed
_MOST = 0.9  # largest share that is estimated from the elapsed time alone


@contextmanager
def ticking(progress: Progress, expected_s: float | None = None, *, tick_s: float = TICK_S) -> Iterator[Progress]:
    """Report at least every `tick_s` seconds, even if the work reports nothing.

    Until the work's first report, the share is estimated from the elapsed time.

    Args:
        progress: may be called from another thread. Calls never overlap, and the share never decreases.
        expected_s: how long the work took earlier, s, if known.
        tick_s: interval of reports, s.

    Yields:
        The callback for the work.
    """
    begun, ended, lock = time.monotonic(), Event(), Lock()
    usual_s = max(expected_s or _USUAL_S, tick_s)
    done, own = 0.0, False

    def report(fraction: float, *, by_work: bool) -> None:
        nonlocal done, own
        with lock:
            if by_work:
                own |= fraction > 0
            elif own:
                fraction = done
            done = max(done, fraction)
            progress(done)

    def tick() -> None:
        while not ended.wait(tick_s):
            report(_MOST * -math.expm1(-(time.monotonic() - begun) / usual_s), by_work=False)

    ticker = Thread(target=tick, daemon=True)
    ticker.start()
    try:
        yield lambda fraction: report(fraction, by_work=True)
    finally:
        ended.set()
        ticker.join()


def map_in_sequence(function: Callable[..., Any], arguments: Mapping[str, tuple[Any, ...]]) -> dict[str, Any]:
    """Call the function in this process for one name after another."""
    return {name: function(lambda stage, fraction: None, *given) for name, given in arguments.items()}
