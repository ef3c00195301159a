"""Read boundaries (boundaries.json) and landmarks (landmarks.json). `drawn_changes` changes them."""

from __future__ import annotations

import hashlib
import json
import unicodedata
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mammometry.base.errors import SessionError
from mammometry.base.parse import json_value, numbers, parsing, read_text, shown
from mammometry.geometry.arrays import Array, Float64
from mammometry.job.inputs import SubjectKind
from mammometry.measure.landmarks.landmarks import LANDMARKS
from mammometry.measure.volume.attribution import Attribution, CurveConfirmation

BOUNDARIES, LANDMARK_FILE = "boundaries.json", "landmarks.json"
BREASTS: Mapping[SubjectKind, tuple[str, ...]] = {"model": ("model",), "torso": ("left", "right"), "surface": ()}
"""Kind of subject → names of its boundaries."""
_FARTHEST_MM = 1e6  # 1 km: larger than the distance of any photographed object


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrawnBoundaries:
    """Content of a boundaries.json."""

    curves: Mapping[str, Float64[Array, "n 3"]] = field(default_factory=dict)
    """Breast → closed curve, mm, world frame."""
    automatic: tuple[str, ...] = ()
    """Breasts whose boundary is found automatically."""
    removed: tuple[Literal["left", "right"], ...] = ()
    """Breasts that have been surgically removed, so they are not searched for."""
    attributions: Mapping[str, Attribution] = field(default_factory=dict)
    """Breast → who drew its boundary, and who confirmed it."""


def read_boundaries(session: Path, kind: SubjectKind, subject: str | None = None) -> DrawnBoundaries:
    """A session's boundaries. Empty without the file. For errors see `boundaries_in`."""
    path = session / BOUNDARIES
    return boundaries_in(path, BREASTS[kind], subject) if path.is_file() else DrawnBoundaries()


def read_landmarks(session: Path, kind: SubjectKind, subject: str | None = None) -> dict[str, Float64[Array, "k 3"]]:
    """A session's landmarks → points (k, 3), mm, world frame.

    Empty without the file. For errors see `landmarks_in`.
    """
    path = session / LANDMARK_FILE
    return landmarks_in(path, kind, subject) if path.is_file() else {}


def boundaries_digest(drawn: DrawnBoundaries) -> str:
    """Digest of everything that affects a measurement: curves and methods, but not confirmations."""
    parts: dict[str, object] = {name: points.tolist() for name, points in drawn.curves.items()}
    methods = {name: drawn.attributions[name].method for name in drawn.curves}
    if any(methods.values()):
        parts["methods"] = methods
    if drawn.curves and drawn.automatic:
        parts["automatic"] = list(drawn.automatic)
    if drawn.removed:
        parts["removed"] = list(drawn.removed)
    return _digest(parts)


def landmarks_digest(places: Mapping[str, Float64[Array, "k 3"]]) -> str:
    """Digest of marked landmarks."""
    return _digest({name: points.tolist() for name, points in places.items()})


def _digest(parts: Mapping[str, object]) -> str:
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def boundaries_in(path: Path, allowed: tuple[str, ...], subject: str | None = None) -> DrawnBoundaries:
    """Read the boundaries of a file.

    Args:
        path: the file.
        allowed: names of breasts that the subject can have.
        subject: identifier of the subject. If the file also names one, they must be equal.

    Raises:
        SessionError: the file is missing or not as documented, is of another subject, or names a breast that the
            subject cannot have.
    """
    entries = read_table(path, "boundaries", subject)["boundaries"]
    curves: dict[str, Float64[Array, "n 3"]] = {}
    automatic: list[str] = []
    removed: list[Literal["left", "right"]] = []
    for name, entry in entries.items():
        _allow(path, name, allowed)
        if entry.get("automatic") is True and "points" not in entry:
            automatic.append(name)
        elif name in ("left", "right") and entry.get("removed") is True and "points" not in entry:
            removed.append("left" if name == "left" else "right")
        else:
            curves[name] = _points(path, name, entry)
            _require(path, name, curves[name], 3)
    return DrawnBoundaries(
        curves=curves,
        automatic=tuple(automatic),
        removed=tuple(removed),
        attributions={name: _attribution(path, name, entry) for name, entry in entries.items()},
    )


def landmarks_in(path: Path, kind: SubjectKind, subject: str | None = None) -> dict[str, Float64[Array, "k 3"]]:
    """Read landmarks → points (k, 3), mm, world frame.

    Raises:
        SessionError: the file is missing or not as documented, is of another subject, or names a landmark that the
            subject cannot have.
    """
    kinds = {landmark.name: landmark.kind for landmark in LANDMARKS[kind]}
    places = {}
    for name, entry in read_table(path, "landmarks", subject)["landmarks"].items():
        _allow(path, name, tuple(kinds))
        places[name] = _points(path, name, entry)
        _require(path, name, places[name], 2 if kinds[name] == "line" else 1)
        if kinds[name] == "point" and len(places[name]) > 1:
            raise _wrong(f"{path.name}: {name}", f"{len(places[name])} points", "one", "Keep one of them")
    return places


