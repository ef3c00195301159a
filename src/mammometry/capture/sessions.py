"""Session folders of the clinic.

Manifests out of a rig's definition, and a calibration taken over into a visit.

A visit's folder is an ordinary session. Its calibration photographs are those of the rig, as links to the same files
where the disk can, and what was computed from them is taken over: a visit is measured without calibrating again.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mammometry.base.errors import SessionError
from mammometry.io.manifest import MANIFEST, Manifest, parse_manifest
from mammometry.io.photographs.images import EXTENSIONS
from mammometry.io.write import disk_errors, write_text

if TYPE_CHECKING:
    import datetime

    from mammometry.api.job import Job

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_SHARED = ("cameras.json", "prior.json")


def manifest_text(
    definition: Mapping[str, Any], subject_kind: str, subject_id: str | None = None, date: datetime.date | None = None
) -> str:
    """A session.toml.

    Args:
        definition: tables ``rig``, ``target`` and ``intrinsics`` of a manifest, as plain JSON.
        subject_kind: ``torso`` or ``model``.
        subject_id: the patient's pseudonym; None for a rig's own session.
        date: when the photographs were taken.

    Raises:
        SessionError: the definition is none of a rig.
    """
    lines = ["format = 1", 'units = "mm"', *([] if date is None else [f"date = {date.isoformat()}"])]
    for name in ("rig", "target", "intrinsics"):
        if name in definition:
            lines += ["", f"[{name}]", *_lines(definition[name])]
    about = {"kind": subject_kind, **({} if subject_id is None else {"id": subject_id})}
    text = "\n".join([*lines, "", "[subject]", *_lines(about)]) + "\n"
    parse_manifest(text)
    return text


def definition_of(manifest: Manifest) -> dict[str, Any]:
    """What a session.toml says of its rig, as a rig's definition."""
    table = manifest.model_dump(mode="json", include={"rig", "target", "intrinsics"}, exclude_none=True)
    return {name: table[name] for name in ("rig", "target", "intrinsics") if name in table}


def cameras_of(definition: Mapping[str, Any]) -> tuple[str, ...]:
    """Cameras of a rig's definition, each once, in its order."""
    pairs = definition.get("rig", {}).get("pairs", [])
    return tuple(dict.fromkeys(str(pair[side]) for pair in pairs for side in ("left", "right")))


def make_session(folder: Path, manifest: str) -> None:
    """Make a session's folder, or bring its manifest up to date.

    Raises:
        StorageError: the disk is full or refuses.
    """
    with disk_errors(folder):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        (folder / "capture").mkdir(exist_ok=True)
        if not (folder / MANIFEST).is_file() or (folder / MANIFEST).read_text(encoding="utf-8") != manifest:
            write_text(folder / MANIFEST, manifest)


def share_calibration(calibration: Path, session: Path) -> None:
    """Put a rig's calibration photographs into a visit's folder. They replace what was there.

    Raises:
        StorageError: the disk is full or refuses.
    """
    with disk_errors(session):
        wanted = {
            path.relative_to(calibration): path
            for path in sorted((calibration / "calibration").rglob("*"))
            if path.is_file() and path.suffix.lower() in (*EXTENSIONS, ".csv")
        }
        wanted |= {Path(name): calibration / name for name in _SHARED if (calibration / name).is_file()}
        present = {path.relative_to(session) for path in (session / "calibration").rglob("*") if path.is_file()}
        present |= {Path(name) for name in _SHARED if (session / name).is_file()}
        for name in present - set(wanted):
            (session / name).unlink()
        for name, path in wanted.items():
            target = session / name
            if target.is_file() and _is_same(target, path):
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            target.unlink(missing_ok=True)
            try:
                os.link(path, target)
            except OSError:  # another disk, or one without links
                shutil.copy2(path, target)


def _is_same(copy: Path, path: Path) -> bool:
    """Whether a file is a link to another, or its copy."""
    ours, theirs = copy.stat(), path.stat()
    return copy.samefile(path) or (ours.st_size, ours.st_mtime_ns) == (theirs.st_size, theirs.st_mtime_ns)


def take_over(job: Job, source: Job) -> int:
    """Take over what another session computed from the same calibration photographs.

    Return how many results.

    Only what would come out the same is taken: equal keys mean equal inputs, settings and software.

    Raises:
        StorageError: the disk is full or refuses.
    """
    theirs = {product.key.digest: product for product in source.plan.products("calibrate")}
    taken = 0
    for product in job.plan.products("calibrate"):
        same = theirs.get(product.key.digest)
        if same is None or job.store.has(product.key) or not source.store.has(same.key):
            continue
        job.store.recall(product.key, lambda same=same: lambda progress: same())  # type: ignore[misc]
        taken += 1
    return taken


def _lines(table: Mapping[str, Any]) -> list[str]:
    return [f"{_key(name)} = {_value(value)}" for name, value in table.items()]


def _key(name: str) -> str:
    return name if _BARE_KEY.fullmatch(name) else json.dumps(name)


def _value(value: object) -> str:
    """A value as TOML, on one line."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(name)} = {_value(item)}" for name, item in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_value, value)) + "]"
    if isinstance(value, (bool, int, float, str)):
        return json.dumps(value)
    remedy = "Correct the rig"
    expected = "texts, numbers, lists and tables"
    raise SessionError(
        "the rig's definition", found=f"a value of kind {type(value).__name__}", expected=expected, remedy=remedy
    )
