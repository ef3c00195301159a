"""Atomic file writes, with disk errors as one sentence."""

from __future__ import annotations

import errno
import hashlib
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mammometry.base.errors import StorageError
from mammometry.io.durable import sync_file, sync_folder

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_DENIED = (errno.EACCES, errno.EPERM, errno.EROFS)


@contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Turn the disk's refusals into sentences.

    Raises:
        StorageError: for every OSError inside; names the file that the system names, else `path`.
    """
    try:
        yield
    except OSError as error:
        if error.errno in _FULL or (error.errno is None and "requested and" in str(error)):  # NumPy's has no number
            full = StorageError(
                str(path),
                found=f"no room to write ({error.strerror or error})",
                expected=f"free disk space; {_free_mb(path)} MB are left",
                remedy="Make room and run the same command again: finished results are kept",
            )
            full.is_full = True
            raise full from None
        if error.errno in _DENIED:
            raise StorageError(
                str(error.filename or path),
                found=f"no permission ({error.strerror})",
                expected="a folder that may be written to",
                remedy="Change its permissions, or copy the session elsewhere",
            ) from None
        raise StorageError(
            str(error.filename or path),
            found=f"a disk that refuses ({error.strerror or error})",
            expected="to read and write results",
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
    """Write a small UTF-8 file atomically, as `write_bytes` does."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, data: bytes) -> None:
    """Write a small file atomically and wait until it is stored.

    The file at `path` is replaced, whoever wrote it. For places that a user names, use `outputs.write_outputs`. What
    stands at `path` is replaced, whoever wrote it: `outputs.write_outputs` is for places that a user names.

    Raises:
        StorageError: the disk is full or refuses.
    """
    with disk_errors(path), staged(path, data) as fresh:
        fresh.replace(path)
        sync_folder(path.parent)


@contextmanager
def staged(path: Path, data: bytes) -> Iterator[Path]:
    """Write a hidden file beside `path`, ready to be renamed to it. Removed at the end where it was not.

    Raises:
        OSError: the disk is full or refuses.
    """
    fresh = path.with_name(f".{path.name}-{secrets.token_hex(6)}")
    try:
        with fresh.open("xb") as file:
            file.write(data)
        sync_file(fresh)
        yield fresh
    finally:
        fresh.unlink(missing_ok=True)
