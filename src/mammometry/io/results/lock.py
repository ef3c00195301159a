"""Allow one run at a time per results folder, on every system and on network drives."""

from __future__ import annotations

import errno
import json
import os
import platform
import re
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from mammometry.base.errors import BusyError, StorageError
from mammometry.io.results.records import is_plain
from mammometry.io.write import disk_errors, write_new

if TYPE_CHECKING:
    from filelock import BaseFileLock

LOCK, MARKER, HOLDER = ".lock", ".lock-marker", ".lock-holder"
_KNOWS_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL)
_MARKER_TIMEOUT_S = 3.0  # filelock needs 2 s to recognise a damaged lock file as stale
_CLOCK_S = 2.0  # the note has whole seconds, and process start times are rounded to clock ticks
_HOST = re.compile(r"[\w.-]{1,253}")


class RunLock:
    """The system's lock on a file.

    The lock is released when its process dies. On disks without locks, a marker file names process and computer. It is
    removed if its process ran on this computer and has died.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._lock: BaseFileLock | None = None

    def take(self) -> None:
        """Take the lock, without waiting for another run.

        Raises:
            StorageError: another run holds it, or the folder cannot be written to.
        """
        from filelock import FileLock, SoftFileLock, Timeout

        native = FileLock(self._folder / LOCK, blocking=False, thread_local=False, fallback_to_soft=False)
        marker = SoftFileLock(self._folder / MARKER, timeout=_MARKER_TIMEOUT_S, thread_local=False)
        for path in (self._folder / LOCK, self._folder / MARKER):
            if os.path.lexists(path) and not is_plain(path):
                remedy = "Remove it and run the same command again"
                expected = "a lock file, or nothing"
                raise StorageError(str(path), found="a link or a folder", expected=expected, remedy=remedy)
        with disk_errors(self._folder):
            try:
                self._lock = native
                native.acquire()
            except Timeout:
                raise self._taken(native) from None
            except OSError as error:
                if error.errno not in _KNOWS_NO_LOCKS:
                    raise
                try:
                    self._lock = marker
                    marker.acquire()
                except Timeout:
                    raise self._taken(marker) from None
        about = {"pid": os.getpid(), "host": platform.node(), "since": datetime.now(UTC).isoformat(timespec="seconds")}
        with suppress(OSError):  # used only in the message of another run
            write_new(self._folder / HOLDER, json.dumps(about).encode())

    def release(self) -> None:
        """Release the lock."""
        if self._lock is not None and self._lock.is_locked:
            with suppress(OSError):
                (self._folder / HOLDER).unlink(missing_ok=True)
            self._lock.release()

    def _taken(self, lock: BaseFileLock) -> BusyError:
        remedy = "Wait for it to end, or stop it"
        if Path(lock.lock_file).name == MARKER:
            remedy += f"; if it is no longer running, remove {MARKER} there"
        expected = "one run at a time in a session"
        holder = self.holder()
        found = f"another run in progress there{f' ({holder})' if holder else ''}"
        return BusyError(str(self._folder), found=found, expected=expected, remedy=remedy)

    def holder(self) -> str:
        """Process, computer and start time of the run in progress, from its note. Empty if there is none.

        It does not lock or write anything.
        """
        import psutil

        try:
            holder = json.loads((self._folder / HOLDER).read_text(encoding="utf-8"))
            pid, host, since = holder["pid"], holder["host"], datetime.fromisoformat(holder["since"])
            if not (isinstance(pid, int) and isinstance(host, str) and _HOST.fullmatch(host)):
                return ""
            # Another process may have got the process number of a killed run.
            alive = host != platform.node() or psutil.Process(pid).create_time() <= since.timestamp() + _CLOCK_S
        except psutil.NoSuchProcess:
            return ""
        except psutil.AccessDenied:
            alive = True
        except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
            return ""
        if not alive:
            return ""  # left over from a killed run
        return f"process {pid} on {host}, since {since.isoformat(sep=' ', timespec='seconds')}"
