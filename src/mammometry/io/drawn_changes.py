"""Change a subject's boundaries (boundaries.json) and landmarks (landmarks.json).

Items are changed one by one. A change based on an outdated version is refused. All earlier versions are kept.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, TypeAlias

from mammometry.base.errors import SessionError
from mammometry.geometry.arrays import Array, Float64
from mammometry.io.drawn import (
    BOUNDARIES,
    BREASTS,
    LANDMARK_FILE,
    boundaries_in,
    landmarks_in,
    origin_words,
    read_table,
)
from mammometry.io.write import disk_errors, write_bytes
from mammometry.job.inputs import SubjectKind

HISTORY = "history"
"""Folder of the earlier versions."""
Group: TypeAlias = Literal["boundaries", "landmarks"]
Item: TypeAlias = tuple[Group, str]
"""Item that is changed as a whole: a boundary or a landmark, by name."""
Entry: TypeAlias = Mapping[str, Any]
"""Content of one item in its file."""

_LOCK = ".lock"
_FILES: Mapping[Group, str] = {"boundaries": BOUNDARIES, "landmarks": LANDMARK_FILE}


class LateError(SessionError):
    """Another person has changed the same item since it was loaded."""

    code = "changed-meanwhile"

    def __init__(self, items: Collection[Item], kept: Path, theirs: str) -> None:
        names = " and ".join(name for _, name in items)
        super().__init__(
            names,
            found=f"a change by somebody else in the meantime ({theirs})",
            expected="the version that you started from",
            remedy=f"Their version is unchanged, and yours is kept in {HISTORY}/{kept.name}: load theirs, or "
            "replace it with yours",
        )
        self.items = tuple(items)
        self.on_page = (
            f"{names.replace('_', ' ')}: a change by somebody else meanwhile ({theirs}). Both are kept: load theirs, "
            "or replace it with yours."
        )
        """The same text for a page, without the file's name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ItemChange:
    """Requested change of one item."""

    entry: Entry | None
    """The new entry. None removes it."""
    base: str | None
    """Digest (`entry_digest`) of the entry before the change. None if there was none."""


def entry_digest(entry: Entry | None) -> str | None:
    """Digest that identifies a version of an item."""
    return None if entry is None else hashlib.sha256(json.dumps(entry, sort_keys=True).encode()).hexdigest()[:16]


def drawn_entry(
    points: Float64[Array, "n 3"],
    *,
    method: str,
    author: str,
    earlier: tuple[Entry, ...] = (),
    moment: datetime | None = None,
) -> Entry:
    """Make the entry of a drawn item.

    Args:
        points: points, mm, world frame.
        method: how the item was made, such as "drawn by hand".
        author: the person's name.
        earlier: the versions that it was made from, oldest first, each with method, author and time.
        moment: time. None: now.
    """
    when = (moment or datetime.now(UTC)).strftime("%Y-%m-%dT%H:%M:%SZ")
    entry: dict[str, Any] = {"method": method, "author": author, "drawn": when}
    return entry | ({"earlier": list(earlier)} if earlier else {}) | {"points": points.tolist()}


def drawn_entries(session: Path, kind: SubjectKind, subject: str | None = None) -> dict[Item, Entry]:
    """All items of a session's files of boundaries and landmarks, checked.

    Raises:
        SessionError: a file is not as documented.
    """
    drawn: dict[Item, Entry] = {}
    for group, file in _FILES.items():
        path = session / file
        if path.is_file():
            _check(path, group, kind, subject)
            drawn |= {(group, name): entry for name, entry in read_table(path, group, subject)[group].items()}
    return drawn


