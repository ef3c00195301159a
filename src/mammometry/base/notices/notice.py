"""Notices: remarks on results, as codes with values.

Products and programs store and compare notices. Their texts are in `base.notices.texts`, so that no decision depends on
a sentence, and a translation is another catalogue.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

Level: TypeAlias = Literal["warning", "note"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Notice:
    """A remark on a result, as a code with values."""

    code: str
    """Identifies the notice for programs. A code never changes its meaning."""
    level: Level = "warning"
    """``warning``: it affects the meaning of the volumes. ``note``: for information."""
    about: tuple[str, ...] = ()
    """Breasts ("left"), cameras or pairs that it concerns."""
    photographs: tuple[str, ...] = ()
    """Photographs that show it: ``capture/CAMERA`` or ``calibration/POSE/CAMERA``."""
    values: Mapping[str, int | float | str] = field(default_factory=dict)
    """Values in the text, by name. The name contains the unit: ``percent``, ``cm2``, ``px``."""

    def as_table(self) -> dict[str, object]:
        """The notice for JSON."""
        return {
            "code": self.code,
            "level": self.level,
            "about": list(self.about),
            "photographs": list(self.photographs),
            "values": dict(self.values),
        }


def from_table(table: Mapping[str, Any]) -> Notice:
    """Read a notice from JSON."""
    return Notice(
        code=table["code"],
        level=table["level"],
        about=tuple(table["about"]),
        photographs=tuple(table.get("photographs", ())),
        values=dict(table["values"]),
    )
