"""Batch of sessions: skip current ones, measure the others, report each."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

from mammometry.base.child_process import Call
from mammometry.base.errors import BatchError, MammometryError
from mammometry.base.progress import MapTasks, Progress, no_progress
from mammometry.batch import record, storage
from mammometry.batch.cluster import Machines
from mammometry.batch.engine import Began, Ended, Engine, StopRequest, Task
from mammometry.batch.record import BatchEntry, BatchRow, key_of
from mammometry.batch.session import measure_entry
from mammometry.io.meshes.measured import results_of
from mammometry.io.photographs.images import megapixels_of
from mammometry.settings import Settings

State: TypeAlias = Literal["current", "measured", "failed", "stopped"]
_READERS = 8  # threads that read records: they wait for network disks, and not for a core


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionOutcome:
    """Outcome of one session."""

    entry: BatchEntry
    state: State
    row: BatchRow | None = None
    """Its result. None if it failed or was not measured."""
    failed: str = ""
    """Reason for having no result, one sentence."""
    kind: str = ""
    """Class of the error."""
    exit_code: int = 0
    host: str = ""
    memory_mb: float | None = None

    @property
    def results(self) -> str | None:
        """Address of its results. None if there are none."""
        if self.row is None:
            return None
        return storage.results_of(self.entry) if self.entry.remote else str(results_of(Path(self.entry.address)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Looked:
    """Known facts about the sessions before measuring."""

    current: Mapping[str, BatchRow]
    """Address → row of each current session."""
    known: Mapping[str, BatchRow]
    """Address → row of each session that was ever measured in a batch."""


def look(entries: Sequence[BatchEntry], settings: Settings, progress: Progress = no_progress) -> Looked:
    """Find current sessions by the sizes and times of their files.

    Raises:
        MammometryError: an entry has an invalid setting; storage does not answer.
    """
    keys: dict[tuple[str, ...], str] = {}
    for entry in entries:
        if entry.assignments not in keys:
            keys[entry.assignments] = key_of(settings.overridden(entry.assignments))

    def looked(entry: BatchEntry) -> tuple[BatchRow | None, bool]:
        key = keys[entry.assignments]
        return storage.look_up(entry, key) if entry.remote else record.look_up(Path(entry.address), key)

    current, known = {}, {}
    with ThreadPoolExecutor(_READERS) as pool:
        for place, (entry, (row, fresh)) in enumerate(zip(entries, pool.map(looked, entries), strict=True)):
            progress((place + 1) / len(entries))
            if row is not None:
                known[entry.address] = row
                if fresh:
                    current[entry.address] = row
    return Looked(current=current, known=known)


def measure_batch(
    entries: Sequence[BatchEntry],
    settings: Settings,
    machines: Machines,
    looked: Looked,
    *,
    cores: int = 1,
    watch: Callable[[Began | Ended], None] = lambda event: None,
    stop: Callable[[], StopRequest] = lambda: StopRequest.NONE,
) -> tuple[SessionOutcome, ...]:
    """Measure the stale sessions.

    Args:
        entries: all sessions.
        settings: for all of them; an entry's own take precedence.
        machines: the workers.
        looked: the known facts.
        cores: per session.
        watch: called for each event.
        stop: returns the user's request.

    Returns:
        A line for every entry, in their order. Sessions that were not started, or were interrupted, are ``stopped``.

    Raises:
        BatchError: the scheduler has stopped, or a worker has another version of mammometry.
    """
    todo = {entry.address: entry for entry in entries if entry.address not in looked.current}
    text = settings.to_toml()
    with ThreadPoolExecutor(_READERS) as pool:
        sizes = list(pool.map(lambda entry: _size(entry, looked), todo.values()))
    tasks = [
        Task(name=address, call=Call(function=measure_entry, arguments=(entry, text)), megapixels=size)
        for (address, entry), size in zip(todo.items(), sizes, strict=True)
    ]
    known = [
        (row.megapixels, row.peak_memory_mb) for row in looked.known.values() if row.megapixels and row.peak_memory_mb
    ]
    lines = {
        address: SessionOutcome(entry=entry, state="current", row=looked.current[address])
        for address, entry in ((entry.address, entry) for entry in entries)
        if address in looked.current
    }
    if tasks:
        engine = Engine(machines, cores=cores, known=known, stop=stop)
        for event in engine.run(tasks):
            watch(event)
            if isinstance(event, Ended):
                lines[event.name] = _line(todo[event.name], event)
    return tuple(lines.get(entry.address, SessionOutcome(entry=entry, state="stopped")) for entry in entries)


def _size(entry: BatchEntry, looked: Looked) -> float | None:
    """Megapixels of its photographs. None if they cannot be read from here."""
    if (row := looked.known.get(entry.address)) is not None:
        return row.megapixels or None
    try:
        return None if entry.remote else megapixels_of(Path(entry.address) / "capture") or None
    except (OSError, MammometryError):  # its own task will report the fault
        return None


def _line(entry: BatchEntry, event: Ended) -> SessionOutcome:
    about = {"host": event.host, "memory_mb": event.memory_mb}
    if event.failed:
        return SessionOutcome(
            entry=entry,
            state="failed",
            failed=event.failed,
            kind=event.kind,
            exit_code=event.exit_code,
            **about,  # type: ignore[arg-type]
        )
    try:
        record = storage.record_of(entry) if entry.remote else _record_at(Path(entry.address))
    except MammometryError as error:
        return SessionOutcome(
            entry=entry, state="failed", failed=str(error), kind="StorageError", exit_code=error.exit_code
        )
    if record is None or record.digest != event.value["digest"]:
        refusal = "Its results are not those that were measured: they were changed, or this machine sees other storage."
        return SessionOutcome(entry=entry, state="failed", failed=refusal, kind="StorageError", exit_code=9)
    return SessionOutcome(entry=entry, state="measured", row=record.row, **about)  # type: ignore[arg-type]


def _record_at(session: Path) -> record.SessionRecord | None:
    try:
        return record.read_record((results_of(session) / record.RECORD).read_bytes())
    except OSError:
        return None


def map_tasks_on(
    machines: Machines,
    *,
    megapixels: float | None = None,
    watch: Callable[[Began | Ended], None] = lambda event: None,
) -> MapTasks:
    """Make a loop that runs each turn as a Dask task in its own process.

    Args:
        machines: the workers.
        megapixels: of the photographs in each turn, for estimating memory.
        watch: called for each event.
    """
    known: list[tuple[float, float]] = []

    def map_tasks(function: Callable[..., Any], arguments: Mapping[str, tuple[Any, ...]]) -> dict[str, Any]:
        tasks = [
            Task(name=name, call=Call(function=function, arguments=given), megapixels=megapixels)
            for name, given in arguments.items()
        ]
        done: dict[str, Any] = {}
        for event in Engine(machines, known=known).run(tasks):
            watch(event)
            if isinstance(event, Ended):
                if event.failed:
                    raise BatchError(
                        event.name,
                        found=f"a task that failed ({event.failed.rstrip('.')})",
                        expected="results of all of them",
                        remedy="Remove the cause and run the same command again: finished results are kept",
                    )
                done[event.name] = event.value
                if megapixels and event.memory_mb:
                    known.append((megapixels, event.memory_mb))
        if len(done) < len(tasks):
            raise KeyboardInterrupt
        return done

    return map_tasks
