"""The backups that are kept: which there are, when the next is made, and what became of the last.

One is made at a time, by whichever process holds the lock: the runner by its schedule, or a command that an
administrator's page starts.
"""

from __future__ import annotations

import datetime
import json
import logging
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from zoneinfo import ZoneInfo

from filelock import FileLock, Timeout

from mammometry.base.errors import MammometryError
from mammometry.clinic.config import KEY_FILE, ClinicConfig, ClinicError, write_private

_PATTERN = "clinic-????????-??????.tar"
_LOCK = ".lock"
_OUTCOMES = "outcomes.json"
"""What became of the last backup and the last restore test, in the folder of backups."""
_LOOK_S = 30.0  # between two looks at the clock
_MARGIN = 1.2  # a new backup is expected to be at most this much larger than the last one
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class BackupFile:
    """One backup."""

    path: Path
    size_bytes: int
    made_at: datetime.datetime


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What became of a backup or of a restore test."""

    at: str
    """When it ended, ISO 8601."""
    passed: bool
    sentence: str

    @property
    def moment(self) -> datetime.datetime:
        """When it ended."""
        return datetime.datetime.fromisoformat(self.at)


@dataclass(frozen=True, slots=True, kw_only=True)
class BackupState:
    """All that a page says of the backups."""

    files: list[BackupFile]
    """The newest first."""
    backup: Outcome | None
    """Of the last backup; None: none was tried."""
    restore: Outcome | None
    """Of the last restore test."""
    at_work: bool
    """Whether a backup or a test is being made now."""
    next_at: datetime.datetime | None
    """When the server makes the next; None: it makes none by itself."""

    @property
    def newest(self) -> BackupFile | None:
        """The newest backup."""
        return self.files[0] if self.files else None

    @property
    def age_days(self) -> int | None:
        """Whole days since the newest was made."""
        return None if self.newest is None else (datetime.datetime.now(datetime.UTC) - self.newest.made_at).days


def state_of(config: ClinicConfig) -> BackupState:
    """The backups now."""
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
    """Whole backups, the newest first."""
    made = []
    for path in config.backups.glob(_PATTERN):
        status = path.stat()
        made_at = datetime.datetime.fromtimestamp(status.st_mtime, datetime.UTC)
        made.append(BackupFile(path=path, size_bytes=status.st_size, made_at=made_at))
    return sorted(made, key=lambda file: file.path.name, reverse=True)


def make_kept_backup(config: ClinicConfig) -> Path:
    """Make a backup in the folder of backups, and delete the oldest beyond those that are kept.

    The outcome is noted for the page.

    Raises:
        ClinicError: one is being made, the disk is too full, or the backup cannot be written.
    """
    from mammometry.clinic.maintenance.backup import make_backup

    with exclusive(config):
        try:
            _require_room(config)
            made = make_backup(config)
        except (MammometryError, OSError) as error:
            for part in config.backups.glob(f"{_PATTERN}.part"):
                part.unlink(missing_ok=True)
            words = str(error) if isinstance(error, MammometryError) else f"It could not be written: {error.strerror}."
            note(config, "backup", passed=False, sentence=words)
            raise
        for old in backup_files(config)[config.backup.keep :]:
            old.path.unlink(missing_ok=True)
        note(config, "backup", passed=True, sentence=made.name)
    return made


def note(config: ClinicConfig, kind: str, *, passed: bool, sentence: str) -> None:
    """Keep what became of a backup or a restore test, for the page."""
    outcome = Outcome(at=datetime.datetime.now(datetime.UTC).isoformat(), passed=passed, sentence=sentence)
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
        raise ClinicError(
            "backups", found="one that is being made or tested", expected="none",
            remedy="Wait until it ends",
        ) from None  # fmt: skip
    try:
        yield
    finally:
        lock.release()


class DailyBackup(threading.Thread):
    """Makes a backup a day, at the clinic's time of day."""

    def __init__(self, config: ClinicConfig) -> None:
        super().__init__(daemon=True, name="daily backup")
        self._config = config

    def run(self) -> None:
        """Look at the clock until the process ends."""
        while True:
            if is_due(self._config, datetime.datetime.now(datetime.UTC)):
                try:
                    make_kept_backup(self._config)
                except Exception:  # the page says so, and tomorrow is another day
                    _LOG.exception("The daily backup was not made")
            threading.Event().wait(_LOOK_S)


def is_due(config: ClinicConfig, now: datetime.datetime) -> bool:
    """Whether the last scheduled time has passed without a backup or a try of one."""
    last = _scheduled(config, now, after=False)
    if last is None:
        return False
    begun = datetime.datetime.fromtimestamp((config.folder / KEY_FILE).stat().st_mtime, datetime.UTC)
    tried = _outcomes(config).get("backup")
    known = [begun, *(file.made_at for file in backup_files(config)), *([tried.moment] if tried else [])]
    return last > max(known)


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
    """Refuse to begin what the disk cannot hold."""
    config.backups.mkdir(mode=0o700, parents=True, exist_ok=True)
    newest = next(iter(backup_files(config)), None)
    free = shutil.disk_usage(config.backups).free
    needed = int(_MARGIN * newest.size_bytes) if newest is not None else 0
    if free < needed:
        raise ClinicError(
            "the disk of the backups", found=f"{free / 1e9:.1f} GB free", expected=f"{needed / 1e9:.1f} GB",
            remedy="Free some space, keep fewer backups, or keep them on a larger disk",
        )  # fmt: skip


def _outcomes(config: ClinicConfig) -> dict[str, Outcome]:
    try:
        table = json.loads((config.backups / _OUTCOMES).read_text(encoding="utf-8"))
        return {kind: Outcome(**table[kind]) for kind in ("backup", "restore") if kind in table}
    except (OSError, ValueError, TypeError):
        return {}


def _is_locked(config: ClinicConfig) -> bool:
    try:
        with exclusive(config):
            return False
    except ClinicError:
        return True
