"""Sessions that a batch measures, from folders, patterns and tables."""

import glob
import math
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from mammometry.base.errors import SessionError, TableError
from mammometry.base.listing import visible
from mammometry.batch.record import BatchEntry, is_address
from mammometry.batch.storage import sessions_at
from mammometry.io.csv_tables import CsvTable, read_table
from mammometry.io.meshes.measured import can_be_opened, is_measured

_SESSION, _SET = "session", "set"
_REFERENCE = re.compile(r"reference(?:_(\w+?))?_cc")
_NAMES = ("model", "left", "right")
"""Names of volumes."""


def find_entries(wanted: Sequence[str], results: str | None = None) -> tuple[BatchEntry, ...]:
    """Find the sessions of a command line, each once, in order.

    Args:
        wanted: folders of a session or of sessions, patterns such as ``archive/2026-*``, addresses, and tables (.csv)
            with a column ``session`` and optionally ``set`` and ``reference_cc``, ``reference_left_cc``,
            ``reference_right_cc``.
        results: folder or address for each session's results; None: in the sessions.

    Raises:
        SessionError: a session is missing, or given twice with different settings.
        TableError: a table is invalid.
    """
    entries: dict[str, BatchEntry] = {}
    for text in wanted:
        for entry in _entries(text):
            before = entries.setdefault(entry.address, entry)
            if before.assignments != entry.assignments:
                remedy = "Remove one of the two lines, or copy the session"
                expected = "each session once"
                raise SessionError(
                    entry.address,
                    found="the same session twice, with different settings",
                    expected=expected,
                    remedy=remedy,
                )
    if results is None:
        return tuple(entries.values())
    for address in entries:
        if not is_address(address) and is_measured(Path(address)):
            raise SessionError(
                address, found="a measured mesh, which lies outside this folder", expected="folders that hold all",
                remedy="Measure it without --results, or take the mesh over with `mammometry import mesh`",
            )  # fmt: skip
    base = results.rstrip("/") if is_address(results) else str(Path(results).resolve())
    named: dict[str, str] = {}
    for entry in entries.values():
        if (other := named.setdefault(entry.name, entry.address)) != entry.address:
            remedy = "Rename one of them, or measure them in two batches"
            expected = "sessions whose folders have different names, because --results has one folder for each"
            raise SessionError(
                entry.address, found=f"another session of the same name, {other}", expected=expected, remedy=remedy
            )
    return tuple(
        BatchEntry(
            address=entry.address,
            assignments=entry.assignments,
            reference_cc=entry.reference_cc,
            results=f"{base}/{entry.name}",
        )
        for entry in entries.values()
    )


def _entries(text: str) -> Iterator[BatchEntry]:
    if is_address(text):
        yield from (BatchEntry(address=address) for address in sessions_at(text))
        return
    if text.lower().endswith(".csv"):
        yield from _of_table(Path(text))
        return
    paths = [Path(text)] if os.path.lexists(text) else [Path(path) for path in sorted(glob.glob(text, recursive=True))]
    sessions = [session for path in paths for session in _sessions_in(path)]
    if not sessions:
        remedy = "Check the name; `mammometry new SESSION` makes a session"
        expected = "the folder of a session or a scan, or of such folders; a pattern; a .csv; or an address"
        raise SessionError(text, found="no session" if paths else "no such folder", expected=expected, remedy=remedy)
    yield from (BatchEntry(address=str(session)) for session in sessions)


def _sessions_in(folder: Path) -> list[Path]:
    """The folder itself, or the sessions right below it."""
    resolved = folder.resolve()
    if can_be_opened(resolved):
        return [resolved]
    return [path.resolve() for path in visible(resolved) if path.is_dir() and can_be_opened(path)]


def _of_table(path: Path) -> Iterator[BatchEntry]:
    """Sessions of a table. Their paths are below the table's folder."""
    table = read_table(
        path, str(path), "a first line with a column session, then one session per line", refusal=TableError
    )
    addresses = table.texts(_SESSION)
    assignments = table.texts(_SET) if _SET in table.columns else ("",) * len(addresses)
    columns = {column: _REFERENCE.fullmatch(column) for column in table.columns}
    references = {column: match[1] or "model" for column, match in columns.items() if match is not None}
    wrong = [column for column, name in references.items() if name not in _NAMES]
    wrong += [column for column in columns if column.startswith("reference") and column not in references]
    if wrong:
        expected = "reference_cc, reference_left_cc or reference_right_cc"
        raise TableError(str(path), found=f"a column {wrong[0]}", expected=expected, remedy="Rename the column")
    volumes = _volumes(table, list(references))
    for place, (text, given) in enumerate(zip(addresses, assignments, strict=True)):
        known = {
            name: volume
            for name, volume in zip(references.values(), volumes[place], strict=True)
            if not math.isnan(volume)
        }
        if is_address(text):
            yield BatchEntry(address=text.rstrip("/"), assignments=tuple(given.split()), reference_cc=known)
            continue
        folder = (path.parent / text).resolve()
        if not can_be_opened(folder):
            raise SessionError(
                f"{path}, row {table.lines[place]}",
                found=f"{text!r}, which is no session and no scan",
                expected="the folder of a session or a scan, from the table's own folder on",
                remedy="Correct the line, or remove it",
            )
        yield BatchEntry(address=str(folder), assignments=tuple(given.split()), reference_cc=known)


def _volumes(table: CsvTable, columns: Sequence[str]) -> list[list[float]]:
    """Volumes, cc, row by row. NaN in empty cells: not every subject has a reference.

    Raises:
        TableError: a cell is no number, or below zero.
    """
    volumes = table.numbers(*columns, blank=True, alike=True)
    for row, column in np.argwhere(volumes < 0):
        raise TableError(
            f"{table.name}, row {table.lines[row]}, column {columns[column]}",
            found=f"{volumes[row, column]:g}",
            expected="a volume in cc, or an empty cell",
            remedy="Correct the cell",
        )
    rows: list[list[float]] = volumes.tolist()
    return rows
