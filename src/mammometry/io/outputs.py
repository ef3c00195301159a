"""Write results to folders of the user's choice without replacing other people's files.

Each folder that a command writes to contains a record ``.mammometry.json`` with the command and the SHA-256 of each
file. A later run of the same command may replace files that still have this content. Any other existing file is
refused, if possible before anything is computed. Files with other names are never changed.
"""

import hashlib
import os
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mammometry.base.errors import StorageError
from mammometry.io.sealed import sealed, unsealed
from mammometry.io.write import disk_errors, file_digest, staged, sync_folder, write_bytes

RECORD = ".mammometry.json"
_FORMAT = 1  # version of the record of outputs; others are not read


@dataclass(frozen=True, slots=True, kw_only=True)
class Written:
    """A file written by mammometry."""

    command: str
    sha256: tuple[str, ...]
    """Digests of what was written, newest last. If writing was interrupted, also of what was being replaced."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Record:
    """Content of a folder's record."""

    command: str | None = None
    """Command that made the whole folder and keeps its own records there. None for other folders."""
    files: Mapping[str, Written] = field(default_factory=dict)


def require_apart(out: Path, inputs: Iterable[Path | None]) -> None:
    """Refuse an output that is an input, contains one, or is inside one.

    Args:
        out: file or folder to write.
        inputs: files and folders that the command reads. None and missing ones are ignored.

    Raises:
        StorageError: names `out` and the input.
    """
    for path in inputs:
        if path is None or not os.path.lexists(path):
            continue
        if _same(out, path):
            found = "a file or folder that this command reads"
        elif any(_same(out, above) for above in _above(path)):
            found = f"a folder that contains {path}, which this command reads"
        elif any(_same(path, above) for above in _above(out)):
            found = f"a path inside {path}, which this command reads"
        else:
            continue
        remedy = "Choose another place for the results"
        raise StorageError(str(out), found=found, expected="a path outside everything that is read", remedy=remedy)


def require_free(folder: Path, names: Iterable[str], *, command: str) -> None:
    """Refuse existing files, except unchanged output of the same command.

    Args:
        folder: folder to write into, which need not exist.
        names: names of all files that may be written.
        command: command that writes them, such as "study agreement".

    Raises:
        StorageError: names the first existing file, or the folder's record if it cannot be read.
    """
    with disk_errors(folder):
        _require_folder(folder)
        written = _read(folder).files
        for name in names:
            if (found := _in_the_way(folder / name, written.get(name), command)) is not None:
                remedy = "Move it away, or choose another place for the results"
                expected = f"no such file, or an unchanged one from `mammometry {command}`"
                raise StorageError(str(folder / name), found=found, expected=expected, remedy=remedy)


def write_output(path: Path, data: bytes, *, command: str) -> None:
    """Write a single file in the same way as `write_outputs`. Other files of the same command remain."""
    _write(path.parent, {path.name: data}, command=command, remove_former=False)


def write_outputs(folder: Path, files: Mapping[str, bytes], *, command: str) -> None:
    """Write small files into a folder, and replace those that the same command wrote before.

    Args:
        folder: it is created if it does not exist.
        files: name → content.
        command: command that writes them. Unchanged files from its earlier run that are not written now are removed.

    Raises:
        StorageError: another file of this name exists, the disk is full or reports an error.
    """
    _write(folder, files, command=command, remove_former=True)


def _write(folder: Path, files: Mapping[str, bytes], *, command: str, remove_former: bool) -> None:
    require_free(folder, files, command=command)
    with disk_errors(folder), ExitStack() as stack:
        folder.mkdir(parents=True, exist_ok=True)
        fresh = {name: stack.enter_context(staged(folder / name, data)) for name, data in files.items()}
        record = _read(folder)
        former = [
            name
            for name, written in record.files.items()
            if remove_former and name not in files and _in_the_way(folder / name, written, command) is None
        ]
        present = {name: [file_digest(folder / name)] if os.path.lexists(folder / name) else [] for name in files}
        written = {**record.files} | {
            name: Written(command=command, sha256=(*present[name], hashlib.sha256(data).hexdigest()))
            for name, data in files.items()
        }
        require_free(folder, files, command=command)  # checked again, because files may have changed
        # The record is written first, so that the next run recognises the files of an interrupted one.
        _record(folder, _Record(command=record.command, files=written))
        for name, path in fresh.items():
            if present[name]:
                path.replace(folder / name)
            else:
                _put(path, folder / name)
        for name in former:
            (folder / name).unlink(missing_ok=True)
        sync_folder(folder)


