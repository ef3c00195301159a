"""What stands in a visit's session folder beside the database.

The report, its scene, its warnings.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from mammometry.clinic.models import Visit
from mammometry.report.scene import json_in_page

_LARGEST = 64 << 20  # bytes of a report; ours have a few MB


@dataclass(frozen=True, slots=True)
class Facts:
    """What a reader must know beside the volumes."""

    warnings: tuple[str, ...]


def report_file(visit: Visit, name: str) -> Path | None:
    """A file of the visit's report.

    None if there is none.
    """
    path = visit.folder / "results" / "report" / name
    return path if path.is_file() and not path.is_symlink() and path.stat().st_size <= _LARGEST else None


def facts(visit: Visit) -> Facts:
    """Warnings of the report."""
    path = report_file(visit, "warnings.json")
    try:
        warnings = [] if path is None else json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        warnings = []
    return Facts(tuple(str(each) for each in warnings) if isinstance(warnings, list) else ())


def scene_of(visit: Visit) -> str | None:
    """The 3D scene of the visit's report, as JSON.

    None if there is none.
    """
    path = report_file(visit, "report.html")
    return None if path is None else json_in_page(path.read_text(encoding="utf-8"))
