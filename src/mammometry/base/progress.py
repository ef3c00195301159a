"""Progress callback of all stages, independent of any terminal."""

from collections.abc import Callable
from typing import TypeAlias

Progress: TypeAlias = Callable[[float], None]
"""Called with the fraction done, 0 to 1, never decreasing within a stage."""


def no_progress(fraction: float) -> None:
    """Ignore the progress: the default of every stage."""


def part(progress: Progress, start: float, stop: float) -> Progress:
    """Map a sub-task's 0…1 onto `start`…`stop` of the task that `progress` follows."""
    return lambda fraction: progress(start + (stop - start) * fraction)
