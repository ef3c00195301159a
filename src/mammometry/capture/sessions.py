"""rig.toml, which describes a rig's cameras, and the clinic's session folders."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mammometry.base.errors import SessionError
from mammometry.base.parse import read_text, shown, toml_table
from mammometry.capture.camera import CameraSettings, Devices
from mammometry.io.manifest import MANIFEST, Manifest, parse_manifest
from mammometry.io.photographs.images import EXTENSIONS
from mammometry.io.write import disk_errors, write_text

if TYPE_CHECKING:
    import datetime

    from mammometry.api.job import Job


_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_SHARED = ("cameras.json", "prior.json")


def manifest_text(
    definition: Mapping[str, Any],
    subject_kind: str,
    subject_id: str | None = None,
    date: datetime.date | None = None,
    *,
    posture: str | None = None,
) -> str:
    """Text of a session.toml.

    Args:
        definition: tables ``rig``, ``target`` and ``intrinsics`` of a manifest, as JSON.
        subject_kind: ``torso`` or ``model``.
        subject_id: the patient's pseudonym; None for a rig's own session.
        date: date of the photographs.
        posture: posture of a patient; None: it is left out.

    Raises:
        SessionError: the definition is invalid.
    """
    lines = ["format = 1", 'units = "mm"', *([] if date is None else [f"date = {date.isoformat()}"])]
    for name in ("rig", "target", "intrinsics"):
        if name in definition:
            lines += ["", f"[{name}]", *_lines(definition[name])]
    given = {"kind": subject_kind, "id": subject_id, "posture": posture}
    about = {name: value for name, value in given.items() if value is not None}
    text = "\n".join([*lines, "", "[subject]", *_lines(about)]) + "\n"
    parse_manifest(text)
    return text


def definition_of(manifest: Manifest) -> dict[str, Any]:
    """A rig's definition from a session.toml."""
    table = manifest.model_dump(mode="json", include={"rig", "target", "intrinsics"}, exclude_none=True)
    return {name: table[name] for name in ("rig", "target", "intrinsics") if name in table}


def cameras_of(definition: Mapping[str, Any]) -> tuple[str, ...]:
    """Cameras of a rig's definition, each once, in their order."""
    pairs = definition.get("rig", {}).get("pairs", [])
    return tuple(dict.fromkeys(str(pair[side]) for pair in pairs for side in ("left", "right")))


def make_session(folder: Path, manifest: str) -> None:
    """Create a session's folder, or update its manifest.

    Raises:
        StorageError: the disk is full or refuses.
    """
    with disk_errors(folder):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        (folder / "capture").mkdir(exist_ok=True)
        if not (folder / MANIFEST).is_file() or (folder / MANIFEST).read_text(encoding="utf-8") != manifest:
            write_text(folder / MANIFEST, manifest)


def share_calibration(calibration: Path, session: Path) -> None:
    """Add a rig's calibration photographs to a visit's folder, replacing earlier ones.

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
            except OSError:  # another disk, or one without hard links
                shutil.copy2(path, target)


def _is_same(copy: Path, path: Path) -> bool:
    """Whether a file is a link to another, or a copy of it."""
    ours, theirs = copy.stat(), path.stat()
    return copy.samefile(path) or (ours.st_size, ours.st_mtime_ns) == (theirs.st_size, theirs.st_mtime_ns)


def take_over(job: Job, source: Job) -> int:
    """Copy results that another session computed from the same calibration photographs.

    Returns their number.

    Only results with equal keys are copied: equal inputs, settings and software.

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
    """A value as TOML on one line."""
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


_STRICT = ConfigDict(extra="forbid", strict=True, frozen=True)


class CaptureEntry(BaseModel):
    """The cameras and their back-end."""

    model_config = _STRICT

    backend: str
    """A name in `registry.BACKENDS`."""
    calibration: str | None = None
    """Session folder of the rig's calibration, relative to the rig's file."""
    trigger: Literal["wire", "software"] = "wire"
    exposure_ms: Annotated[float, Field(strict=False, gt=0)] | None = None
    gain_db: Annotated[float, Field(strict=False)] | None = None
    timeout_s: Annotated[float, Field(strict=False, gt=0, le=600)] = 10.0
    """Time limit from the pulse until the picture is on this computer, s."""
    format: Literal["jpg", "png", "tif"] = "jpg"
    """File format of pictures that are delivered as pixels. Files from cameras are kept unchanged."""
    skew_limit_ms: Annotated[float, Field(strict=False, gt=0)] = 1.0
    """Largest measured difference between the cameras' exposures for a patient. Breathing moves the skin by about 20
    mm/s, or 0.02 mm in 1 ms.
    """
    cameras: dict[str, str] = {}
    """Camera → its serial number, address or port."""
    options: dict[str, Any] = {}
    """Options of the back-end."""


class RigFile(Manifest):
    """Content of rig.toml."""

    capture: CaptureEntry

    @property
    def camera_names(self) -> tuple[str, ...]:
        """All cameras of the pairs, each once."""
        return tuple(dict.fromkeys(name for pair in self.rig.pairs for name in (pair.left, pair.right)))

    @property
    def settings(self) -> CameraSettings:
        """Exposure settings of all cameras."""
        entry = self.capture
        return CameraSettings(exposure_ms=entry.exposure_ms, gain_db=entry.gain_db, trigger=entry.trigger)

    @property
    def devices(self) -> Devices:
        """Devices for the back-end to open."""
        return Devices(cameras=self.camera_names, ids=self.capture.cameras, options=self.capture.options)


def read_rig_file(path: Path) -> RigFile:
    """Read a rig.toml.

    Raises:
        SessionError: it is missing, is not TOML, or has an unknown key or an invalid value, which the message names.
    """
    expected = "a rig's description with a table [capture]"
    table = toml_table(read_text(path, str(path), expected, most_mib=1), str(path), expected)
    try:
        file = RigFile.model_validate(table)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "rig.toml"
        unknown, value = first["type"] == "extra_forbidden", first.get("input")
        found = "nothing" if first["type"] == "missing" else "an unknown key" if unknown else (
            shown(value) if isinstance(value, str | int | float | bool) else "an invalid value"
        )  # fmt: skip
        wanted = "only known keys" if unknown else first["msg"].removeprefix("Value error, ")
        remedy = "Correct it; docs/how-to/capture.md has a complete one"
        raise SessionError(f"{path}: {where}", found=found, expected=wanted, remedy=remedy) from None
    strangers = [name for name in file.capture.cameras if name not in file.camera_names]
    if strangers:
        raise SessionError(
            f"{path}: capture.cameras", found=strangers[0], expected=f"one of {', '.join(file.camera_names)}",
            remedy="Name the cameras as the pairs do",
        )  # fmt: skip
    twice = [
        camera for camera in file.capture.cameras.values() if list(file.capture.cameras.values()).count(camera) > 1
    ]
    if twice:
        raise SessionError(
            f"{path}: capture.cameras", found=f"{twice[0]!r} for two cameras", expected="a different device for each",
            remedy="Correct the serial numbers",
        )  # fmt: skip
    return file
