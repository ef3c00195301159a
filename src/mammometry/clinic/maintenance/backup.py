"""A backup. One tar of the database as lines of JSON, the settings, the keys and all files.

The database is read first, in one snapshot, and the files after it: a file belongs to its row before the row is
written, so every row of the snapshot has its files. The same archive goes into SQLite and into PostgreSQL.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import tarfile
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, BinaryIO, cast

from django.apps import apps
from django.core import serializers
from django.db import connection
from django.db.migrations.loader import MigrationLoader
from django.db.models import Model

from mammometry.clinic.config import FILE, KEY_FILE, OPENID_SECRET_FILE, ClinicConfig, ClinicError
from mammometry.clinic.maintenance.format import DATABASE, FORMAT, MANIFEST

SMALL_FILES = (FILE, KEY_FILE, OPENID_SECRET_FILE)
KEPT_FOLDERS = ("sessions", "rigs", "uploads")
_LEFT_OUT = ("sessions", "contenttypes", "axes")
"""Applications whose rows belong to the running server: logins, wrong passwords."""


def make_backup(config: ClinicConfig, target: Path | None = None) -> Path:
    """Write a backup. The clinic may be in use. Return its file, which nobody else may read.

    Args:
        config: the open clinic.
        target: the archive to make; by default in the folder of backups, named by the time.

    Raises:
        ClinicError: there is such a file already.
    """
    now = datetime.now(UTC)
    target = target or config.backups / f"clinic-{now:%Y%m%d-%H%M%S}.tar"
    if target.exists():
        raise ClinicError(str(target), found="a file", expected="none", remedy="Name another file with --to")
    part = target.with_name(target.name + ".part")
    digests: dict[str, str] = {}
    with open(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "wb") as stream:
        with tarfile.open(fileobj=stream, mode="w", format=tarfile.PAX_FORMAT) as tar:
            with tempfile.TemporaryFile(dir=target.parent) as rows:
                write_database(rows)
                rows.seek(0)
                _add(tar, DATABASE, rows, digests)
            for name, path in _files(config.folder):
                try:
                    with path.open("rb") as file:
                        _add(tar, name, file, digests)
                except FileNotFoundError:
                    continue  # replaced or erased since the folder was read
            manifest = {
                "format": FORMAT,
                "software": version("mammometry"),
                "made_at": now.isoformat(),
                "migrations": known_migrations(),
                "sha256": digests,
            }
            content = json.dumps(manifest, indent=1).encode()
            _add(tar, MANIFEST, io.BytesIO(content), {})
        stream.flush()
        os.fsync(stream.fileno())
    part.replace(target)
    return target


def known_migrations() -> list[str]:
    """All migrations of this version. A backup's rows fit the tables that they make."""
    return sorted(f"{app} {name}" for app, name in MigrationLoader(None).disk_migrations)


def write_database(file: BinaryIO) -> None:
    """Write all rows that a clinic keeps, one a line."""
    text = io.TextIOWrapper(file, encoding="utf-8", write_through=True)
    with _snapshot():
        for model in _kept_models():
            rows = model._base_manager.order_by("pk").iterator(chunk_size=500)
            serializers.serialize("jsonl", rows, stream=text, use_natural_foreign_keys=True)
    text.detach()


def _kept_models() -> list[type[Model]]:
    chosen = [
        (config, None)
        for config in apps.get_app_configs()
        if config.label not in _LEFT_OUT and config.models_module is not None
    ]
    models = serializers.sort_dependencies(cast(Any, chosen), allow_cycles=True)
    return [model for model in models if model._meta.label != "auth.Permission" and not model._meta.proxy]


@contextmanager
def _snapshot() -> Iterator[None]:
    """All that is read within is of one moment. Writers are not held up."""
    if connection.in_atomic_block:
        yield
        return
    begin = "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY" if connection.vendor == "postgresql" else "BEGIN"
    with connection.cursor() as cursor:
        cursor.execute(begin)
    try:
        yield
    finally:
        with connection.cursor() as cursor:
            cursor.execute("ROLLBACK")


def _files(folder: Path) -> Iterator[tuple[str, Path]]:
    """Name in the archive and path of each file that is kept."""
    for name in SMALL_FILES:
        if (folder / name).is_file():
            yield name, folder / name
    for kept in KEPT_FOLDERS:
        for path in sorted((folder / kept).rglob("*")):
            if path.is_file() and not path.is_symlink():
                yield path.relative_to(folder).as_posix(), path


def _add(tar: tarfile.TarFile, name: str, file: BinaryIO, digests: dict[str, str]) -> None:
    """Add as many bytes as the file has now. An upload may be growing."""
    entry = tarfile.TarInfo(name)
    start = file.tell()
    entry.size = file.seek(0, os.SEEK_END) - start
    file.seek(start)
    entry.mode, entry.mtime = 0o600, int(datetime.now(UTC).timestamp())
    digest = hashlib.sha256()
    tar.addfile(entry, cast(Any, _Hashed(file, digest.update)))
    digests[name] = digest.hexdigest()


class _Hashed:
    """A file whose bytes are seen as they are read."""

    def __init__(self, file: BinaryIO, see: Callable[[bytes], object]) -> None:
        self._file, self._see = file, see

    def read(self, size: int = -1) -> bytes:
        """Read on."""
        content = self._file.read(size)
        self._see(content)
        return content
