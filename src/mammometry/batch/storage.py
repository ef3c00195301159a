"""Sessions on remote storage: any fsspec address, such as ``s3://``.

Such storage cannot replace many files at once. So results go into a new folder, ``results-<digest>``, and then one
small file, ``results.json``, is replaced to name it. Readers see either the old or the new results, complete.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mammometry.base.errors import SessionError, StorageError
from mammometry.batch.record import RECORD, BatchEntry, BatchRow, SessionRecord, Stat, is_address, read_record
from mammometry.io.manifest import MANIFEST
from mammometry.io.meshes.scans import ABOUT

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

POINTER = "results.json"
_RESULTS = "results"


def sessions_at(address: str) -> list[str]:
    """Addresses of the session there, or of those one level down.

    Raises:
        SessionError: there are none.
        StorageError: the storage does not answer.
    """
    with _answers(address):
        system, root = _opened(address)
        system.invalidate_cache()
        if _has_session(system, root):
            return [address.rstrip("/")]
        below = sorted(folder.rstrip("/") for folder in system.ls(root, detail=False)) if system.isdir(root) else []
        sessions = [folder for folder in below if _has_session(system, folder)]
    if not sessions:
        expected = f"a folder with a {MANIFEST} or a {ABOUT}, or of such folders"
        raise SessionError(address, found="no session", expected=expected, remedy="Check the address")
    return [f"{address.rstrip('/')}/{folder.rpartition('/')[2]}" for folder in sessions]


def _has_session(system: AbstractFileSystem, folder: str) -> bool:
    return any(system.isfile(f"{folder}/{name}") for name in (MANIFEST, ABOUT))


def fetch(entry: BatchEntry, folder: Path) -> dict[str, Stat]:
    """Fetch a session and its former results into a new folder.

    Returns:
        Size and version of its files before they were fetched, as `stats`.

    Raises:
        StorageError: the storage does not answer.
    """
    remote = stats(entry)
    with _answers(entry.address):
        system, root = _opened(entry.address)
        for name in remote:
            target = folder / name
            if not target.resolve().is_relative_to(folder.resolve()):
                expected = "files inside the session"
                raise SessionError(entry.address, found=f"a file named {name}", expected=expected, remedy="Remove it")
            target.parent.mkdir(parents=True, exist_ok=True)
            system.get_file(f"{root}/{name}", str(target))
    if (former := _pointed(entry)) is not None:
        with _answers(entry.address):
            system, root = _opened(_base(entry))
            for path in system.find(f"{root}/{former}"):  # other functions of fsspec treat brackets as a pattern
                target = folder / _RESULTS / path[len(root) + len(former) + 1 :].lstrip("/")
                target.parent.mkdir(parents=True, exist_ok=True)
                system.get_file(path, str(target))
    return remote


def put(entry: BatchEntry, results: Path, digest: str) -> None:
    """Send results back, atomically. Former ones are removed afterwards.

    Raises:
        StorageError: the storage does not answer or refuses.
    """
    former = _pointed(entry)
    name = f"{_RESULTS}-{digest[:16]}"
    with _answers(_base(entry)):
        system, root = _opened(_base(entry))
        files = [path for path in sorted(results.rglob("*")) if path.is_file() and not path.name.startswith(".")]
        for folder in sorted({path.parent for path in files}):
            system.makedirs(f"{root}/{name}/{folder.relative_to(results).as_posix()}".rstrip("/."), exist_ok=True)
        for path in files:
            system.put_file(str(path), f"{root}/{name}/{path.relative_to(results).as_posix()}")
        _replace(system, f"{root}/{POINTER}", json.dumps({"format": 1, "results": name}).encode())
        if former is not None and former != name:
            with suppress(OSError):  # no longer read
                _remove(system, f"{root}/{former}")


def _remove(system: AbstractFileSystem, folder: str) -> None:
    """Remove a folder with its contents. Its name is not treated as a pattern."""
    files = system.find(folder)
    folders = {folder}
    for path in files:
        system.rm_file(path)
        below = path[len(folder) :].split("/")[:-1]
        folders |= {folder + "/".join(below[: count + 1]) for count in range(1, len(below))}
    for path in sorted(folders, key=len, reverse=True):
        with suppress(OSError):  # object storage has no folders
            system.rmdir(path)


def look_up(entry: BatchEntry, key: str) -> tuple[BatchRow | None, bool]:
    """Record of a session, and whether its files still match it. Files match by the storage's own tags.

    Raises:
        StorageError: the storage does not answer.
    """
    record = record_of(entry)
    if record is None:
        return None, False
    return record.row, record.key == key and dict(record.files) == stats(entry)


def record_of(entry: BatchEntry) -> SessionRecord | None:
    """The record of the present results. None if there are none.

    Raises:
        StorageError: the storage does not answer.
    """
    former = _pointed(entry)
    if former is None:
        return None
    with _answers(entry.address):
        system, root = _opened(_base(entry))
        try:
            return read_record(system.cat_file(f"{root}/{former}/{RECORD}"))
        except FileNotFoundError:
            return None


def results_of(entry: BatchEntry) -> str | None:
    """Address of the present results."""
    former = _pointed(entry)
    return None if former is None else f"{_base(entry).rstrip('/')}/{former}"


def read(address: str) -> bytes:
    """Content of a file.

    Raises:
        StorageError: the storage does not answer, or there is no such file.
    """
    with _answers(address):
        system, path = _opened(address)
        content: bytes = system.cat_file(path)
        return content


def stats(entry: BatchEntry) -> dict[str, Stat]:
    """Name → size and storage tag of every file of the user.

    The tag is the change time if the storage has none.

    Raises:
        StorageError: the storage does not answer.
    """
    with _answers(entry.address):
        system, root = _opened(entry.address)
        system.invalidate_cache()
        files: Mapping[str, Mapping[str, Any]] = system.find(root, detail=True)
    remote = {}
    for path, about in files.items():
        name = path[len(root) :].lstrip("/")
        first = name.partition("/")[0]
        if first in (_RESULTS, POINTER) or first.startswith((f"{_RESULTS}-", ".")) or "/." in name:
            continue
        changed = about.get("ETag") or about.get("mtime") or about.get("LastModified") or ""
        if (created := about.get("created")) and "ETag" not in about:  # on a disk: when the system changed the file
            changed = f"{changed} {created}"
        remote[name] = (int(about["size"]), changed if isinstance(changed, int | float) else str(changed))
    return dict(sorted(remote.items()))


def _base(entry: BatchEntry) -> str:
    """Address of the folder with the results."""
    return entry.address if entry.results is None else entry.results


def _opened(address: str) -> tuple[AbstractFileSystem, str]:
    from fsspec.core import url_to_fs

    try:
        system, path = url_to_fs(address if is_address(address) else f"file://{address}")
    except (ImportError, ValueError) as error:
        remedy = "Install that package on every machine, or correct the address"
        expected = "an address that fsspec knows and its package (s3fs for s3://, sshfs for sftp://)"
        raise StorageError(
            address, found=f"storage that cannot be opened ({error})", expected=expected, remedy=remedy
        ) from None
    return system, path.rstrip("/")


def _pointed(entry: BatchEntry) -> str | None:
    """Name of the folder with the present results."""
    with _answers(entry.address):
        system, root = _opened(_base(entry))
        system.invalidate_cache()
        try:
            name = json.loads(system.cat_file(f"{root}/{POINTER}"))["results"]
        except (FileNotFoundError, ValueError, KeyError, TypeError):
            return None
    return name if isinstance(name, str) and name.startswith(f"{_RESULTS}-") and "/" not in name else None


def _replace(system: AbstractFileSystem, path: str, data: bytes) -> None:
    """Replace a file atomically: object storage does so, a disk renames."""
    if "s3" in system.protocol or "memory" in system.protocol or "gs" in system.protocol:
        system.pipe_file(path, data)
        return
    system.pipe_file(f"{path}.new", data)
    system.mv(f"{path}.new", path)


@contextmanager
def _answers(address: str) -> Iterator[None]:
    """Turn any error of a storage package into a sentence."""
    try:
        yield
    except (StorageError, SessionError):
        raise
    except Exception as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        remedy = "Check the address, the credentials and the network, and run the same command again"
        expected = "to read the session and to write its results"
        raise StorageError(
            address, found=f"storage that does not answer properly ({reason})", expected=expected, remedy=remedy
        ) from None
