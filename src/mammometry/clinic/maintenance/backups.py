"""Backups: making and keeping them, their schedule, and the result of the last one."""

from __future__ import annotations

import datetime
import hashlib
import io
import json
import os
import re
import shutil
import tarfile
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, cast
from zoneinfo import ZoneInfo

from filelock import FileLock, Timeout

import mammometry
from mammometry.base.errors import MammometryError
from mammometry.clinic.config import KEY_FILE, SETTINGS_FILE, ClinicConfig, ClinicError, new_private, write_private
from mammometry.clinic.maintenance.rows import known_migrations, write_database

if TYPE_CHECKING:
    from mammometry.clinic.audit_chain import ChainEnd

_PATTERN = "clinic-????????-??????.tar"
_LOCK = ".lock"
_OUTCOMES = "outcomes.json"
"""File in the folder of backups with the results of the last backup and restore test."""
_ELSEWHERE = "elsewhere.json"
"""File with the paths of backups outside the folder of backups. Each is a copy of all patients' data."""
_CLOCK = datetime.timedelta(hours=1)  # how far a file server's clock may be ahead of ours
_MARGIN = 1.2  # largest expected growth from one backup to the next


@dataclass(frozen=True, slots=True, kw_only=True)
class BackupFile:
    """One backup."""

    path: Path
    size_bytes: int
    made_at: datetime.datetime


@dataclass(frozen=True, slots=True, kw_only=True)
class BackupResult:
    """Result of a backup or of a restore test."""

    at: str
    """Time at which it ended, ISO 8601."""
    passed: bool
    sentence: str

    @property
    def moment(self) -> datetime.datetime:
        """Time at which it ended."""
        return datetime.datetime.fromisoformat(self.at)


@dataclass(frozen=True, slots=True, kw_only=True)
class BackupState:
    """State of the backups for a page."""

    files: list[BackupFile]
    """Newest first."""
    backup: BackupResult | None
    """Result of the last backup. None: none was attempted."""
    restore: BackupResult | None
    """Result of the last restore test."""
    at_work: bool
    """Whether a backup or a test is running."""
    next_at: datetime.datetime | None
    """Time of the next automatic backup. None: there is none."""

    @property
    def newest(self) -> BackupFile | None:
        """The newest backup."""
        return self.files[0] if self.files else None

    @property
    def age_days(self) -> int | None:
        """Whole days since the newest backup."""
        return None if self.newest is None else (datetime.datetime.now(datetime.UTC) - self.newest.made_at).days


def state_of(config: ClinicConfig) -> BackupState:
    """Current state of the backups: the list, the next one, and the result of the last one."""
    outcomes = _outcomes(config)
    files = backup_files(config)
    return BackupState(
        files=files,
        backup=outcomes.get("backup"),
        restore=outcomes.get("restore"),
        at_work=_is_locked(config),
        next_at=_scheduled(config, datetime.datetime.now(datetime.UTC), after=True),
    )


def backup_files(config: ClinicConfig) -> list[BackupFile]:
    """Complete backups, newest first, with those dated in the future last."""
    now = datetime.datetime.now(datetime.UTC) + _CLOCK
    made = []
    for path in config.backups.glob(_PATTERN):
        status = path.stat()
        made_at = datetime.datetime.fromtimestamp(status.st_mtime, datetime.UTC)
        made.append(BackupFile(path=path, size_bytes=status.st_size, made_at=made_at))
    return sorted(made, key=lambda file: (file.made_at <= now, file.path.name), reverse=True)


def make_kept_backup(config: ClinicConfig) -> Path:
    """Make a backup in the folder of backups, and delete the oldest ones.

    The result is stored for the page.

    Raises:
        ClinicError: a backup is running, the disk is too full, or the backup cannot be written.
    """
    with exclusive(config):
        try:
            _require_room(config)
            made = make_backup(config)
        except (MammometryError, OSError) as error:
            _remove_leftovers(config)
            words = str(error) if isinstance(error, MammometryError) else f"It could not be written: {error.strerror}."
            note(config, "backup", passed=False, sentence=words)
            raise
        for old in backup_files(config)[config.backup.keep :]:
            old.path.unlink(missing_ok=True)
        note(config, "backup", passed=True, sentence=made.name)
    return made


