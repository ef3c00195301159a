"""Which rig has which camera, where two are on one bus.

A camera that is named in two rigs' files would be opened by both where its maker allows it, and then deliver to
whichever asks first. So each rig of this computer's user takes a lock a camera, by kind and serial number or address,
before it opens them.
"""

from __future__ import annotations

import getpass
import hashlib
import tempfile
from collections.abc import Mapping
from pathlib import Path

from filelock import FileLock, Timeout

from mammometry.base.errors import CaptureError


class Holds:
    """The cameras that a rig holds. Until `release`, or the end of the process."""

    def __init__(self, rig: str, backend: str, ids: Mapping[str, str]) -> None:
        """Take them all, or none.

        Args:
            rig: its name, for whoever wants the same camera.
            backend: kind of cameras.
            ids: camera → serial number, address or port.

        Raises:
            CaptureError: another rig holds one of them.
        """
        self._locks: list[FileLock] = []
        folder = Path(tempfile.gettempdir()) / f"mammometry-cameras-{getpass.getuser()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        for camera, device in ids.items():
            name = hashlib.sha256(f"{backend}\n{device}".encode()).hexdigest()[:24]
            lock, about = FileLock(folder / f"{name}.lock"), folder / f"{name}.txt"
            try:
                lock.acquire(timeout=0)
            except Timeout:
                self.release()
                holder = about.read_text(encoding="utf-8") if about.is_file() else "another program"
                raise CaptureError(
                    camera, found=f"a camera ({device}) that {holder} holds: two rigs on one bus",
                    expected="a camera of this rig alone",
                    remedy="Close the other rig's page or command, or correct the serial numbers in the rigs' files",
                ) from None  # fmt: skip
            about.write_text(f"rig {rig} as camera {camera}", encoding="utf-8")
            self._locks.append(lock)

    def release(self) -> None:
        """Let them go."""
        for lock in self._locks:
            lock.release()
        self._locks.clear()
