"""Progress callbacks and loops, independent of any terminal and of where the work is done."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

Progress: TypeAlias = Callable[[float], None]
"""Called with the fraction done, 0 to 1, never decreasing within a stage."""
StageProgress: TypeAlias = Callable[[str, float], None]
"""Called with the current stage and its fraction done."""
MapTasks: TypeAlias = Callable[[Callable[..., Any], Mapping[str, tuple[Any, ...]]], dict[str, Any]]
"""Call a function with ``(progress, *arguments)`` for each name. Return name → result.

The function is defined in a module, its arguments can be pickled, and its result is plain JSON data: it may run in
another process or on another machine.
"""


def no_progress(fraction: float) -> None:
    """Ignore the progress: the default of every stage."""


def part(progress: Progress, start: float, stop: float) -> Progress:
    """Map a sub-task's 0…1 onto `start`…`stop` of the task that `progress` follows."""
    return lambda fraction: progress(start + (stop - start) * fraction)


def map_in_sequence(function: Callable[..., Any], arguments: Mapping[str, tuple[Any, ...]]) -> dict[str, Any]:
    """Call the function here, for each name in turn."""
    return {name: function(lambda stage, fraction: None, *given) for name, given in arguments.items()}
