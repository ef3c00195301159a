"""One session of a batch: the resources of its task, and the record with its results."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, ValidationError

import mammometry
from mammometry.base.identity import as_utf_8
from mammometry.base.notices import Notice
from mammometry.io.meshes.measured import ABOUT_MESH, is_measured, results_of, sources_of
from mammometry.io.results.verify import BATCH
from mammometry.io.sealed import sealed, unsealed
from mammometry.io.write import write_bytes
from mammometry.job.method import versions
from mammometry.job.stages.report import VERSIONS
from mammometry.settings import Settings

MEMORY = "mammometry_mb"
"""Resource of a worker: memory for all its tasks, MB."""
CORES = "mammometry_cores"
"""Resource of a worker: cores for all its tasks."""
_ADDRESS = re.compile(r"[a-z][a-z0-9+]*://")


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchEntry:
    """One session of a batch."""

    address: str
    """Absolute path of the folder, or its address on other storage, such as ``s3://bucket/patients/17``."""
    assignments: tuple[str, ...] = ()
    """Settings of this session only, ``NAME=VALUE``."""
    reference_cc: Mapping[str, float] = field(default_factory=dict)
    """``model``, ``left`` or ``right`` → volume by another method, cc."""
    results: str | None = None
    """Address of the folder with its results. None: in the session."""

    @property
    def remote(self) -> bool:
        """Whether photographs are fetched and results sent back, because workers cannot access the folder."""
        return is_address(self.address) or self.results is not None

    @property
    def name(self) -> str:
        """The last part of its address."""
        return self.address.rstrip("/").rpartition("/")[2]


def is_address(text: str) -> bool:
    """Whether this is an fsspec address, not a folder."""
    return _ADDRESS.match(text) is not None


_MARGIN = 1.15
"""Memory varies between sessions of one size: for casts of the reference rig by ± 10 %."""


def need_mb(megapixels: float | None, known: Sequence[tuple[float, float]]) -> float | None:
    """Memory to keep free for a session, MB.

    None if no session is known. Memory grows at most in proportion to the pixels. So a session needs no more than the
    next larger one, or than the largest one scaled by the ratio of sizes.

    Args:
        megapixels: of its photographs of the subject; None if unknown, which counts as the largest.
        known: (megapixels, peak memory in MB) of others.
    """
    if not known:
        return None
    if megapixels is None:
        return _MARGIN * max(peak for _, peak in known)
    larger = [(size, peak) for size, peak in known if size >= megapixels]
    if larger:
        nearest = min(size for size, _ in larger)
        return _MARGIN * max(peak for size, peak in larger if size <= 1.05 * nearest)
    size = max(size for size, _ in known)
    return _MARGIN * max(peak for other, peak in known if other == size) * megapixels / size


RECORD = BATCH
_MOST_BYTES = 1 << 24  # 16 MiB: larger files are not our records and are not read
_UNREADABLE = (OSError, ValueError, ValidationError, RecursionError)
_STRICT = ConfigDict(extra="forbid", frozen=True)

Stat: TypeAlias = tuple[int, int | float | str]
"""Size of a file, bytes, and its version: modification and change time, ns, or the storage's tag."""


class Measured(BaseModel):
    """A measured volume in the record."""

    model_config = _STRICT

    name: Literal["model", "left", "right"]
    volume_cc: float
    interval_cc: tuple[float, float] | None
    """95 %."""


class BatchRow(BaseModel):
    """Result of a session: a row of the batch's table."""

    model_config = _STRICT

    session: str
    """Name of its folder, or the name in its manifest."""
    subject: str | None
    """Identifier of the subject."""
    date: str | None
    measured: tuple[Measured, ...]
    no_breast: Mapping[str, str] = {}
    """Side → reason for having no volume."""
    notices: tuple[Notice, ...] = ()
    """Warnings of its report."""
    made_at: str | None
    """When the newest result was made, ISO 8601, UTC."""
    seconds: Annotated[float, Field(ge=0)]
    """Wall time of all its products, s."""
    peak_memory_mb: float | None
    """Peak memory of the process that made most of it, MB."""
    megapixels: float
    """Of all photographs of the subject."""
    page: str
    """The report's page, below the results."""
    thumbnail: str | None = None
    """A small picture of the subject, WebP in base64."""


class SessionRecord(BaseModel):
    """Record of a finished session."""

    model_config = _STRICT

    format: Literal[1] = 1
    key: str
    """Digest of settings and software."""
    files: Mapping[str, Stat]
    """Path in the session → its size and version."""
    row: BatchRow

    @property
    def digest(self) -> str:
        """Digest of the whole record, which identifies it to the parent process."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()


def software() -> dict[str, str]:
    """Versions that must be equal on every machine of a batch, because results depend on them."""
    numbers = json.dumps({**versions(), **VERSIONS}, sort_keys=True).encode()
    return {"mammometry": mammometry.__version__, "results": hashlib.sha256(numbers).hexdigest()[:12]}


def key_of(settings: Settings) -> str:
    """Digest of settings and software."""
    text = json.dumps([settings.to_toml(), repr(settings.limits), software()], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def stats_of(session: Path) -> dict[str, Stat]:
    """Size and times of every file in a session. The record itself and hidden files are left out.

    ctime is included: copying programs keep a file's modification time, but cannot set ctime. A copied session
    therefore counts as changed, and its files are compared by content.
    """
    own = as_utf_8((results_of(session) / RECORD).relative_to(session).as_posix())
    outside = sources_of(session) if is_measured(session) else {}
    elsewhere = {f"{ABOUT_MESH}: {name}": _stat(path.stat()) for name, path in outside.items() if path.is_file()}
    return elsewhere | {name: stat for name, stat in _stats(str(session), "") if name != own}


def _stats(folder: str, above: str) -> Iterator[tuple[str, Stat]]:
    with os.scandir(folder) as found_entries:
        for path in sorted(found_entries, key=lambda entry: entry.name):
            if path.name.startswith("."):
                continue
            if path.is_dir():
                yield from _stats(path.path, f"{above}{path.name}/")
            else:
                yield as_utf_8(f"{above}{path.name}"), _stat(path.stat())


def _stat(about: os.stat_result) -> Stat:
    return (about.st_size, f"{about.st_mtime_ns} {about.st_ctime_ns}")


def write_record(session: Path, record: SessionRecord) -> None:
    """Write the record next to the session's results, atomically.

    Raises:
        StorageError: the disk is full or refuses.
    """
    write_bytes(results_of(session) / RECORD, content_of(record))


def content_of(record: SessionRecord) -> bytes:
    """Content of a record's file."""
    return sealed(record.model_dump(mode="json"))


def read_record(data: bytes) -> SessionRecord | None:
    """Read a record from a file's content. None if it is not of this version."""
    try:
        return SessionRecord.model_validate(unsealed(data)[0])
    except _UNREADABLE:
        return None


def look_up(session: Path, key: str) -> tuple[BatchRow | None, bool]:
    """Record of a session, and whether its files still match it. Files match by size and times."""
    path = results_of(session) / RECORD
    try:
        record = read_record(path.read_bytes()) if path.stat().st_size <= _MOST_BYTES else None
        if record is None:
            return None, False
        return record.row, record.key == key and dict(record.files) == stats_of(session)
    except OSError:
        return None, False
