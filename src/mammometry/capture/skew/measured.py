"""Differences of the cameras' exposures, as measured with the counting lamps."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from mammometry.base.errors import SessionError
from mammometry.base.parse import read_text
from mammometry.base.value import value
from mammometry.io.write import write_text

SKEW = "skew.json"
_FORMAT = 1  # version of skew.json


@value
class Skew:
    """When each camera exposed."""

    offset_ms: Mapping[str, float]
    """Camera → begin of its exposure after the median camera's. Read-only."""
    std_ms: float
    """Standard uncertainty of one offset, the largest of all."""
    measured: str
    """When, UTC, ISO 8601."""
    exposure_ms: float
    """Length of the exposures by which it was measured."""

    @property
    def spread_ms(self) -> float:
        """From the first to the last exposure."""
        return max(self.offset_ms.values()) - min(self.offset_ms.values())

    @property
    def worst(self) -> str:
        """The camera farthest from the median."""
        return max(self.offset_ms, key=lambda name: abs(self.offset_ms[name]))

    def as_table(self) -> dict[str, object]:
        """As JSON."""
        return {
            "format": _FORMAT,
            "measured": self.measured,
            "exposure_ms": self.exposure_ms,
            "spread_ms": round(self.spread_ms, 4),
            "std_ms": round(self.std_ms, 4),
            "offset_ms": {name: round(value, 4) for name, value in self.offset_ms.items()},
        }


def write_skew(folder: Path, skew: Skew) -> Path:
    """Write skew.json into a session.

    Raises:
        StorageError: the disk is full or refuses.
    """
    path = folder / SKEW
    write_text(path, json.dumps(skew.as_table(), indent=1) + "\n")
    return path


def read_skew(folder: Path) -> Skew | None:
    """Read a session's skew.json. None where there is none.

    Raises:
        SessionError: it is not as `write_skew` writes it.
    """
    path = folder / SKEW
    if not path.is_file():
        return None
    try:
        table = json.loads(read_text(path, SKEW, "a skew.json", most_mib=1))
        if table["format"] != _FORMAT:
            raise ValueError("another format")
        return Skew(
            offset_ms={str(name): float(value) for name, value in table["offset_ms"].items()},
            std_ms=float(table["std_ms"]),
            measured=str(table["measured"]),
            exposure_ms=float(table["exposure_ms"]),
        )
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise SessionError(
            str(path), found="no record of a measured skew", expected="the file as `mammometry skew` wrote it",
            remedy="Remove it, and measure the skew again",
        ) from None  # fmt: skip