def require_own_folder(folder: Path, *, command: str) -> None:
    """Refuse a folder unless it is new, empty, or was made by this command.

    Raises:
        StorageError: names the folder.
    """
    with disk_errors(folder):
        _require_folder(folder)
        if folder.exists() and any(folder.iterdir()) and _read(folder).command != command:
            remedy = "Choose another place for the results"
            expected = f"a new or empty folder, or one that `mammometry {command}` made"
            raise StorageError(str(folder), found="a folder with other files", expected=expected, remedy=remedy)


def take_folder(folder: Path, *, command: str) -> None:
    """Create a folder for one command's output, or continue its earlier one.

    Raises:
        StorageError: it contains something else, the disk is full or reports an error.
    """
    require_own_folder(folder, command=command)
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        record = _read(folder)
    if record.command is None:
        _record(folder, _Record(command=command, files=record.files))


def written_in(folder: Path) -> Mapping[str, Written]:
    """Files that a command wrote into a folder, by name, from the folder's record. Some may be missing.

    Raises:
        StorageError: the record was changed.
    """
    return _read(folder).files


# --- files that we may replace ---


def _in_the_way(path: Path, written: Written | None, command: str) -> str | None:
    """Reason for not replacing a file. None if it is missing or may be replaced."""
    if path.name == RECORD:
        return "the record of what is written here"
    if not os.path.lexists(path):
        return None
    if written is None or path.is_symlink() or not path.is_file():
        return "a file that mammometry did not write, by the record next to it"
    if written.command != command:
        return f"a file of `mammometry {written.command}`"
    return None if file_digest(path) in written.sha256 else "a file that was changed since mammometry wrote it"


def _put(fresh: Path, path: Path) -> None:
    """Rename a file, unless the name exists by then."""
    try:
        os.link(fresh, path)
    except FileExistsError:
        raise
    except OSError:  # a disk without hard links
        if os.path.lexists(path):
            raise
        fresh.replace(path)


def _require_folder(folder: Path) -> None:
    if os.path.lexists(folder) and not folder.is_dir():
        remedy = "Choose another place for the results"
        raise StorageError(str(folder), found="a file", expected="a folder, or nothing yet", remedy=remedy)


def _same(one: Path, other: Path) -> bool:
    """Whether two paths are the same file, apart from links, case or relative parts."""
    try:
        return one.samefile(other)
    except OSError:
        return one.resolve() == other.resolve()


def _above(path: Path) -> tuple[Path, ...]:
    """Folders above a path, as written and with links resolved."""
    return (*path.absolute().parents, *path.resolve().parents)


# --- the record ---


def _read(folder: Path) -> _Record:
    path = folder / RECORD
    if not os.path.lexists(path):
        return _Record()
    try:
        if path.is_symlink():
            raise ValueError("a link")
        table, _ = unsealed(path.read_bytes())
        if table["format"] != _FORMAT:
            raise ValueError(f"format {table['format']}, not {_FORMAT}")
        files = {_plain(name): _written(entry) for name, entry in table["files"].items()}
        command = table.get("folder_of")
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        remedy = "Move it away, or choose another place for the results"
        expected = "the file as mammometry wrote it"
        raise StorageError(
            str(path), found=f"an unreadable record of written files ({error})", expected=expected, remedy=remedy
        ) from None
    return _Record(command=None if command is None else str(command), files=files)


def _plain(name: str) -> str:
    """A file name without a folder."""
    if name in ("", "..", RECORD) or "\0" in name or Path(name).name != name:
        raise ValueError(f"{name!r} is not a file of this folder")
    return name


def _written(entry: Mapping[str, Any]) -> Written:
    return Written(command=str(entry["command"]), sha256=tuple(str(digest) for digest in entry["sha256"]))


def _record(folder: Path, record: _Record) -> None:
    table: dict[str, Any] = {"format": _FORMAT}
    if record.command is not None:
        table["folder_of"] = record.command
    table["files"] = {
        name: {"command": written.command, "sha256": list(written.sha256)} for name, written in record.files.items()
    }
    write_bytes(folder / RECORD, sealed(table))
