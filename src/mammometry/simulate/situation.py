"""Disturbances of a virtual capture, as written on the command line.

Each has a name and may have a size. ``rail,drift=0.02,removed=right`` is a rail in front of the body, every camera
turned by 0.02° after the calibration, and the right breast removed. The names are those of
`disturbances.registry.DISTURBANCES`.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Disturbance:
    """One disturbance."""

    name: str
    """In the registry."""
    size: str = ""
    """Size or kind: a number or a word. Empty for the usual one."""

    def __str__(self) -> str:
        return f"{self.name}={self.size}" if self.size else self.name


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """All that disturbs one capture."""

    disturbances: tuple[Disturbance, ...] = ()
    """Each name once. The order changes nothing that is drawn."""

    def __str__(self) -> str:
        return ",".join(map(str, self.disturbances))

    def without(self, names: Collection[str]) -> Situation:
        """Return the same situation without some disturbances.

        It serves comparisons of a body with and without them, all else equal.
        """
        return Situation(
            disturbances=tuple(disturbance for disturbance in self.disturbances if disturbance.name not in names)
        )


def parse_situation(text: str) -> Situation:
    """Read ``rail,drift=0.02``.

    Raises:
        ValueError: a part has no name, or a name stands there twice.
    """
    found: dict[str, Disturbance] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, _, size = (word.strip() for word in part.partition("="))
        if not name or name in found:
            raise ValueError(f"disturbances are written as rail,drift=0.02, each once, found {text!r}")
        found[name] = Disturbance(name=name, size=size)
    return Situation(disturbances=tuple(found.values()))
