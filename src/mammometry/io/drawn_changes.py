"""Changes of what was drawn: item by item. Late ones are refused, and every earlier version is kept."""

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
    HISTORY,
    LANDMARK_FILE,
    boundaries_in,
    landmarks_in,
    origin_words,
    read_table,
)
from mammometry.io.write import disk_errors, write_bytes
from mammometry.job.inputs import SubjectKind

Group: TypeAlias = Literal["boundaries", "landmarks"]
Item: TypeAlias = tuple[Group, str]
"""What is changed by itself: a boundary or a landmark, by name."""
Entry: TypeAlias = Mapping[str, Any]
"""One item as it stands in its file."""

_LOCK = ".lock"
_FILES: Mapping[Group, str] = {"boundaries": BOUNDARIES, "landmarks": LANDMARK_FILE}


class LateError(SessionError):
    """Somebody else has changed the same item meanwhile."""

    def __init__(self, items: Collection[Item], kept: Path, theirs: str) -> None:
        names = " and ".join(name for _, name in items)
        super().__init__(
            names,
            found=f"a change by somebody else meanwhile ({theirs})",
            expected="what you began from",
            remedy=f"Nothing of theirs was replaced, and yours is kept in {HISTORY}/{kept.name}: load theirs, or "
            "replace it by yours",
        )
        self.items = tuple(items)


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """One item as somebody wants it."""

    entry: Entry | None
    """Its new entry. None takes it away."""
    base: str | None
    """Digest (`entry_digest`) of the entry before the change. None if there was none."""


def entry_digest(entry: Entry | None) -> str | None:
    """Tells one version of an item from another."""
    return None if entry is None else hashlib.sha256(json.dumps(entry, sort_keys=True).encode()).hexdigest()[:16]


def drawn_entry(
    points: Float64[Array, "n 3"],
    *,
    method: str,
    author: str,
    earlier: tuple[Entry, ...] = (),
    moment: datetime | None = None,
) -> Entry:
    """An entry of something that somebody drew.

    Args:
        points: mm, world frame.
        method: how: "drawn by hand".
        author: the person's name.
        earlier: what it was made from, the earliest first: method, author and time each.
        moment: when; now, where not given.
    """
    when = (moment or datetime.now(UTC)).strftime("%Y-%m-%dT%H:%M:%SZ")
    entry: dict[str, Any] = {"method": method, "author": author, "drawn": when}
    return entry | ({"earlier": list(earlier)} if earlier else {}) | {"points": points.tolist()}


def drawn_entries(session: Path, kind: SubjectKind, subject: str | None = None) -> dict[Item, Entry]:
    """All that stands in a session's drawn files, checked.

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
    session: Path, kind: SubjectKind, changes: Mapping[Item, Change], *, subject: str | None = None
) -> tuple[Path, ...]:
    """Change items, all of them or none.

    What stood in the files before is kept in ``history/``. Where the first boundary is drawn, the other breast is
    written down as found automatically: it was, and stays so. A file in which nothing is left is taken away.

    Returns:
        The files that changed.

    Raises:
        LateError: an item is no longer what the change was made on; the change is kept in ``history/``.
        SessionError: a file that stands there is not as documented; it stays as it is.
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


def _keep_late(session: Path, changes: Mapping[Item, Change], moment: datetime) -> Path:
    table: dict[str, Any] = {"units": "mm", "frame": "world", "boundaries": {}, "landmarks": {}}
    for (group, name), change in changes.items():
        table[group][name] = change.entry
    path = _free(session, "late", moment)
    write_bytes(path, (json.dumps(table, indent=1, ensure_ascii=False) + "\n").encode())
    return path


def _free(session: Path, stem: str, moment: datetime) -> Path:
    """An unused name in the history, safe against clocks set back."""
    name = f"{stem}-{moment.strftime('%Y%m%dT%H%M%S.%f')}Z"
    path, number = session / HISTORY / f"{name}.json", 1
    while path.exists():
        path, number = path.with_name(f"{name}-{number}.json"), number + 1
    return path


def _same(one: Entry | None, other: Entry | None) -> bool:
    """Whether nothing but the time changes, as when a save is repeated."""

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
    """One at a time, in other processes too."""
    from filelock import FileLock

    lock = FileLock(session / HISTORY / _LOCK, fallback_to_soft=False)
    with disk_errors(session):
        (session / HISTORY).mkdir(exist_ok=True)
    with suppress(OSError):  # some network disks know no locks: then changes meet within one process alone
        lock.acquire()
    try:
        yield
    finally:
        lock.release()