def note(config: ClinicConfig, kind: str, *, passed: bool, sentence: str) -> None:
    """Store the result of a backup or a restore test for the page."""
    outcome = BackupResult(at=datetime.datetime.now(datetime.UTC).isoformat(), passed=passed, sentence=sentence)
    table = {key: asdict(value) for key, value in {**_outcomes(config), kind: outcome}.items()}
    write_private(config.backups / _OUTCOMES, json.dumps(table, indent=1))


@contextmanager
def exclusive(config: ClinicConfig) -> Iterator[None]:
    """Hold the lock of the backups.

    Raises:
        ClinicError: another process holds it.
    """
    config.backups.mkdir(mode=0o700, parents=True, exist_ok=True)
    lock = FileLock(config.backups / _LOCK, mode=0o600, blocking=False)
    try:
        lock.acquire()
    except Timeout:
        remedy = "Wait until it ends"
        raise ClinicError(
            "backups", found="a backup that is being made or tested", expected="none", remedy=remedy
        ) from None
    try:
        _remove_leftovers(config)
        yield
    finally:
        lock.release()


def remove_leftovers(config: ClinicConfig) -> bool:
    """Delete what killed backups and restore tests left, which contains names. False if one is running."""
    try:
        with exclusive(config):
            return True
    except ClinicError:
        return False


def _remove_leftovers(config: ClinicConfig) -> None:
    for path in unfinished(config):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def unfinished(config: ClinicConfig) -> list[Path]:
    """Unfinished archives and restored clinics in the folder of backups, from a running or killed process."""
    return sorted([*config.backups.glob(f"*.tar{PART}"), *config.backups.glob(f"{SCRATCH}*")])


