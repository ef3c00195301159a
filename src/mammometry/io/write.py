"""Atomic file writes that survive a power failure. Disk errors become one sentence."""

import errno
import hashlib
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mammometry.base.errors import FullDiskError, StorageError
from mammometry.base.machine import system

# errors of network drives when fsync is called for a folder
_NOT_FOR_FOLDERS = (errno.EINVAL, errno.ENOTSUP, errno.EBADF)


def sync_file(path: Path) -> None:
    """Wait until a file's content is on the disk.

    Raises:
        OSError: the disk is full or reports an error, which some disks do only now.
    """
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def sync_folder(path: Path) -> None:
    """Wait until a folder's entries are on the disk.

    Raises:
        OSError: the disk reports an error.
    """
    try:
        system.sync_folder(path)
    except OSError as error:
        if error.errno not in _NOT_FOR_FOLDERS:
            raise


def sync_tree(folder: Path) -> None:
    """Wait until a folder and everything below it are on the disk."""
    for path in sorted(folder.rglob("*"), reverse=True):  # content before its folder
        if path.is_dir():
            sync_folder(path)
        else:
            sync_file(path)
    sync_folder(folder)


def write_new(path: Path, data: bytes) -> None:
    """Write a new file and wait until it is on the disk.

    A file of this name is removed first. A link is not followed.
    """
    path.unlink(missing_ok=True)
    with path.open("xb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_DENIED = (errno.EACCES, errno.EPERM, errno.EROFS)


@contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Turn disk errors into `StorageError`.

    Raises:
        FullDiskError: the disk is full.
        StorageError: any other OSError inside. It names the file in the system's error, or else `path`.
    """
    try:
        yield
    except OSError as error:
        # NumPy's error of a short write has neither an errno nor a type of its own.
        if error.errno in _FULL or (error.errno is None and "requested and" in str(error)):
            raise FullDiskError(
                str(path),
                found=f"no room to write ({error.strerror or error})",
                expected=f"free disk space; {_free_mb(path)} MB are left",
                remedy="Make room and run the same command again: finished results are kept",
            ) from None
        if error.errno in _DENIED:
            remedy = "Change its permissions, or copy the session to another disk"
            expected = "a writable folder"
            raise StorageError(
                str(error.filename or path), found=f"no permission ({error.strerror})", expected=expected, remedy=remedy
            ) from None
        raise StorageError(
            str(error.filename or path),
            found=f"a disk error ({error.strerror or error})",
            expected="a disk that can be read and written",
            remedy="Check the disk and run the same command again: finished results are kept",
        ) from None


def _free_mb(path: Path) -> int:
    while not path.exists():
        path = path.parent
    return shutil.disk_usage(path).free // 2**20


def file_digest(path: Path) -> str:
    """SHA-256 of a file's content, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_text(path: Path, text: str) -> None:
    """Write a small UTF-8 file atomically, in the same way as `write_bytes`."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, data: bytes) -> None:
    """Write a small file atomically and wait until it is stored.

    A file at `path` is replaced. In folders of the user's choice, use `outputs.write_outputs` instead.

    Raises:
        StorageError: the disk is full or reports an error.
    """
    with disk_errors(path), staged(path, data) as fresh:
        fresh.replace(path)
        sync_folder(path.parent)


@contextmanager
def staged(path: Path, data: bytes) -> Iterator[Path]:
    """Write a hidden file next to `path`, for the caller to rename. Otherwise it is removed at the end.

    Raises:
        OSError: the disk is full or reports an error.
    """
    fresh = path.with_name(f".{path.name}-{secrets.token_hex(6)}")
    try:
        with fresh.open("xb") as file:
            file.write(data)
        sync_file(fresh)
        yield fresh
    finally:
        fresh.unlink(missing_ok=True)
