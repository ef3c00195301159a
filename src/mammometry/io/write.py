"""Files written whole or not at all, and what the disk refuses said in one sentence."""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from mammometry.errors import StorageError

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
            raise StorageError(
                str(path),
                found=f"no room to write ({error.strerror or error})",
                expected=f"free disk space; {_free_mb(path)} MB are left",
                remedy="Make room and run the same command again: finished results are kept",
            ) from None
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
    """Write a small UTF-8 file whole or not at all; as `write_bytes`."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, data: bytes) -> None:
    """Write a small file whole or not at all.

    Raises:
        StorageError: the disk is full or refuses.
    """
    fresh = path.with_name(f".{path.name}-{os.getpid()}")
    with disk_errors(path):
        try:
            fresh.write_bytes(data)
            fresh.replace(path)
        finally:
            fresh.unlink(missing_ok=True)


def write_folder(folder: Path, files: Mapping[str, bytes], *, known: Collection[str]) -> None:
    """Write a folder of small files whole or not at all; an earlier one of ours is replaced.

    Args:
        folder: to write.
        files: name → content.
        known: names that an earlier one may hold; with anything else in it, it is somebody else's.

    Raises:
        StorageError: the folder holds something else, the disk is full or refuses.
    """
    if folder.exists():
        strange = (
            sorted(path.name for path in folder.iterdir() if path.name not in known) if folder.is_dir() else ["file"]
        )
        if strange:
            raise StorageError(
                str(folder),
                found=f"something else there ({', '.join(strange[:3])})",
                expected="a new folder, or one that an earlier run has written",
                remedy="Choose another folder",
            )
    fresh, old = (folder.with_name(f".{folder.name}-{os.getpid()}{end}") for end in ("", "-old"))
    with disk_errors(folder):
        try:
            fresh.mkdir(parents=True)
            for name, data in files.items():
                (fresh / name).write_bytes(data)
            if folder.exists():
                folder.replace(old)
            fresh.replace(folder)
        finally:
            shutil.rmtree(fresh, ignore_errors=True)
            if old.exists() and not folder.exists():
                old.replace(folder)
            shutil.rmtree(old, ignore_errors=True)
