"""What people draw on a subject: boundaries.json and landmarks.json of a session, and every earlier version of them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from mammometry.errors import SessionError, StorageError
from mammometry.geometry.arrays import Array, Float64
from mammometry.inputs import SubjectKind
from mammometry.io.write import write_bytes
from mammometry.measure.landmarks import LANDMARKS
from mammometry.parse import json_value, numbers, parsing, read_text, shown

BOUNDARIES, LANDMARK_FILE, HISTORY = "boundaries.json", "landmarks.json", "history"
BREASTS: Mapping[SubjectKind, tuple[str, ...]] = {"model": ("model",), "torso": ("left", "right"), "surface": ()}
"""Kind of subject → names of its boundaries."""


def read_boundaries(session: Path, kind: SubjectKind) -> dict[str, Float64[Array, "n 3"]]:
    """A session's closed curves by breast, mm, world frame; empty without the file. Raises as `boundaries_in`."""
    path = session / BOUNDARIES
    return boundaries_in(path, BREASTS[kind]) if path.is_file() else {}


def read_landmarks(session: Path, kind: SubjectKind) -> dict[str, Float64[Array, "k 3"]]:
    """A session's points or lines by landmark, mm, world frame; empty without the file. Raises as `landmarks_in`."""
    path = session / LANDMARK_FILE
    return landmarks_in(path, kind) if path.is_file() else {}


def boundaries_in(path: Path, allowed: tuple[str, ...]) -> dict[str, Float64[Array, "n 3"]]:
    """Closed curves by breast, mm, world frame.

    Args:
        path: of the file.
        allowed: names of breasts that the subject may have.

    Raises:
        SessionError: the file is not there or not as documented, or names a breast that the subject has not.
    """
    form = '{"boundaries": {NAME: {"points": [[x, y, z], …]}}} in mm, world frame'
    curves = _read(path, "boundaries", form, allowed)
    for name, points in curves.items():
        _require(path.name, name, points, 3)
    return curves


def landmarks_in(path: Path, kind: SubjectKind) -> dict[str, Float64[Array, "k 3"]]:
    """Points or lines by landmark, mm, world frame.

    Raises:
        SessionError: the file is not there or not as documented, or names a landmark that the subject has not.
    """
    form = '{"landmarks": {NAME: {"points": [[x, y, z]]}}} in mm, world frame'
    kinds = {landmark.name: landmark.kind for landmark in LANDMARKS[kind]}
    places = _read(path, "landmarks", form, tuple(kinds))
    for name, points in places.items():
        _require(path.name, name, points, 2 if kinds[name] == "line" else 1)
        if kinds[name] == "point" and len(points) > 1:
            raise _wrong(f"{path.name}: {name}", f"{len(points)} points", "one", "Keep one of them")
    return places


def write_drawn(
    session: Path,
    boundaries: Mapping[str, Float64[Array, "n 3"]],
    landmarks: Mapping[str, Float64[Array, "k 3"]],
    *,
    author: str,
) -> tuple[Path, ...]:
    """Replace what was drawn; what stood there before is kept in ``history/``, by the moment it was replaced.

    Args:
        session: the session folder.
        boundaries: breast → closed curve, mm, world frame; a file without any is taken away, so that they are found
            by themselves again.
        landmarks: name → its points, mm, world frame.
        author: who or what drew them, kept in the files.

    Returns:
        The files that changed.

    Raises:
        StorageError: the session cannot be written to.
    """
    moment = datetime.now(UTC)
    changed = []
    for file, key, places in ((BOUNDARIES, "boundaries", boundaries), (LANDMARK_FILE, "landmarks", landmarks)):
        path = session / file
        before = path.read_bytes() if path.is_file() else None
        if before is None and not places:
            continue
        table = {
            "units": "mm",
            "frame": "world",
            "drawn": moment.strftime("%Y-%m-%dT%H:%M:%SZ"),
            key: {name: {"method": author, "points": np.round(points, 4).tolist()} for name, points in places.items()},
        }
        try:
            if before is not None:
                if _holds(before, key, table[key]):
                    continue
                (session / HISTORY).mkdir(exist_ok=True)
                kept = f"{Path(file).stem}-{moment.strftime('%Y%m%dT%H%M%S.%f')}Z.json"
                write_bytes(session / HISTORY / kept, before)
            if places:
                write_bytes(path, (json.dumps(table, indent=1) + "\n").encode())
            else:
                path.unlink()
        except OSError as error:
            raise StorageError(
                file,
                found=error.strerror or str(error),
                expected="a session folder that can be written to",
                remedy="Check its permissions and the room on its disk",
            ) from None
        changed.append(path)
    return tuple(changed)


def _holds(content: bytes, key: str, wanted: object) -> bool:
    """Whether a file says the same already; one that cannot be read does not, and is kept all the same."""
    try:
        return bool(json_value(content.decode("utf-8-sig"), key, "JSON")[key] == wanted)
    except (SessionError, ValueError, LookupError, TypeError):
        return False


def _read(path: Path, key: str, form: str, allowed: tuple[str, ...]) -> dict[str, Float64[Array, "n 3"]]:
    table = json_value(read_text(path, path.name, form), path.name, form)
    with parsing("another content", path.name, form):
        found = {name: numbers(entry["points"], -1, 3) for name, entry in table[key].items()}
        units, frame = table.get("units", "mm"), table.get("frame", "world")
    if (units, frame) != ("mm", "world"):
        raise _wrong(
            path.name, f"units {shown(units)} and frame {shown(frame)}", "'mm' and 'world'", "Convert the points"
        )
    for name in found:
        if name not in allowed:
            raise _wrong(
                f"{path.name}: {name}",
                "an unknown name",
                f"one of {', '.join(allowed) or 'none: an open surface has no such thing'}",
                "Rename it, or correct [subject] kind in session.toml",
            )
    return found


def _require(file: str, name: str, points: Float64[Array, "n 3"], least: int) -> None:
    if len(points) < least:
        raise _wrong(f"{file}: {name}", f"{len(points)} points", f"at least {least}", "Draw it again")


def _wrong(subject: str, found: str, expected: str, remedy: str) -> SessionError:
    return SessionError(subject, found=found, expected=expected, remedy=remedy)
