"""A batch's record of a finished session, kept beside its results.

``results/batch.json`` has the outcome, and size and change time of every file of the session. While these are the
same, and also the settings and the software, the session is current and nothing of it is opened. Otherwise `mammometry
run` decides by content and makes only what has changed.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, ValidationError

import mammometry
from mammometry.base.parse import LimitSettings
from mammometry.io.write import write_text
from mammometry.job.products import versions
from mammometry.job.stages.report import VERSIONS
from mammometry.settings import Settings

RECORD = "batch.json"
_MOST_BYTES = 1 << 24  # 16 MiB: a larger file is no record of ours and is not read
_UNREADABLE = (OSError, ValueError, ValidationError, RecursionError)
_STRICT = ConfigDict(extra="forbid", frozen=True)

Stat: TypeAlias = tuple[int, int | float | str]
"""Size of a file, bytes, and its version: change time, ns, or a storage's own tag."""


class Measured(BaseModel):
    """One volume."""

    model_config = _STRICT

    name: Literal["model", "left", "right"]
    volume_cc: float
    interval_cc: tuple[float, float] | None
    """95 %."""


class Row(BaseModel):
    """What a session came to: a row of the batch's table."""

    model_config = _STRICT

    session: str
    """Its folder's name, or the name that its manifest gives."""
    subject: str | None
    """Identifier of the subject."""
    date: str | None
    measured: tuple[Measured, ...]
    no_breast: Mapping[str, str] = {}
    """Side → what it rests on that nothing was measured there."""
    warnings: tuple[str, ...] = ()
    made_at: str | None
    """When the newest result was made, ISO 8601, UTC."""
    seconds: Annotated[float, Field(ge=0)]
    """Wall time of making all that is there, s."""
    peak_memory_mb: float | None
    """Most memory that the process held which made most of it, MB."""
    megapixels: float
    """Of all photographs of the subject."""
    page: str
    """The report's page, below the results."""
    thumbnail: str | None = None
    """A small picture of what was measured, WebP in base64."""


class Record(BaseModel):
    """A finished session."""

    model_config = _STRICT

    format: Literal[1] = 1
    key: str
    """Digest of settings and software."""
    files: Mapping[str, Stat]
    """Path in the session → what it was like."""
    row: Row

    @property
    def digest(self) -> str:
        """Digest of the whole record, by which the parent process identifies it."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()


def software() -> dict[str, str]:
    """Versions that must be equal on every machine of a batch. With other versions, results would differ."""
    numbers = json.dumps({**versions(), **VERSIONS}, sort_keys=True).encode()
    return {"mammometry": mammometry.__version__, "results": hashlib.sha256(numbers).hexdigest()[:12]}


def key_of(settings: Settings, limits: LimitSettings | None = None) -> str:
    """Digest of settings and software.

    Args:
        settings: of all stages.
        limits: other sizes of photographs than those of the settings.
    """
    text = json.dumps([settings.to_toml(), repr(limits or settings.limits), software()], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def stats_of(session: Path) -> dict[str, Stat]:
    """Size and change time of every file in a session. The record itself and hidden files are left out."""
    return {name: stat for name, stat in _stats(str(session), "") if name != f"results/{RECORD}"}


def _stats(folder: str, above: str) -> Iterator[tuple[str, Stat]]:
    with os.scandir(folder) as found_entries:
        for path in sorted(found_entries, key=lambda entry: entry.name):
            if path.name.startswith("."):
                continue
            if path.is_dir():
                yield from _stats(path.path, f"{above}{path.name}/")
            else:
                about = path.stat()
                yield f"{above}{path.name}", (about.st_size, about.st_mtime_ns)


def write_record(session: Path, record: Record) -> None:
    """Put the record beside the session's results, whole or not at all.

    Raises:
        StorageError: the disk is full or refuses.
    """
    write_text(session / "results" / RECORD, record.model_dump_json() + "\n")


def read_record(data: bytes) -> Record | None:
    """A record out of a file's content. None where it is none of this version."""
    try:
        return Record.model_validate_json(data)
    except _UNREADABLE:
        return None


def look_up(session: Path, key: str) -> tuple[Row | None, bool]:
    """Record of a session, and whether its files still match it. Files match by size and change time."""
    path = session / "results" / RECORD
    try:
        record = read_record(path.read_bytes()) if path.stat().st_size <= _MOST_BYTES else None
        if record is None:
            return None, False
        return record.row, record.key == key and dict(record.files) == stats_of(session)
    except OSError:
        return None, False
