"""What a check of a photograph found."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, TypeAlias

Level: TypeAlias = Literal["ok", "unknown", "warn", "refuse"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """One check of one photograph, or of all of them together."""

    check: str
    """What was looked at: format, camera, size, sharpness, exposure, whole, times, twice, digest."""
    level: Level
    """``unknown``: it cannot be told; ``warn``: somebody should look; ``refuse``: it cannot be used."""
    sentence: str
    """For the one who photographs: what, and what to do."""

    def as_table(self) -> dict[str, object]:
        """As JSON.

        Level, and ``ok``, which is none where it cannot be told.
        """
        ok = None if self.level == "unknown" else self.level == "ok"
        return {"check": self.check, "ok": ok, "level": self.level, "sentence": self.sentence}


def refuses(found: Iterable[Found]) -> bool:
    """Whether one of them says that the photograph cannot be used."""
    return any(finding.level == "refuse" for finding in found)
