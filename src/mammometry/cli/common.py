"""Options, progress bars and answers (text or JSON) shared by all commands."""

from __future__ import annotations

import inspect
import logging
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field, fields, is_dataclass
from datetime import datetime
from functools import wraps
from pathlib import Path
from threading import Event, Lock, Thread
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from mammometry.base.progress import TICK_S, ticking
from mammometry.base.value import value

if TYPE_CHECKING:
    from rich.console import RenderableType

    from mammometry.base.progress import Progress
    from mammometry.job.products import Key
    from mammometry.settings import Settings

SessionFolder = Annotated[Path, typer.Argument(metavar="SESSION", help="The session folder.", show_default=False)]
SessionOrScan = Annotated[
    Path, typer.Argument(metavar="SESSION", help="A session's folder, or a scan's.", show_default=False)
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Json = Annotated[bool, typer.Option("--json", help="Print the answer as one JSON object.")]
Verbose = Annotated[
    int, typer.Option("--verbose", "-v", count=True, help="Log to standard error. -vv logs more.", show_default=False)
]
Assignments = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="NAME=VALUE", help="Change a setting, such as matching.window_px=11. May be repeated.",
        show_default=False,
    ),
]  # fmt: skip
SettingsFile = Annotated[
    Path | None, typer.Option("--settings", metavar="FILE", help="Read settings from a TOML file.", show_default=False)
]


SUBJECT_ID = ("--id", "--subject")
"""Names of the option for the subject's pseudonym."""


@value
class JsonOptions:
    """Options that every command has."""

    json: Json = False
    verbose: Verbose = 0


@value
class OutputOptions:
    """Options of a command that takes a while."""

    quiet: Quiet = False
    json: Json = False
    verbose: Verbose = 0

    @property
    def silent(self) -> bool:
        """Whether no progress is shown."""
        return self.quiet or self.json


@value
class Options:
    """Options of commands that use the settings."""

    assignments: Assignments = None
    file: SettingsFile = None
    quiet: Quiet = False
    json: Json = False
    verbose: Verbose = 0

    @property
    def silent(self) -> bool:
        """Whether no progress is shown."""
        return self.quiet or self.json

    @property
    def words(self) -> tuple[str | Path, ...]:
        """The settings in use as command-line options, for suggested commands."""
        chosen = (word for assignment in self.assignments or () for word in ("--set", assignment))
        return (*(() if self.file is None else ("--settings", self.file)), *chosen)

    def settings(self, *more: str) -> Settings:
        """The default settings, changed by the file, then by the assignments, then by further ones."""
        from mammometry.settings import Settings

        settings = Settings() if self.file is None else Settings.load(self.file)
        return settings.overridden([*(self.assignments or ()), *more])


def command(
    app: typer.Typer, *lines: str, name: str | None = None
) -> Callable[[Callable[..., Answer]], Callable[..., Answer]]:
    """Make a function a command. The fields of its parameters that are values become options.

    Args:
        app: the group of commands.
        lines: examples for the end of its help.
        name: of the command, where it is not the function's.
    """

    def register(function: Callable[..., Answer]) -> Callable[..., Answer]:
        own = inspect.signature(function, eval_str=True).parameters.values()
        values: dict[str, Any] = {
            parameter.name: parameter.annotation for parameter in own if is_dataclass(parameter.annotation)
        }
        options = {
            name: [
                inspect.Parameter(field.name, inspect.Parameter.KEYWORD_ONLY, default=field.default, annotation=hint)
                for field, hint in zip(fields(kind), get_type_hints(kind, include_extras=True).values(), strict=True)
            ]
            for name, kind in values.items()
        }

        @wraps(function)
        def call(**given: Any) -> Answer:
            made = {
                name: kind(**{option.name: given.pop(option.name) for option in options[name]})
                for name, kind in values.items()
            }
            return function(**given, **made)

        shown = [
            parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in own if parameter.name not in values
        ]
        shown += [option for group in reversed(options.values()) for option in group]
        call.__signature__ = inspect.Signature(shown)  # type: ignore[attr-defined]
        call.__annotations__ = {parameter.name: parameter.annotation for parameter in shown}
        app.command(name, epilog=examples(*lines) if lines else None)(call)
        return call

    return register


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer of a command: lines for people, and JSON."""

    table: dict[str, Any]
    """JSON-ready."""
    lines: list[RenderableType] = field(default_factory=list)
    """For the terminal."""
    exit_code: int = 0
    """Exit code of the process."""


def examples(*lines: str) -> str:
    """End of a command's help: its examples, one per line."""
    return "\n\n".join(["Examples:", *(f"  $ {line}" for line in lines)])


def opener(browser: bool) -> Callable[[str, str], None]:
    """A function that prints a local page's one-time address, and may open it."""

    def ready(address: str, local_file: str) -> None:
        import webbrowser

        # Standard output is for the answer, after the page was closed.
        print(f"{address} (works once; Ctrl-C stops)", file=sys.stderr, flush=True)  # noqa: T201
        if browser:
            webbrowser.open(local_file)

    return ready


def nothing_made(made_at: str | None) -> str:
    """State that all results are current, and when they were made."""
    when = "" if made_at is None else datetime.fromisoformat(made_at).strftime(", made %Y-%m-%d %H:%M UTC")
    return f"All results are current{when}. Nothing had to be computed."


