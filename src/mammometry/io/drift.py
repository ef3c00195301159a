"""The small history of a rig's checks: one JSON object a line, in its folder `checks`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.calibration.check import CameraCheck, RigCheck
from mammometry.errors import SessionError, StorageError
from mammometry.io.write import write_text
from mammometry.parse import json_value, read_text

FOLDER = "checks"
HISTORY = "history.jsonl"
DRAWN = "drift.png"
_FORMAT = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraDrift:
    """How far one camera stood from its calibration in one check."""

    moved: bool
    shift_mm: float
    """Of the perspective centre; what a pure displacement would be, where it may have been a rotation."""
    turn_deg: float
    shift_px: float
    sigma: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One check of a rig."""

    when: str
    """Moment of the check, ISO 8601, local time."""
    image_set: str
    """Where its photographs lay."""
    calibration: str
    """Digest of the cameras that it was compared with: entries of one calibration belong together."""
    verdict: str
    effect_mm: float
    """RMS displacement of measured points by the worst pair."""
    reasons: tuple[str, ...]
    cameras: Mapping[str, CameraDrift]


def entry_of(result: RigCheck, *, when: str, image_set: str, calibration: str) -> Entry:
    """What a check leaves in the history."""
    return Entry(
        when=when,
        image_set=image_set,
        calibration=calibration,
        verdict=result.verdict,
        effect_mm=result.effect_mm,
        reasons=result.reasons,
        cameras={name: _drift(one) for name, one in result.cameras.items()},
    )


def _drift(one: CameraCheck) -> CameraDrift:
    motion = one.motion
    return CameraDrift(
        moved=one.moved,
        shift_mm=motion.alone_mm if motion.kind == "either" else float(np.linalg.norm(motion.shift_mm)),
        turn_deg=float(np.degrees(motion.alone_rad if motion.kind == "either" else np.linalg.norm(motion.turn_rad))),
        shift_px=one.shift_px,
        sigma=motion.sigma,
    )


def entry_table(entry: Entry) -> dict[str, Any]:
    """An entry as a plain table: a line of the history."""
    cameras = {
        name: {
            "moved": one.moved,
            "shift_mm": round(one.shift_mm, 5),
            "turn_deg": round(one.turn_deg, 6),
            "shift_px": round(one.shift_px, 4),
            "sigma": round(one.sigma, 2),
        }
        for name, one in entry.cameras.items()
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
    }


def read_history(session: Path) -> tuple[Entry, ...]:
    """All checks of the rig of a session, the oldest first; none where there is no history.

    Raises:
        StorageError: a line that is no entry.
    """
    path = session / FOLDER / HISTORY
    if not path.exists():
        return ()
    entries: list[Entry] = []
    try:
        text = read_text(path, f"{FOLDER}/{HISTORY}", "lines as `mammometry check` writes them", refusal=StorageError)
        for line in text.splitlines():
            entries.append(_entry(json_value(line, "the line", "JSON", finite=False)))
    except (SessionError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise StorageError(
            f"{FOLDER}/{HISTORY}, line {len(entries) + 1}",
            found=f"no entry of a check ({error})",
            expected="lines as `mammometry check` writes them",
            remedy="Correct or remove that line; nothing but the history depends on it",
        ) from None
    return tuple(entries)


def append_history(session: Path, entry: Entry) -> tuple[Entry, ...]:
    """Add a check to the history, whole or not at all; returns all of it.

    Raises:
        StorageError: the history cannot be read or written.
    """
    entries = (*read_history(session), entry)
    lines = [json.dumps(entry_table(each), ensure_ascii=False) for each in entries]
    folder = session / FOLDER
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise StorageError(
            str(folder),
            found=f"a folder that cannot be made ({error.strerror})",
            expected="permission and room to write",
            remedy="Change the session's permissions, or copy it elsewhere",
        ) from None
    write_text(folder / HISTORY, "\n".join(lines) + "\n")
    return entries


def _entry(table: dict[str, Any]) -> Entry:
    if table["format"] != _FORMAT:
        raise ValueError(f"format {table['format']}, not {_FORMAT}")
    return Entry(
        when=str(table["when"]),
        image_set=str(table["image_set"]),
        calibration=str(table["calibration"]),
        verdict=str(table["verdict"]),
        effect_mm=float(table["effect_mm"]),
        reasons=tuple(map(str, table["reasons"])),
        cameras={
            str(name): CameraDrift(
                moved=bool(one["moved"]),
                shift_mm=float(one["shift_mm"]),
                turn_deg=float(one["turn_deg"]),
                shift_px=float(one["shift_px"]),
                sigma=float(one["sigma"]),
            )
            for name, one in table["cameras"].items()
        },
    )
