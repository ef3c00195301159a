"""Restore a clinic from a backup, atomically, and test a restore."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import tarfile
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mammometry.clinic.config import FILE, FOLDERS, ClinicConfig, ClinicError, quoted, read_config, write_private
from mammometry.clinic.maintenance import backups
from mammometry.clinic.maintenance.backups import DATABASE, FORMAT, MANIFEST

if TYPE_CHECKING:
    from django.apps.registry import Apps

_CHUNK = 1 << 20  # bytes


def unpack(archive: Path, folder: Path, database: str | None = None) -> tuple[ClinicConfig, dict[str, Any]]:
    """Unpack a backup next to the new folder, without opening it.

    Args:
        archive: file written by `backup`.
        folder: the new clinic's folder, which must be missing or empty.
        database: replaces the one in the backup's settings.

    Returns:
        Settings of the clinic in its temporary folder ``<folder>.restoring``, and the archive's manifest.

    Raises:
        ClinicError: the archive is not a backup or is damaged, or the folder is not empty.
    """
    if folder.exists() and any(folder.iterdir()):
        raise ClinicError(str(folder), found="files", expected="a new or empty folder", remedy="Name another folder")
    staging = folder.with_name(folder.name + ".restoring")
    if staging.exists():
        shutil.rmtree(staging)  # left by a restore that was killed
    staging.mkdir(mode=0o700, parents=True)
    try:
        with tarfile.open(archive, "r:") as tar:
            _extract(tar, staging)
        manifest: dict[str, Any] = json.loads((staging / MANIFEST).read_text(encoding="utf-8"))
        damaged = [name for name, digest in manifest["sha256"].items() if _digest(staging / name) != digest]
    except (OSError, tarfile.TarError, ValueError, KeyError) as error:
        raise ClinicError(
            archive.name, found=f"not a complete backup ({type(error).__name__})", expected="a backup that can be read",
            remedy="Take another backup",
        ) from None  # fmt: skip
    if damaged:
        found = f"{len(damaged)} damaged files, {damaged[0]} among them"
        raise ClinicError(archive.name, found=found, expected="unchanged files", remedy="Take another backup")
    if manifest.get("format") != FORMAT:
        found, expected = f"format {manifest.get('format')}", f"format {FORMAT}"
        raise ClinicError(archive.name, found=found, expected=expected, remedy="Use the version that made it")
    for kept in FOLDERS:
        (staging / kept).mkdir(mode=0o700, exist_ok=True)
    text = (staging / FILE).read_text(encoding="utf-8")
    if database is not None:
        line = f"database = {quoted(database)}"
        text = re.sub(r"(?m)^database\s*=.*$", lambda _: line, text, count=1)
    for path, kept in manifest.get("moved", {}).items():  # a rig.toml that was outside the clinic's folder
        for written in (quoted(path), f"'{path}'"):
            text = text.replace(f"= {written}", f"= {quoted(kept)}")
    write_private(staging / FILE, text)
    return read_config(staging), manifest


def _extract(tar: tarfile.TarFile, folder: Path) -> None:
    """Write a backup's files. Debian 12's Python has no ``extractall(filter=…)``.

    Raises:
        TarError: it contains something other than plain files, or a file outside the folder.
    """
    for entry in tar:
        path, source = folder / entry.name, tar.extractfile(entry) if entry.isfile() else None
        if source is None or not path.resolve().is_relative_to(folder.resolve()):
            raise tarfile.TarError(entry.name)
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with source, path.open("wb") as target:
            shutil.copyfileobj(source, target)
        path.chmod(0o600)
        os.utime(path, (entry.mtime, entry.mtime))


def fill(config: ClinicConfig, manifest: dict[str, Any], folder: Path) -> int:
    """Fill an unpacked clinic's database and move the clinic to its place. Returns how many people it has.

    Raises:
        ClinicError: the backup is from a later version, or the database is not empty.
    """
    from django.db import connections

    from mammometry.clinic.models import Person
    from mammometry.clinic.web.server import migrate

    _load(config, manifest)
    migrate(config)
    number = Person.objects.count()
    connections.close_all()
    (config.folder / DATABASE).unlink()
    (config.folder / MANIFEST).unlink()
    if folder.exists():
        folder.rmdir()  # it has been checked to be empty
    config.folder.rename(folder)
    return number


def _load(config: ClinicConfig, manifest: dict[str, Any]) -> Apps:
    """Load the rows of an unpacked backup. Returns the tables of the version that made it."""
    from mammometry.clinic.maintenance.rows import load_database

    with (config.folder / DATABASE).open("rb") as lines:
        return load_database(lines, manifest["migrations"], manifest["software"])


def _digest(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class RestoreTest:
    """Result of restoring a backup and comparing it with the archive."""

    backup: str
    """Name of the archive."""
    rows: int
    files: int
    seconds: float

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        return (
            f"{self.backup}: {self.rows} rows and {self.files} files were restored unchanged, in {self.seconds:.0f} s."
        )


def run_restore_test(config: ClinicConfig) -> RestoreTest:
    """Restore the newest backup into a temporary folder and database, and compare its rows and files.

    This process opens the restored clinic, so it must not have opened another one. The result is stored for the page.

    Raises:
        ClinicError: there is no backup, it is damaged, or the restored clinic differs from it.
    """
    with backups.exclusive(config):
        try:
            made = _tested(config)
        except Exception as error:
            backups.note(config, "restore", passed=False, sentence=str(error))
            raise
        backups.note(config, "restore", passed=True, sentence=made.sentence)
    return made


def _tested(config: ClinicConfig) -> RestoreTest:
    begun = time.monotonic()
    newest = next(iter(backups.backup_files(config)), None)
    if newest is None:
        raise ClinicError("backups", found="none", expected="a backup to test", remedy="Make one first")
    free = shutil.disk_usage(config.backups).free
    if free < newest.size_bytes:
        raise ClinicError(
            "the disk of the backups", found=f"{free / 1e9:.1f} GB free",
            expected=f"{newest.size_bytes / 1e9:.1f} GB for the restored clinic", remedy="Free some space",
        )  # fmt: skip
    with tempfile.TemporaryDirectory(prefix=backups.SCRATCH, dir=config.backups) as scratch:
        restored, manifest = unpack(newest.path, Path(scratch) / "clinic", database="sqlite")
        _require_measures_the_same(config, restored, manifest)
        rows = _restored_rows(restored, manifest)
        return RestoreTest(
            backup=newest.path.name,
            rows=rows,
            files=len(manifest["sha256"]) - 1,  # the rows are also a file
            seconds=time.monotonic() - begun,
        )


def _require_measures_the_same(config: ClinicConfig, restored: ClinicConfig, manifest: dict[str, Any]) -> None:
    """Refuse a backup from which a clinic would be restored with other settings or rigs.

    Backups of version 1.0 do not record them, and are compared with the present clinic.
    """
    expected = manifest.get("measures_with", backups.measures_with(config))
    found = backups.measures_with(restored)
    if wrong := sorted(name for name in {*expected, *found} if expected.get(name) != found.get(name)):
        raise ClinicError(
            "the restored clinic", found=f"no {wrong[0]}, or another", expected="the one that the clinic measures with",
            remedy="Make another backup",
        )  # fmt: skip


def _restored_rows(restored: ClinicConfig, manifest: dict[str, Any]) -> int:
    """Load a backup's rows, compare them, and upgrade the tables to this version. Returns the number of rows."""
    from mammometry.clinic.site import configure

    configure(restored)
    from django.db import connections

    from mammometry.clinic import audit_chain
    from mammometry.clinic.maintenance.rows import digests_of, require_same, write_database
    from mammometry.clinic.web.server import migrate

    with (restored.folder / DATABASE).open("rb") as lines:
        expected = digests_of(lines)
    tables = _load(restored, manifest)
    with (restored.folder / f"again-{DATABASE}").open("w+b") as file:
        write_database(file, tables)
        file.seek(0)
        require_same(expected, digests_of(file))
    migrate(restored)
    audit_chain.verify(backups.chain_in(manifest))
    connections.close_all()
    return sum(len(keys) for keys in expected.values())
