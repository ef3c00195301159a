"""Files, folders and renames that survive a power cut."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from mammometry.base.machine import system

_NOT_FOR_FOLDERS = (errno.EINVAL, errno.ENOTSUP, errno.EBADF)  # what network drives answer to fsync of a folder


def sync_file(path: Path) -> None:
    """Wait until a file's content is on the disk.

    Raises:
        OSError: the disk is full or refuses; some say so only now.
    """
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def sync_folder(path: Path) -> None:
    """Wait until the names in a folder are on the disk.

    Raises:
        OSError: the disk refuses.
    """
    try:
        system.sync_folder(path)
    except OSError as error:
        if error.errno not in _NOT_FOR_FOLDERS:
            raise


def sync_tree(folder: Path) -> None:
    """Wait until a folder, its names and contents are on the disk."""
    for path in sorted(folder.rglob("*"), reverse=True):  # what is in a folder before the folder
        if path.is_dir():
            sync_folder(path)
        else:
            sync_file(path)
    sync_folder(folder)


def write_new(path: Path, data: bytes) -> None:
    """Write a new file and wait until it is on the disk.

    Anything with its name is removed first. A link of that name is removed, never followed.
    """
    path.unlink(missing_ok=True)
    with path.open("xb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