def read_table(path: Path, key: str, subject: str | None = None) -> dict[str, Any]:
    """Read a file of drawn items. Checks units, frame and subject, and that entries are tables.

    Raises:
        SessionError: it cannot be read, is not as documented, or is of another subject.
    """
    form = f'{{"{key}": {{NAME: {{"points": [[x, y, z], …]}}}}}} in mm, world frame'
    table = json_value(read_text(path, path.name, form), path.name, form)
    with parsing("wrong content", path.name, form):
        if not all(isinstance(entry, dict) for entry in table[key].values()):
            raise ValueError("an entry that is not a table")
        units, frame = table.get("units", "mm"), table.get("frame", "world")
    if (units, frame) != ("mm", "world"):
        raise _wrong(
            path.name, f"units {shown(units)} and frame {shown(frame)}", "'mm' and 'world'", "Convert the points"
        )
    theirs = table.get("subject")
    if isinstance(theirs, str):
        theirs = unicodedata.normalize("NFC", theirs)  # NFC, as in `subject_id`
    if subject is not None and theirs is not None and theirs != subject:
        raise _wrong(
            path.name,
            f"the drawing of subject {shown(theirs)}",
            f"one of subject {subject!r}, as in session.toml",
            "Put the right file here, or correct the subject",
        )
    return table


def origin_words(entry: Mapping[str, Any]) -> str | None:
    """Origin of an entry, such as "drawn by hand by A on 2026-11-22". None if unknown."""
    return _chain(entry, _who)


def _chain(entry: Mapping[str, Any], who: Callable[[Mapping[str, Any]], str]) -> str | None:
    if not entry.get("method"):
        return None
    steps = [entry, *reversed(entry.get("earlier", []))]
    return ", from ".join(f"{step['method']}{who(step)}" for step in steps if step.get("method"))


def _who(step: Mapping[str, Any]) -> str:
    author, moment = step.get("author"), step.get("drawn")
    return (f" by {author}" if author else "") + (f" on {moment[:10]}" if moment else "")


def _attribution(path: Path, name: str, entry: Mapping[str, Any]) -> Attribution:
    try:
        seen = entry.get("confirmed")
        confirmation = None if seen is None else CurveConfirmation(**{key: seen[key] for key in ("by", "at", "curve")})
        texts = [entry.get(key) for key in ("method", "author", "drawn")]
        texts += [step.get(key) for step in entry.get("earlier", []) for key in ("method", "author", "drawn")]
        texts += [] if confirmation is None else [confirmation.by, confirmation.at, confirmation.curve]
        if not all(text is None or isinstance(text, str) for text in texts):
            raise TypeError("a value that is not text")
    except (KeyError, TypeError, AttributeError) as error:
        raise _wrong(
            f"{path.name}: {name}",
            f"wrong content ({error})",
            'texts as "method", "author" and "drawn", and "confirmed" with "by", "at" and "curve"',
            "Correct it",
        ) from None
    return Attribution(method=_chain(entry, lambda step: ""), origin=origin_words(entry), confirmation=confirmation)


def _points(path: Path, name: str, entry: Mapping[str, Any]) -> Float64[Array, "n 3"]:
    form = '"points": [[x, y, z], …]'
    if "points" not in entry:
        raise _wrong(f"{path.name}: {name}", "no points", form, "Correct it")
    with parsing("points that are not [x, y, z]", f"{path.name}: {name}", form):
        points = numbers(entry["points"], -1, 3)
    if points.size and np.abs(points).max() > _FARTHEST_MM:
        raise _wrong(
            f"{path.name}: {name}",
            f"a coordinate of {np.abs(points).max():.3g} mm",
            "points on the subject",
            "Correct it",
        )
    return points


def _allow(path: Path, name: str, allowed: tuple[str, ...]) -> None:
    if name not in allowed:
        raise _wrong(
            f"{path.name}: {name}",
            "an unknown name",
            f"one of {', '.join(allowed) or 'none: an open surface has none'}",
            "Rename it, or correct [subject] kind in session.toml",
        )


def _require(path: Path, name: str, points: Float64[Array, "n 3"], least: int) -> None:
    if len(points) < least:
        raise _wrong(f"{path.name}: {name}", f"{len(points)} points", f"at least {least}", "Draw it again")


def _wrong(subject: str, found: str, expected: str, remedy: str) -> SessionError:
    return SessionError(subject, found=found, expected=expected, remedy=remedy)
