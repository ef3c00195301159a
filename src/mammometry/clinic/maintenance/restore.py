"""A clinic out of a backup, whole or not at all, and the test of that."""

import hashlib
import json
import os
import re
import shutil
import tarfile
import tempfile
import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mammometry.clinic.config import FILE, FOLDERS, ClinicConfig, ClinicError, quoted, read_config, write_private
from mammometry.clinic.maintenance import backups
from mammometry.clinic.maintenance.backups import DATABASE, FORMAT, MANIFEST

_CHUNK = 1 << 20  # bytes


def unpack(archive: Path, folder: Path, database: str | None = None) -> tuple[ClinicConfig, dict[str, Any]]:
    """Unpack a backup beside the folder that is to be. Nothing is opened yet.

    Args:
        archive: what `backup` wrote.
        folder: the new clinic's folder, which must not be there or be empty.
        database: another database than the backup's settings name.

    Returns:
        Settings of the clinic in its temporary folder ``<folder>.restoring``, and the archive's manifest.

    Raises:
        ClinicError: no backup, a damaged one, or something is in the folder.
    """
    if folder.exists() and any(folder.iterdir()):
        raise ClinicError(str(folder), found="files", expected="a new or empty folder", remedy="Name another folder")
    staging = folder.with_name(folder.name + ".restoring")
    if staging.exists():
        shutil.rmtree(staging)  # of a restore that was killed
    staging.mkdir(mode=0o700, parents=True)
    try:
        with tarfile.open(archive, "r:") as tar:
            _extract(tar, staging)
        manifest: dict[str, Any] = json.loads((staging / MANIFEST).read_text(encoding="utf-8"))
        damaged = [name for name, digest in manifest["sha256"].items() if _digest(staging / name) != digest]
    except (OSError, tarfile.TarError, ValueError, KeyError) as error:
        raise ClinicError(
            archive.name, found=f"no whole backup ({type(error).__name__})", expected="a backup that can be read",
            remedy="Take another backup",
        ) from None  # fmt: skip
    if damaged:
        found = f"{len(damaged)} damaged files, {damaged[0]} among them"
        raise ClinicError(archive.name, found=found, expected="files as they were", remedy="Take another backup")
    if manifest.get("format") != FORMAT:
        found, expected = f"format {manifest.get('format')}", f"format {FORMAT}"
        raise ClinicError(archive.name, found=found, expected=expected, remedy="Use the version that made it")
    for kept in FOLDERS:
        (staging / kept).mkdir(mode=0o700, exist_ok=True)
    if database is not None:
        text = (staging / FILE).read_text(encoding="utf-8")
        line = f"database = {quoted(database)}"
        write_private(staging / FILE, re.sub(r"(?m)^database\s*=.*$", lambda _: line, text, count=1))
    return read_config(staging), manifest


def _extract(tar: tarfile.TarFile, folder: Path) -> None:
    """Write a backup's files. Debian 12's Python has no ``extractall(filter=…)``.

    Raises:
        TarError: it holds something else than plain files, or one that lies elsewhere.
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
    """Fill an unpacked clinic's database and put it into its place. Returns the number of its people.

    Raises:
        ClinicError: the backup is of another version, or the database is not empty.
    """
    from django.db import connections

    from mammometry.clinic.models import Person

    load(config, manifest)
    number = Person.objects.count()
    connections.close_all()
    (config.folder / DATABASE).unlink()
    (config.folder / MANIFEST).unlink()
    if folder.exists():
        folder.rmdir()  # empty, as was looked at
    config.folder.rename(folder)
    return number


def load(config: ClinicConfig, manifest: dict[str, Any]) -> None:
    """Load the rows of an unpacked backup into its empty database.

    Raises:
        ClinicError: the backup is of another version, or the database is not empty.
    """
    from django.core.management import call_command

    from mammometry.clinic.maintenance.backups import known_migrations
    from mammometry.clinic.models import Person
    from mammometry.clinic.web.server import migrate

    migrate(config)
    if Person.objects.exists():
        raise ClinicError(
            "the database", found="a clinic in it", expected="an empty database", remedy="Give another with --database"
        )
    if known_migrations() != manifest["migrations"]:
        found, expected = f"a backup of version {manifest['software']}", "one of this version"
        remedy = f"Restore it with version {manifest['software']}, then upgrade"
        raise ClinicError("the backup", found=found, expected=expected, remedy=remedy)
    call_command("loaddata", str(config.folder / DATABASE), verbosity=0)


def _digest(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class RestoreTest:
    """Result of restoring a backup and comparing it."""

    backup: str
    """Name of the archive."""
    rows: int
    files: int
    seconds: float

    @property
    def sentence(self) -> str:
        """The outcome of the restore test in one sentence."""
        return f"{self.backup}: {self.rows} rows and {self.files} files came back the same, in {self.seconds:.0f} s."


def run_restore_test(config: ClinicConfig) -> RestoreTest:
    """Restore the newest backup into a temporary folder and database, and compare rows and files with it.

    The process opens the restored clinic, so it can have opened no other. The outcome is noted for the page.

    Raises:
        ClinicError: there is no backup, it is damaged, or what came back differs.
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
    with tempfile.TemporaryDirectory(prefix="restore-test-", dir=config.backups) as scratch:
        restored, manifest = unpack(newest.path, Path(scratch) / "clinic", database="sqlite")
        from mammometry.clinic.site import configure

        configure(restored)
        expected = _digests((restored.folder / DATABASE).open("rb"))
        load(restored, manifest)
        _require_same(expected, _rows_now(Path(scratch)))
        return RestoreTest(
            backup=newest.path.name,
            rows=sum(number for number, _ in expected.values()),
            files=len(manifest["sha256"]) - 1,  # the rows are one of its files
            seconds=time.monotonic() - begun,
        )


def _rows_now(scratch: Path) -> dict[str, tuple[int, str]]:
    """Digests of the rows that the restored database gives back."""
    from django.db import connections

    from mammometry.clinic.maintenance.backups import write_database

    with (scratch / DATABASE).open("w+b") as file:
        write_database(file)
        file.seek(0)
        digests = _digests(file)
    connections.close_all()
    return digests


def _digests(lines: Iterable[bytes]) -> dict[str, tuple[int, str]]:
    """Table → number of its rows, and a digest of them all in any order."""
    numbers: Counter[str] = Counter()
    sums: Counter[str] = Counter()
    for line in lines:
        row = json.loads(line)
        table = row["model"]
        content = json.dumps(row, sort_keys=True).encode()
        numbers[table] += 1
        sums[table] += int.from_bytes(hashlib.sha256(content).digest())
    return {table: (number, f"{sums[table]:x}") for table, number in numbers.items()}


def _require_same(expected: dict[str, tuple[int, str]], restored: dict[str, tuple[int, str]]) -> None:
    for table in sorted({*expected, *restored}):
        before, after = expected.get(table, (0, "")), restored.get(table, (0, ""))
        if before != after:
            found = f"{after[0]} rows of {table}" + (" with other values" if before[0] == after[0] else "")
            raise ClinicError(
                "the restored clinic", found=found, expected=f"the {before[0]} of the backup",
                remedy="Make another backup, test it, and tell the authors if it differs again",
            )  # fmt: skip
