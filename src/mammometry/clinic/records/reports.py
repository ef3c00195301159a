"""What stands in a visit's session folder beside the database. The report, its scene, its warnings."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from mammometry.api.refused import FOLDER
from mammometry.clinic.models import Visit
from mammometry.report.figures.drawing.canvas import Caption, caption_of
from mammometry.report.scene import json_in_page

_OF_THE_STATE = ("Nobody has confirmed the automatic boundary", "Boundaries are drawn and confirmed with")
"""How warnings begin that the visit's state says already: `report.rendering` writes them."""
_OF_PHOTOGRAPHS = ("Pose ", "Pair ", "Something hides part", "The subject was not separated")
"""How warnings begin that concern single photographs: `report.warnings` writes them."""
_LARGEST = 64 << 20  # bytes of a report; ours have a few MB


@dataclass(frozen=True, slots=True)
class Facts:
    """What a reader must know beside the volumes."""

    warnings: tuple[str, ...]
    """What concerns the numbers."""
    notes: tuple[str, ...] = ()
    """What concerns single photographs and how they were matched."""


def report_file(visit: Visit, name: str) -> Path | None:
    """A file of the visit's report. None if there is none."""
    return readable(visit.folder / "results" / "report" / name)


def readable(path: Path) -> Path | None:
    """A file of ours that may be shown. None if there is none."""
    return path if path.is_file() and not path.is_symlink() and path.stat().st_size <= _LARGEST else None


def refusal_pictures(visit: Visit) -> dict[str, Caption]:
    """What the visit's refused measurement saw: name of each picture → its caption."""
    paths = sorted((visit.folder / "results" / FOLDER).glob("*.png"))
    return {path.stem: caption_of(path.read_bytes()) for path in paths if readable(path)}


def refusal_picture(visit: Visit, name: str) -> bytes | None:
    """One of those pictures, as PNG. None if there is none."""
    path = readable(visit.folder / "results" / FOLDER / f"{name}.png")
    return None if path is None else path.read_bytes()


def facts(visit: Visit) -> Facts:
    """Warnings of the report, without what the visit's state says."""
    path = report_file(visit, "warnings.json")
    try:
        warnings = [] if path is None else json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        warnings = []
    sentences = [str(warning) for warning in warnings] if isinstance(warnings, list) else []
    sentences = [sentence for sentence in sentences if not sentence.startswith(_OF_THE_STATE)]
    return Facts(
        tuple(sentence for sentence in sentences if not sentence.startswith(_OF_PHOTOGRAPHS)),
        tuple(sentence for sentence in sentences if sentence.startswith(_OF_PHOTOGRAPHS)),
    )


def scene_of(visit: Visit) -> str | None:
    """The 3D scene of the visit's report, as JSON. None if there is none."""
    path = report_file(visit, "report.html")
    return None if path is None else json_in_page(path.read_text(encoding="utf-8"))