def start_logging(verbose: int) -> None:
    """Log to standard error: nothing, what is done (-v), everything (-vv).

    Warnings only with -v. Of other libraries only warnings are logged: they name files, and a folder may be named
    after a patient.
    """
    logging.captureWarnings(True)
    if verbose:
        level = logging.INFO if verbose == 1 else logging.DEBUG
        form = "%(asctime)s %(name)s: %(message)s"
        logging.basicConfig(level=logging.WARNING, format=form, stream=sys.stderr, force=True)
        logging.getLogger("mammometry").setLevel(level)
    else:
        logging.basicConfig(level=logging.CRITICAL, stream=sys.stderr, force=True)
        logging.getLogger("mammometry").setLevel(logging.NOTSET)  # an earlier command of this process may have set it


_TENTH = 10.0  # percent of a stage between two lines without a terminal
_SPARSE_S = 5.0  # seconds between two such lines at least, so that a fast stage does not fill a log
_SILENT_S = 28.0  # seconds without a line at most: with the tick, within half a minute


class Bars:
    """Progress on standard error: a bar for each stage.

    Without a terminal, a line at the start of a stage, after each tenth of it, and at least every half minute.
    """

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet
        self._lock = Lock()  # products may be made in parallel
        self._bars: Any = None
        self._tasks: dict[str, Any] = {}
        self._totals: dict[str, int] = {}
        self._expected_s: dict[tuple[str, str], float] = {}
        self._fractions: dict[str, dict[str, float]] = {}
        self._begun_s = self._line_s = time.monotonic()
        self._said: dict[str, str] = {}
        self._stage = ""
        self._ended = Event()

    def __enter__(self) -> Bars:
        if self._quiet:
            return self
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

            columns = (
                TextColumn("{task.fields[stage]:<11}"),
                BarColumn(),
                TextColumn("{task.percentage:>3.0f} %"),
                TimeElapsedColumn(),
                TextColumn("{task.description}"),
            )
            self._bars = Progress(*columns, console=Console(stderr=True))
            self._bars.start()
        else:
            Thread(target=self._say_in_silence, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        if self._bars is not None:
            self._bars.stop()

    def expect(self, stage: str, products: int, seconds: Mapping[str, float] = MappingProxyType({})) -> None:
        """Set how many products of a stage are to be made, and how long they took last time, by name."""
        self._totals[stage] = products
        self._expected_s |= {(stage, what.replace("/", " ")): value for what, value in seconds.items()}

    @contextmanager
    def task(self, stage: str, what: str) -> Iterator[Progress]:
        """Show one task. Returns its progress callback."""

        def on_progress(fraction: float) -> None:
            with self._lock:
                fractions = self._fractions.setdefault(stage, {})
                begins = not fractions
                fractions[what] = max(min(fraction, 1.0), fractions.get(what, 0.0))
                if self._bars is not None:
                    self._show(stage, what)
                elif not self._quiet:
                    self._stage = stage
                    tenth = f"{self._share(stage) // _TENTH * _TENTH:.0f} %"
                    waited_s = time.monotonic() - self._line_s
                    if begins or (self._said.get(stage) != tenth and waited_s >= _SPARSE_S):
                        self._line(stage, begins=begins)

        on_progress(0.0)
        with ticking(on_progress, self._expected_s.get((stage, what))) as report:
            yield report
        on_progress(1.0)

    def _share(self, stage: str) -> float:
        """Percentage of a stage that is done."""
        fractions = self._fractions.get(stage, {})
        return 100 * sum(fractions.values()) / max(self._totals.get(stage, 0), len(fractions), 1)

    def _line(self, stage: str, *, begins: bool = False) -> None:
        now = time.monotonic()
        share = self._share(stage)
        words = f"{stage} …" if begins else f"{stage} {share:.0f} %, {now - self._begun_s:.0f} s"
        print(words, file=sys.stderr, flush=True)  # noqa: T201  # the terminal's own module
        self._line_s, self._said[stage] = now, f"{share // _TENTH * _TENTH:.0f} %"

    def _say_in_silence(self) -> None:
        """Repeat the current step after a long silence."""
        while not self._ended.wait(TICK_S):
            with self._lock:
                if self._stage and time.monotonic() - self._line_s >= _SILENT_S:
                    self._line(self._stage)

    def watch(self, key: Key) -> AbstractContextManager[Progress]:
        """Progress callback for one product."""
        return self.task(key.stage, key.product.replace("/", " "))

    def watch_as(self, number: int) -> Callable[[Key], AbstractContextManager[Progress]]:
        """Progress callback for the products of one of several sessions, each with its own bars."""
        return lambda key: self.task(f"{key.stage} {number}", key.product.replace("/", " "))

    def _show(self, stage: str, what: str) -> None:
        fractions = self._fractions[stage]
        total = max(self._totals.get(stage, 0), len(fractions))
        if stage not in self._tasks:
            self._tasks[stage] = self._bars.add_task(what, total=total, stage=stage)
        done = sum(fractions.values())
        description = what if done < total else ""
        self._bars.update(self._tasks[stage], description=description, total=total, completed=done)


def silently(quiet: bool) -> AbstractContextManager[object]:
    """Keep output of other libraries off standard output, which has the answer."""
    from contextlib import redirect_stdout

    return redirect_stdout(sys.stderr) if quiet else nullcontext()