def change_drawn(
    session: Path, kind: SubjectKind, changes: Mapping[Item, ItemChange], *, subject: str | None = None
) -> tuple[Path, ...]:
    """Change items: either all of them or none.

    The previous files are kept in ``history/``. When the first boundary is drawn, the other breast's is recorded as
    found automatically, which it was until then. A file without items is removed.

    Returns:
        The files that have changed.

    Raises:
        LateError: an item has changed since the version that the change is based on; the change is kept in
            ``history/``.
        SessionError: an existing file is not as documented. It remains unchanged.
        StorageError: the session cannot be written to.
    """
    moment = datetime.now(UTC)
    with _taken(session):
        before = drawn_entries(session, kind, subject)
        wanted = {item: change for item, change in changes.items() if not _same(before.get(item), change.entry)}
        late = [item for item, change in wanted.items() if entry_digest(before.get(item)) != change.base]
        if late:
            kept = _keep_late(session, wanted, moment)
            raise LateError(
                late, kept, "; ".join(filter(None, (_last(before.get(item)) for item in late))) or "removed"
            )
        changed = []
        for group in _FILES:
            own = {name: change.entry for (of, name), change in wanted.items() if of == group}
            if own:
                changed.append(_write(session, group, own, kind, moment, subject))
        return tuple(changed)


def _write(
    session: Path,
    group: Group,
    changes: Mapping[str, Entry | None],
    kind: SubjectKind,
    moment: datetime,
    subject: str | None,
) -> Path:
    path = session / _FILES[group]
    exists = path.is_file()
    fresh: dict[str, Any] = (
        {"units": "mm", "frame": "world"} | ({} if subject is None else {"subject": subject}) | {group: {}}
    )
    table = read_table(path, group) if exists else fresh
    entries = dict(table[group])
    was_automatic = group == "boundaries" and not any("points" in entry for entry in entries.values())
    for name, entry in changes.items():
        if entry is not None:
            entries[name] = dict(entry)
        else:
            entries.pop(name, None)
    if group == "boundaries":
        if any("points" in entry for entry in entries.values()):
            missing = BREASTS[kind] if was_automatic else tuple(changes)
            for name in missing:
                entries.setdefault(name, {"automatic": True})
        else:
            entries = {name: entry for name, entry in entries.items() if "confirmed" in entry}
    if exists:
        with disk_errors(path):
            write_bytes(_free(session, path.stem, moment), path.read_bytes())
    if entries:
        table |= {"drawn": moment.strftime("%Y-%m-%dT%H:%M:%SZ"), group: entries}
        write_bytes(path, (json.dumps(table, indent=1, ensure_ascii=False) + "\n").encode())
    else:
        with disk_errors(path):
            path.unlink(missing_ok=True)
    return path


def _keep_late(session: Path, changes: Mapping[Item, ItemChange], moment: datetime) -> Path:
    table: dict[str, Any] = {"units": "mm", "frame": "world", "boundaries": {}, "landmarks": {}}
    for (group, name), change in changes.items():
        table[group][name] = change.entry
    path = _free(session, "late", moment)
    write_bytes(path, (json.dumps(table, indent=1, ensure_ascii=False) + "\n").encode())
    return path


def _free(session: Path, stem: str, moment: datetime) -> Path:
    """An unused name in the history, even if the clock was set back."""
    name = f"{stem}-{moment.strftime('%Y%m%dT%H%M%S.%f')}Z"
    path, number = session / HISTORY / f"{name}.json", 1
    while path.exists():
        path, number = path.with_name(f"{name}-{number}.json"), number + 1
    return path


def _same(one: Entry | None, other: Entry | None) -> bool:
    """Whether two entries differ only in time, as after saving twice."""

    def lasting(entry: Entry | None) -> Entry | None:
        return None if entry is None else {key: value for key, value in entry.items() if key != "drawn"}

    return lasting(one) == lasting(other)


def _last(entry: Entry | None) -> str | None:
    return None if entry is None else origin_words(entry) or "automatic"


def _check(path: Path, group: Group, kind: SubjectKind, subject: str | None) -> None:
    if group == "boundaries":
        boundaries_in(path, BREASTS[kind], subject)
    else:
        landmarks_in(path, kind, subject)


@contextmanager
def _taken(session: Path) -> Iterator[None]:
    """Hold the lock for changes, which also excludes other processes."""
    from filelock import FileLock

    lock = FileLock(session / HISTORY / _LOCK, fallback_to_soft=False)
    with disk_errors(session):
        (session / HISTORY).mkdir(exist_ok=True)
    with suppress(OSError):  # some network disks have no locks; then only this process is excluded
        lock.acquire()
    try:
        yield
    finally:
        lock.release()
