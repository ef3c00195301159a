"""Disk use of a clinic's files, and how long the free space will last."""

import datetime
import os
import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from django.core.cache import cache
from django.db import connection

from mammometry.clinic.config import KEY_FILE, ClinicConfig
from mammometry.clinic.maintenance.backups import backup_files

RATE_DAYS = 30
"""Days over which the growth is averaged; fewer for a new clinic."""
_DAY_S = 86400.0  # seconds in a day
_CACHED_S = 600  # seconds; counting some hundred thousand files takes seconds


@dataclass(frozen=True, slots=True, kw_only=True)
class DiskUsage:
    """Bytes of the clinic's files, by kind."""

    photographs: int
    """Photographs of visits and boards, other devices' scans, and uploads."""
    results: int
    backups: int
    database: int
    free: int
    total: int
    """Capacity of the disk that contains the clinic's folder."""
    per_day: float
    """Bytes of new photographs and results per day, averaged over the last days."""
    rate_days: int
    """Number of days of that average."""
    at: datetime.datetime
    """Time of the count."""

    @property
    def days_left(self) -> int | None:
        """Days until the disk is full at this rate. None without new data."""
        return None if self.per_day <= 0 else int(self.free / self.per_day)

    @property
    def lasts(self) -> str:
        """Time until the disk is full, as text."""
        days = self.days_left
        if days is None:
            return "no new data, so there is no rate"
        if days < 60:
            return f"{days} days"
        return f"{days / 30.4:.0f} months" if days < 730 else "more than two years"

    @property
    def is_short(self) -> bool:
        """Whether less than two months are left, or less than a twentieth of the disk."""
        return (self.days_left is not None and self.days_left < 60) or self.free < self.total / 20


def cached_usage(config: ClinicConfig) -> DiskUsage:
    """Disk use, counted at most ten minutes ago."""
    usage: DiskUsage | None = cache.get("disk-usage")
    if usage is None:
        usage = measure_usage(config)
        cache.set("disk-usage", usage, _CACHED_S)
    return usage


def measure_usage(config: ClinicConfig) -> DiskUsage:
    """Count the bytes of all files."""
    now = time.time()
    age_days = (now - (config.folder / KEY_FILE).stat().st_mtime) / _DAY_S
    rate_days = max(1, min(RATE_DAYS, round(age_days)))
    since = now - rate_days * _DAY_S
    photographs = results = new = 0
    for name in ("sessions", "rigs", "uploads"):
        root = config.folder / name
        for path, status in _files(root):
            within = path[len(str(root)) + 1 :].split(os.sep)
            if name == "sessions" and len(within) > 2 and within[1] == "results":
                results += status.st_size
            else:
                photographs += status.st_size
            if name != "uploads" and status.st_mtime >= since:
                new += status.st_size
    disk = shutil.disk_usage(config.folder)
    return DiskUsage(
        photographs=photographs,
        results=results,
        backups=sum(file.size_bytes for file in backup_files(config)),
        database=_database_bytes(config),
        free=disk.free,
        total=disk.total,
        per_day=new / rate_days,
        rate_days=rate_days,
        at=datetime.datetime.now(datetime.UTC),
    )


def folder_bytes(folder: Path) -> int:
    """Bytes of all files below a folder. 0 if there is no such folder."""
    return sum(status.st_size for _, status in _files(folder))


def _files(root: Path) -> Iterator[tuple[str, os.stat_result]]:
    """Path and status of each file below a folder. Files that disappear meanwhile are left out."""
    waiting = [str(root)]
    while waiting:
        try:
            with os.scandir(waiting.pop()) as entries:
                for entry in entries:
                    try:
                        if entry.is_dir(follow_symlinks=False):
                            waiting.append(entry.path)
                        elif entry.is_file(follow_symlinks=False):
                            yield entry.path, entry.stat(follow_symlinks=False)
                    except FileNotFoundError:
                        continue
        except FileNotFoundError:
            continue


def _database_bytes(config: ClinicConfig) -> int:
    if connection.vendor == "postgresql":
        with connection.cursor() as cursor:
            cursor.execute("SELECT pg_database_size(current_database())")
            row = cursor.fetchone()
            return int(row[0]) if row is not None else 0
    return sum(path.stat().st_size for path in config.folder.glob("clinic.sqlite3*"))
