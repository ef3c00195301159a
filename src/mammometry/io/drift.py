"""History of a rig's checks: a file in `checks` with one JSON object per line.

Lines are only added. Lines that cannot be read are skipped and left unchanged.
"""

import json
import logging
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock

from mammometry.base.errors import SessionError
from mammometry.base.notices import Notice
from mammometry.base.parse import json_value
from mammometry.calibration.judge.check import CameraCheck, RigCheck
from mammometry.io.write import disk_errors, sync_folder

FOLDER = "checks"
HISTORY = "history.jsonl"
DRAWN = "drift.png"
_LOCK = ".history.lock"
_FORMAT = 1  # version of a line of the history; others are not read
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraDrift:
    """Displacement of one camera from its calibration in one check."""

    moved: bool
    shift_mm: float
    """Displacement of the perspective centre, mm, if the camera did not rotate. A rotation may be the cause instead."""
    turn_deg: float
    shift_px: float
    sigma: float


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftEntry:
    """One check of a rig, as a line of its history."""

    when: str
    """Time of the check, ISO 8601, local time."""
    image_set: str
    """Folder of its photographs."""
    calibration: str
    """Digest of the calibration's cameras. Checks against the same calibration have the same."""
    verdict: str
    effect_mm: float
    """RMS displacement of measured points for the worst pair."""
    reasons: tuple[str, ...]
    cameras: Mapping[str, CameraDrift]
    photographs: Mapping[str, str] = field(default_factory=dict)
    """Exposure and camera → digest of the photograph's pixels. Empty in entries of version 1.0."""


@dataclass(frozen=True, slots=True, kw_only=True)
class History:
    """All checks of a rig."""

    entries: tuple[DriftEntry, ...] = ()
    """Oldest first."""
    notices: tuple[Notice, ...] = ()
    """Lines that cannot be read."""


def entry_of(
    result: RigCheck, *, when: str, image_set: str, calibration: str, photographs: Mapping[str, str]
) -> DriftEntry:
    """Make the history's entry of a check."""
    return DriftEntry(
        when=when,
        image_set=image_set,
        calibration=calibration,
        verdict=result.verdict,
        effect_mm=result.effect_mm,
        reasons=result.reasons,
        cameras={name: _drift(camera) for name, camera in result.cameras.items()},
        photographs=dict(photographs),
    )


def _drift(check: CameraCheck) -> CameraDrift:
    motion = check.motion
    return CameraDrift(
        moved=check.moved,
        shift_mm=motion.alone_mm if motion.kind == "either" else float(np.linalg.norm(motion.shift_mm)),
        turn_deg=float(np.degrees(motion.alone_rad if motion.kind == "either" else np.linalg.norm(motion.turn_rad))),
        shift_px=check.shift_px,
        sigma=motion.sigma,
    )


def entry_table(entry: DriftEntry) -> dict[str, Any]:
    """An entry as a plain table, for a line of the history."""
    cameras = {
        name: {
            "moved": camera.moved,
            "shift_mm": round(camera.shift_mm, 5),
            "turn_deg": round(camera.turn_deg, 6),
            "shift_px": round(camera.shift_px, 4),
            "sigma": round(camera.sigma, 2),
        }
        for name, camera in entry.cameras.items()
    }
    return {
        "format": _FORMAT,
        "when": entry.when,
        "image_set": entry.image_set,
        "calibration": entry.calibration,
        "verdict": entry.verdict,
        "effect_mm": round(entry.effect_mm, 5),
        "reasons": list(entry.reasons),
        "cameras": cameras,
        **({"photographs": dict(entry.photographs)} if entry.photographs else {}),
    }


def read_history(session: Path) -> History:
    """Read all checks of a session's rig, oldest first. Empty if there is no history.

    Raises:
        StorageError: the disk reports an error.
    """
    path = session / FOLDER / HISTORY
    with disk_errors(path):
        lines = path.read_bytes().split(b"\n") if path.exists() else []
    entries: list[DriftEntry] = []
    unreadable: list[Notice] = []
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            entries.append(_entry(json_value(line.decode(), "the line", "JSON", finite=False)))
        except (SessionError, ValueError, KeyError, TypeError, AttributeError) as error:
            _LOG.warning("%s/%s, line %d: %s", FOLDER, HISTORY, number, error)
            values: dict[str, float | str] = {"file": f"{FOLDER}/{HISTORY}", "line": number, "error": str(error)}
            unreadable.append(Notice(code="check-unreadable", values=values))
    return History(entries=tuple(entries), notices=tuple(unreadable))


def append_history(session: Path, entry: DriftEntry) -> None:
    """Append a check to the history.

    Returns when it is on the disk. Concurrent checks wait for each other.

    Raises:
        StorageError: the disk is full or reports an error.
    """
    folder = session / FOLDER
    line = json.dumps(entry_table(entry)).encode() + b"\n"
    with disk_errors(folder):
        folder.mkdir(exist_ok=True)
        with FileLock(folder / _LOCK), (folder / HISTORY).open("a+b") as file:
            if file.seek(0, os.SEEK_END):
                file.seek(-1, os.SEEK_END)
                if file.read(1) != b"\n":  # truncated by a power failure: start a new line
                    line = b"\n" + line
            file.write(line)
            file.flush()
            os.fsync(file.fileno())
        sync_folder(folder)


def _entry(table: dict[str, Any]) -> DriftEntry:
    if table["format"] != _FORMAT:
        raise ValueError(f"format {table['format']}, not {_FORMAT}")
    effect_mm = float(table["effect_mm"])
    if not math.isfinite(effect_mm):  # it cannot be drawn
        raise ValueError(f"effect_mm {effect_mm}")
    return DriftEntry(
        when=str(table["when"]),
        image_set=str(table["image_set"]),
        calibration=str(table["calibration"]),
        verdict=str(table["verdict"]),
        effect_mm=effect_mm,
        reasons=tuple(map(str, table["reasons"])),
        cameras={
            str(name): CameraDrift(
                moved=bool(drift["moved"]),
                shift_mm=float(drift["shift_mm"]),
                turn_deg=float(drift["turn_deg"]),
                shift_px=float(drift["shift_px"]),
                sigma=float(drift["sigma"]),
            )
            for name, drift in table["cameras"].items()
        },
        photographs={str(shot): str(digest) for shot, digest in table.get("photographs", {}).items()},
    )
