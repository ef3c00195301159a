"""Test a restore: the newest backup becomes a temporary clinic and is compared with the archive.

The rows go into SQLite whatever the clinic's own database is. So the test needs no right to make databases, and shows
that the backup does not depend on the server that it was made with.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from mammometry.clinic.config import ClinicConfig, ClinicError
from mammometry.clinic.maintenance import backups
from mammometry.clinic.maintenance.format import DATABASE
from mammometry.clinic.maintenance.restore import load, unpack


@dataclass(frozen=True, slots=True, kw_only=True)
class RestoreTest:
    """What was restored and compared."""

    backup: str
    """Name of the archive."""
    rows: int
    files: int
    seconds: float

    @property
    def sentence(self) -> str:
        """In one sentence."""
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

    from mammometry.clinic.maintenance.backup import write_database

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