def elsewhere(config: ClinicConfig) -> list[Path]:
    """Existing backups outside the folder of backups, including unfinished ones."""
    try:
        named = json.loads((config.backups / _ELSEWHERE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    return [path for name in named for path in (Path(name), Path(name + PART)) if path.exists()]


def _note_elsewhere(config: ClinicConfig, target: Path) -> None:
    config.backups.mkdir(mode=0o700, parents=True, exist_ok=True)
    known = {os.fspath(path).removesuffix(PART) for path in elsewhere(config)}
    names = sorted({*known, os.fspath(target.absolute())})
    write_private(config.backups / _ELSEWHERE, json.dumps(names, indent=1))


def plan_daily(config: ClinicConfig) -> None:
    """Queue the day's backup when it is due. It is queued only once, however many runners call this."""
    from mammometry.clinic.jobs import queue
    from mammometry.clinic.models import Job

    now = datetime.datetime.now(datetime.UTC)
    if is_due(config, now):
        queue.enqueue_upkeep(Job.Kind.BACKUP, None, once=f"backup of {_scheduled(config, now, after=False)}")


def is_due(config: ClinicConfig, now: datetime.datetime) -> bool:
    """Whether the last scheduled time has passed without a backup or an attempt since."""
    last = _scheduled(config, now, after=False)
    if last is None:
        return False
    begun = datetime.datetime.fromtimestamp((config.folder / KEY_FILE).stat().st_mtime, datetime.UTC)
    tried = _outcomes(config).get("backup")
    known = [begun, *(file.made_at for file in backup_files(config)), *([tried.moment] if tried else [])]
    # A backup dated in the future does not count.
    return all(moment < last or moment > now for moment in known)


def _scheduled(config: ClinicConfig, now: datetime.datetime, *, after: bool) -> datetime.datetime | None:
    """The next scheduled time after now, or the last one before."""
    if not config.backup.daily_at:
        return None
    hour, minute = map(int, config.backup.daily_at.split(":"))
    local = now.astimezone(ZoneInfo(config.time_zone))
    at = local.replace(hour=hour, minute=minute, second=0, microsecond=0)
    day = datetime.timedelta(days=1)
    if after:
        return at if at > local else at + day
    return at if at <= local else at - day


def _require_room(config: ClinicConfig) -> None:
    """Refuse if the disk has too little space."""
    config.backups.mkdir(mode=0o700, parents=True, exist_ok=True)
    newest = next(iter(backup_files(config)), None)
    free = shutil.disk_usage(config.backups).free
    needed = int(_MARGIN * newest.size_bytes) if newest is not None else 0
    if free < needed:
        raise ClinicError(
            "the disk of the backups", found=f"{free / 1e9:.1f} GB free", expected=f"{needed / 1e9:.1f} GB",
            remedy="Free some space, keep fewer backups, or keep them on a larger disk",
        )  # fmt: skip


def _outcomes(config: ClinicConfig) -> dict[str, BackupResult]:
    try:
        table = json.loads((config.backups / _OUTCOMES).read_text(encoding="utf-8"))
        return {kind: BackupResult(**table[kind]) for kind in ("backup", "restore") if kind in table}
    except (OSError, ValueError, TypeError):
        return {}


def _is_locked(config: ClinicConfig) -> bool:
    try:
        with exclusive(config):
            return False
    except ClinicError:
        return True


FORMAT = 1
DATABASE = "database.jsonl"
"""The rows, one per line."""
MANIFEST = "manifest.json"
"""Format, version, time, migrations, and the SHA-256 of each file. It is the archive's last entry."""


KEPT_FOLDERS = ("sessions", "rigs", "acceptance", "uploads")
PART = ".part"
"""Suffix of an archive while it is written."""
SCRATCH = "restore-test-"
"""Prefix of the folder for a restore test."""
_RIG_FILE = "rig.toml"
_NOT_KEPT = re.compile(r"\.(sqlite3(-\w+)?|tar|part|lock|new)$")
"""Files in a clinic's folder that are not in backups: the database, archives, and unfinished files."""


def make_backup(config: ClinicConfig, target: Path | None = None) -> Path:
    """Write a backup. The clinic may be in use. Returns the file, which only its owner can read.

    Args:
        config: settings of the open clinic.
        target: the archive to write. None: in the folder of backups, named by the time.

    Raises:
        ClinicError: the file exists already.
    """
    now = datetime.datetime.now(datetime.UTC)
    target = target or config.backups / f"clinic-{now:%Y%m%d-%H%M%S}.tar"
    from mammometry.clinic.audit_chain import extend

    if target.exists():
        raise ClinicError(str(target), found="a file", expected="none", remedy="Name another file with --to")
    if target.parent.resolve() != config.backups.resolve():
        _note_elsewhere(config, target)
    part = target.with_name(target.name + PART)
    digests: dict[str, str] = {}
    chained = extend()
    with new_private(part) as stream:
        with tarfile.open(fileobj=stream, mode="w", format=tarfile.PAX_FORMAT) as tar:
            with tempfile.TemporaryFile(dir=target.parent) as rows:
                write_database(rows)
                rows.seek(0)
                _add(tar, DATABASE, rows, digests)
            for name, path in _files(config):
                try:
                    with path.open("rb") as file:
                        _add(tar, name, file, digests)
                except FileNotFoundError:
                    continue  # replaced or erased since the folder was listed
            manifest = {
                "format": FORMAT,
                "software": mammometry.__version__,
                "made_at": now.isoformat(),
                "migrations": known_migrations(),
                "audit": asdict(chained),
                "measures_with": measures_with(config),
                "moved": {config.cameras[rig]: name for rig, name in _outside(config).items()},
                "sha256": digests,
            }
            content = json.dumps(manifest, indent=1).encode()
            _add(tar, MANIFEST, io.BytesIO(content), {})
        stream.flush()
        os.fsync(stream.fileno())
    part.replace(target)
    return target


def chain_of_newest(config: ClinicConfig) -> ChainEnd | None:
    """End of the audit's chain in the newest backup. None if there is no backup, or it is unknown."""
    newest = next(iter(backup_files(config)), None)
    if newest is None:
        return None
    try:
        with tarfile.open(newest.path, "r:") as tar:
            file = tar.extractfile(MANIFEST)
            return None if file is None else chain_in(json.loads(file.read()))
    except (OSError, tarfile.TarError, KeyError, ValueError):
        return None


def chain_in(manifest: dict[str, Any]) -> ChainEnd | None:
    """End of the audit's chain in a backup. None for version 1.0, which had no chain."""
    from mammometry.clinic.audit_chain import ChainEnd

    return ChainEnd(**manifest["audit"]) if "audit" in manifest else None


def measures_with(config: ClinicConfig) -> dict[str, str]:
    """SHA-256 of each file, apart from photographs, that affects a number. Empty if the file is missing.

    These are the clinic's settings and the rig.toml of each connected rig.
    """
    files = {SETTINGS_FILE: config.folder / SETTINGS_FILE}
    files |= {f"{_RIG_FILE} of {rig}": config.folder / name for rig, name in sorted(config.cameras.items())}
    return {
        name: hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "" for name, path in files.items()
    }


def _outside(config: ClinicConfig) -> dict[str, str]:
    """Rig whose rig.toml is outside the clinic's folder → the file's name in the archive."""
    rigs = sorted(rig for rig, name in config.cameras.items() if not _is_inside(config, config.folder / name))
    return {rig: f"cameras/{number}-{_RIG_FILE}" for number, rig in enumerate(rigs, start=1)}


def _is_inside(config: ClinicConfig, path: Path) -> bool:
    return path.resolve().is_relative_to(config.folder.resolve())


def _files(config: ClinicConfig) -> Iterator[tuple[str, Path]]:
    """Name in the archive and path of each file to store.

    These are all files of the clinic's folder except archives and the database, whose rows are stored instead.
    """
    folder, outside = config.folder, _outside(config)
    named = {path: path.name for path in folder.iterdir() if path.is_file() and not _NOT_KEPT.search(path.name)}
    for rig, name in config.cameras.items():
        path = folder / name
        if path.is_file():
            named[path] = outside.get(rig) or path.resolve().relative_to(folder.resolve()).as_posix()
    for kept in KEPT_FOLDERS:
        # subfolders contain jobs' temporary files
        for path in (folder / kept).glob("*" if kept == "uploads" else "**/*"):
            if path.is_file() and not path.is_symlink():
                named[path] = path.relative_to(folder).as_posix()
    once = {name: path for path, name in named.items()}
    yield from sorted(once.items())


def _add(tar: tarfile.TarFile, name: str, file: BinaryIO, digests: dict[str, str]) -> None:
    """Add the file's current content. An upload may be growing."""
    entry = tarfile.TarInfo(name)
    start = file.tell()
    entry.size = file.seek(0, os.SEEK_END) - start
    file.seek(start)
    entry.mode, entry.mtime = 0o600, int(datetime.datetime.now(datetime.UTC).timestamp())
    digest = hashlib.sha256()
    tar.addfile(entry, cast(Any, _Hashed(file, digest.update)))
    digests[name] = digest.hexdigest()


class _Hashed:
    """A file that is hashed while it is read."""

    def __init__(self, file: BinaryIO, see: Callable[[bytes], object]) -> None:
        self._file, self._see = file, see

    def read(self, size: int = -1) -> bytes:
        """Read the next bytes, and add them to the digest."""
        content = self._file.read(size)
        self._see(content)
        return content
