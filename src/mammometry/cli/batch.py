"""Command `batch`: many sessions on this machine or on a Dask cluster."""

from __future__ import annotations

import json as plain_json
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mammometry.cli.common import Answer, Bars, Options, command

if TYPE_CHECKING:
    from rich.console import RenderableType

    from mammometry.batch.batch import SessionOutcome
    from mammometry.batch.engine import Began, Ended, StopRequest
    from mammometry.report.documents.batch_page import BatchLine

app = typer.Typer()
SOME_FAILED = 11
"""Exit code: the batch or study finished, and at least one session failed."""
INTERRUPTED = 130
"""Exit code: stopped by Ctrl-C, 128 + SIGINT by the convention of shells."""
_OUT = Path("batch")
_SHOWN = 12  # running sessions that the live table shows


@command(
    app,
    "mammometry batch ARCHIVE",
    "mammometry batch 'ARCHIVE/2026-*' --out trial --cores 2",
    "mammometry batch sessions.csv --scheduler tcp://host:8786 --json",
    "mammometry batch s3://bucket/trial --results s3://bucket/results",
)
def batch(
    options: Options,
    sessions: Annotated[
        list[str],
        typer.Argument(
            metavar="SESSIONS...",
            help="Folders of sessions, patterns, addresses such as s3://…, or a .csv with columns session, set, "
            "reference_cc.",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder for the table and the page.")] = _OUT,
    results: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="Folder for all results. Without it, they are in the sessions.", show_default=False
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="tcp://HOST:PORT", help="A cluster's Dask scheduler. Without it, this machine.", show_default=False
        ),
    ] = None,
    cores: Annotated[int, typer.Option(help="Cores for each session.", min=1)] = 1,
    at_once: Annotated[
        int | None, typer.Option(help="Cores of this machine to use.", min=1, show_default="all")
    ] = None,
    memory: Annotated[
        float | None,
        typer.Option(metavar="GB", help="Memory of this machine to use.", min=0.1, show_default="nearly all"),
    ] = None,
) -> Answer:
    """Measure many sessions in parallel.

    Current sessions are skipped. A failed session does not stop the others. Ctrl-C finishes the running sessions, twice
    stops them. The same command continues from there. With --json every event is one line.
    """  # fmt: skip
    from mammometry.base.errors import SettingsError
    from mammometry.batch.batch import look, measure_batch
    from mammometry.batch.cluster import machines
    from mammometry.batch.entries import find_entries
    from mammometry.batch.record import is_address
    from mammometry.io.outputs import require_apart, require_free, write_outputs
    from mammometry.report.documents.batch_page import FILES, batch_files, counted

    if scheduler is not None and (at_once or memory):
        raise typer.BadParameter("--at-once and --memory are for this machine: leave them out with --scheduler")
    begun = time.monotonic()
    chosen = options.settings()
    entries = find_entries(sessions, results)
    local = [Path(entry.address) for entry in entries if not is_address(entry.address)]
    require_apart(
        out, [*local, *(Path(session) for session in sessions if session.lower().endswith(".csv")), options.file]
    )
    require_free(out, FILES, command="batch")
    for entry in entries:
        try:
            chosen.overridden(entry.assignments)
        except SettingsError as error:
            raise SettingsError(
                f"{entry.address}, {error.subject}", found=error.found, expected=error.expected, remedy=error.remedy
            ) from None
    with Bars(options.silent) as bars, bars.task("look", "sessions") as progress:
        looked = look(entries, chosen, progress)
    todo = [entry.address for entry in entries if entry.address not in looked.current]
    show = _Show(len(entries), todo, options)
    lines: Sequence[SessionOutcome]
    stop = _Wishes()
    with stop.heard():
        if todo:
            with machines(scheduler, at_once, None if memory is None else 1000 * memory) as workers:
                show.begin(workers.dashboard)
                with show.live():
                    lines = measure_batch(
                        entries, chosen, workers, looked, cores=cores, watch=show.happened, stop=stop.now
                    )
        else:
            lines = measure_batch(entries, chosen, None, looked)  # type: ignore[arg-type]  # nobody is asked
    texts = [_said(line) for line in lines]
    title = Path(sessions[0]).stem if len(sessions) == 1 else f"{len(sessions)} folders"
    written = batch_files(title, texts)
    write_outputs(out, written, command="batch")
    counts = Counter(line.state for line in lines)
    code = INTERRUPTED if counts["stopped"] else SOME_FAILED if counts["failed"] else 0
    table = {
        "sessions": len(lines),
        **{state: counts[state] for state in ("measured", "current", "failed", "stopped")},
        "failures": {line.entry.address: line.failed for line in lines if line.state == "failed"},
        "seconds": round(time.monotonic() - begun, 3),
        "page": str(out / "batch.html"),
        "files": sorted(str(out / name) for name in written),
    }
    shown: list[RenderableType] = [f"{line.entry.name}: {line.failed}" for line in lines if line.failed]
    if counts["stopped"]:
        shown.append("Interrupted: finished sessions are kept. The same command continues with the others.")
    return Answer(table, [*shown, counted(texts), f"Page and tables: {out / 'batch.html'}"], code)


def _said(line: SessionOutcome) -> BatchLine:
    """One session's row of the page."""
    from mammometry.report.documents.batch_page import BatchLine, BatchVolume

    row = line.row
    if row is None:
        return BatchLine(
            session=line.entry.name,
            address=line.entry.address,
            state=line.state,
            failed=line.failed,
            peak_memory_mb=line.memory_mb,
            host=line.host,
        )
    where = line.results
    return BatchLine(
        session=line.entry.name,
        address=line.entry.address,
        state=line.state,
        subject=row.subject or "",
        date=row.date or "",
        volumes=tuple(
            BatchVolume(
                name=side.name,
                volume_cc=side.volume_cc,
                interval_cc=side.interval_cc,
                reference_cc=line.entry.reference_cc.get(side.name),
            )
            for side in row.measured
        ),
        no_breast=row.no_breast,
        notices=row.notices,
        seconds=row.seconds,
        peak_memory_mb=row.peak_memory_mb,
        made_at=row.made_at or "",
        host=line.host,
        page=f"{where}/{row.page}" if where is not None else "",
        thumbnail=row.thumbnail,
    )


class _Wishes:
    """Counts how often Ctrl-C was pressed."""

    def __init__(self) -> None:
        self._pressed = 0

    def now(self) -> StopRequest:
        """Stop request by the number of presses: none, finish, stop."""
        from mammometry.batch.engine import StopRequest

        return (StopRequest.NONE, StopRequest.FINISH, StopRequest.STOP)[min(self._pressed, 2)]

    @contextmanager
    def heard(self) -> Iterator[None]:
        """Handle Ctrl-C, and SIGTERM, which counts as two."""
        before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

        def pressed(number: int, frame: FrameType | None) -> None:
            self._pressed += 1 if number == signal.SIGINT else 2
            if self._pressed == 1:
                print("Finishing the running sessions. Ctrl-C again stops them.", file=sys.stderr, flush=True)  # noqa: T201

        for number in before:
            signal.signal(number, pressed)
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


class _Show:
    """Progress of a batch as a live table, lines or JSON lines."""

    def __init__(self, count: int, todo: Sequence[str], options: Options) -> None:
        self._count, self._todo = count, len(todo)
        self._quiet, self._json = options.silent, options.json
        self._at_work: dict[str, tuple[str, float, float]] = {}
        self._ended = Counter[str]()
        self._begun = time.monotonic()
        self._dashboard: str | None = None
        self._refresh: Callable[[], None] = lambda: None

    def begin(self, dashboard: str | None) -> None:
        """Show how many sessions are to be measured."""
        self._begun, self._dashboard = time.monotonic(), dashboard
        current = self._count - self._todo
        self._tell({"event": "begin", "sessions": self._count, "current": current, "dashboard": dashboard})
        if not self._quiet:
            pages = f" Dask's pages: {dashboard}" if dashboard else ""
            of = "session" if self._todo == 1 else "sessions"
            print(f"{self._todo} {of} to measure, {current} current.{pages}", file=sys.stderr)  # noqa: T201

    @contextmanager
    def live(self) -> Iterator[None]:
        """Show the live table on a terminal."""
        if self._quiet or not sys.stderr.isatty():
            yield
            return
        from rich.console import Console
        from rich.live import Live

        with Live(get_renderable=self._table, console=Console(stderr=True), refresh_per_second=2, transient=True):
            yield

    def happened(self, event: Began | Ended) -> None:
        """Show an event."""
        from mammometry.batch.engine import Began

        name = event.name
        if isinstance(event, Began):
            since = self._at_work[name][2] if name in self._at_work else time.monotonic()
            self._at_work[name] = (event.stage, event.fraction, since)
            self._tell({"event": "stage", "session": name, "stage": event.stage, "fraction": event.fraction})
            return
        self._at_work.pop(name, None)
        self._ended["failed" if event.failed else "measured"] += 1
        about = {"event": "ended", "session": name, "failed": event.failed or None, "kind": event.kind or None}
        about["code"] = event.code or None
        self._tell(about | {"host": event.host, "memory_mb": event.memory_mb})
        if not self._quiet and not sys.stderr.isatty():
            print(f"{Path(name).name}: {event.failed or 'measured'}", file=sys.stderr, flush=True)  # noqa: T201

    def _tell(self, about: dict[str, Any]) -> None:
        if self._json:
            print(plain_json.dumps(about, ensure_ascii=False), file=sys.__stdout__, flush=True)

    def _table(self) -> RenderableType:
        from rich.table import Table

        now, done = time.monotonic(), self._ended.total()
        left = self._todo - done - len(self._at_work)
        ends = f", about {_duration((now - self._begun) / done * (self._todo - done))} left" if done else ""
        table = Table(
            "session", "stage", "done", "since", box=None, pad_edge=False,
            title=f"{self._ended['measured']} measured, {self._ended['failed']} failed, {len(self._at_work)} running, "
            f"{left} waiting{ends}",
        )  # fmt: skip
        for name, (stage, fraction, since) in list(self._at_work.items())[:_SHOWN]:
            table.add_row(Path(name).name, stage, f"{100 * fraction:.0f} %", _duration(now - since))
        return table


def _duration(seconds: float) -> str:
    """A duration in at most two units."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{rest} s"
