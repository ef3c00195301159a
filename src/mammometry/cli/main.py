"""Entry point: errors become sentences and exit codes, answers text or JSON."""

from __future__ import annotations

import errno
import io
import json
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cached_property
from typing import Annotated, Any

import typer

from mammometry.base.errors import FullDiskError, MammometryError
from mammometry.cli import (
    acceptance,
    batch,
    clinic,
    clinical_study,
    doctor,
    export,
    mesh,
    photos,
    rig,
    sessions,
    simulation,
    stages,
    state,
    study,
)
from mammometry.cli.common import Answer, silently, start_logging

_DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
INTERRUPTED = 130
"""Exit code: stopped by Ctrl-C, 128 + SIGINT by the convention of shells."""
UNEXPECTED = 70
"""Exit code: a defect in mammometry, EX_SOFTWARE of sysexits.h."""
USAGE = 2
"""Exit code: wrong usage, as in click and shells."""
# The base of all usage errors; its module differs between versions of typer.
_ClickException: type[Exception] = typer.BadParameter.__mro__[2]


class Program(typer.Typer):
    """The program's commands, assembled at the first call only: this takes 50 ms."""

    @cached_property
    def _commands(self) -> Callable[..., Any]:
        return typer.main.get_command(self)

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Run a command."""
        return self._commands(*arguments, **options)


app = Program(
    name="mammometry",
    help="Measure breast volume, shape and symmetry from stereo photographs. Not a medical device.",
    epilog="Start with `mammometry demo`, then `mammometry new SESSION`. Exit codes: 0 success, 2 usage, "
    "3 session, settings or table, 4 photograph, 5 calibration, 6 matching, 7 surface, 8 measurement, 9 storage, "
    "10 a camera moved (check), 11 a session of a batch or a model of a study failed, "
    "12 a camera failed or the pictures are refused (capture), 13 a check failed (doctor), "
    "14 a device is rejected and 15 undecided (acceptance), 130 interrupted.",
    no_args_is_help=True,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
)
for group in (
    stages.app,
    photos.app,
    batch.app,
    study.dates_app,
    sessions.app,
    state.app,
    rig.app,
    simulation.app,
    doctor.app,
):
    app.registered_commands += group.registered_commands
study.app.registered_commands += clinical_study.app.registered_commands
app.add_typer(study.app, no_args_is_help=True)
app.add_typer(acceptance.app, no_args_is_help=True)
app.add_typer(clinic.app, no_args_is_help=True)
app.add_typer(export.app, no_args_is_help=True)
app.add_typer(mesh.app, no_args_is_help=True)


def _show_version(wanted: bool) -> None:
    if wanted:
        from mammometry.cli.doctor import program

        typer.echo(program())
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command line and leave with its exit code."""
    if not any(_verbosity(argument) for argument in sys.argv[1:]):
        hush_libraries()
    code = run(sys.argv[1:])
    if code == INTERRUPTED:
        # CPython remembers an interrupt that came while source text was run (as for dataclasses), although we caught
        # it, and ``python -m`` would die of the signal. Running another text makes it forget.
        exec("")
    sys.exit(code)


def hush_libraries() -> None:
    """Silence what C libraries write to standard error themselves.

    libtiff, for example, prints about damaged photographs.
    """
    with suppress(OSError, AttributeError):  # closed or missing
        ours = open(os.dup(2), "w", buffering=1, encoding=sys.stderr.encoding, errors=sys.stderr.errors)  # noqa: SIM115
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        sys.stderr = ours


def run(arguments: Sequence[str]) -> int:
    """Run one command.

    Return its exit code. An error is one sentence on standard error, or with ``--json`` one object ``{"error": …}`` on
    standard output. A traceback appears only for our own defects, and only with ``-v``.
    """
    as_json, quiet = "--json" in arguments, "--quiet" in arguments or "-q" in arguments
    verbose = sum(_verbosity(argument) for argument in arguments)
    start_logging(verbose)
    try:
        with silently(as_json):
            answer = app(list(arguments), standalone_mode=False)
        if answer == INTERRUPTED:  # typer's own word for Ctrl-C
            raise KeyboardInterrupt
        if isinstance(answer, Answer):
            _say(answer, as_json, quiet)
            return answer.exit_code
        return answer if isinstance(answer, int) else 0
    except MammometryError as error:
        about = {name: getattr(error, name) for name in ("code", "subject", "found", "expected", "remedy")}
        about |= {"details": list(error.details)} if error.details else {}
        shown = "" if error.page is None else f" Picture: {error.page}"
        about |= {"page": str(error.page)} if shown else {}
        return _fail(f"{error}{shown}", error.exit_code, as_json, kind=error.kind, **about)
    except (KeyboardInterrupt, typer.Abort):
        sentence = "Interrupted: finished results are kept. The same command continues from them."
        return _fail(sentence, INTERRUPTED, as_json, kind="Interrupted")
    except _ClickException as error:
        return _fail(_usage(error), USAGE, as_json, kind="UsageError")
    except BrokenPipeError:
        sys.stderr.close()  # the reader of our output has closed it
        return 1
    except MemoryError:
        sentence = "Out of memory. Close other programs, or use smaller photographs."
        return _fail(sentence, 1, as_json, kind="MemoryError")
    except Exception as error:
        if isinstance(error, OSError) and error.errno in _DISK_FULL:
            sentence = f"No space on the disk ({error.strerror}). Free some space and run the same command again."
            return _fail(sentence, FullDiskError.exit_code, as_json, code=FullDiskError.code, kind=FullDiskError.kind)
        if verbose:
            import traceback

            traceback.print_exc()
        sentence = f"A defect in mammometry: {type(error).__name__}: {_first_line(error)}. "
        sentence += "Please report it with the output of the same command with -v."
        return _fail(sentence, UNEXPECTED, as_json, kind="Defect")


def _verbosity(argument: str) -> int:
    if argument == "--verbose":
        return 1
    short = argument.startswith("-") and not argument.startswith("--")
    return argument.count("v") if short and set(argument[1:]) <= set("vq") else 0


def _say(answer: Answer, as_json: bool, quiet: bool) -> None:
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A folder's name need not be UTF-8. Other bytes are escaped as in JSON, so that it can be read back.
        sys.stdout.reconfigure(errors="backslashreplace")
    if as_json:
        print(json.dumps(answer.table, ensure_ascii=False), flush=True)  # noqa: T201  # the answer itself
    elif not quiet or answer.exit_code:  # the error is still reported
        from rich.console import Console

        console = Console(stderr=quiet, soft_wrap=True, highlight=False, markup=False, emoji=False)
        for line in answer.lines:
            console.print(line)


def _fail(sentence: str, exit_code: int, as_json: bool, **about: Any) -> int:
    if as_json:
        print(json.dumps({"error": sentence, "exit_code": exit_code, **about}, ensure_ascii=False), flush=True)  # noqa: T201
    else:
        print(f"mammometry: {sentence}", file=sys.stderr, flush=True)  # noqa: T201  # the answer itself
    return exit_code


def _usage(error: Any) -> str:
    context = getattr(error, "ctx", None)
    hint = f" See `{context.command_path} --help`." if context is not None else ""
    message = error.format_message().rstrip(".")
    return f"{message if message.endswith('?') else message + '.'}{hint}"


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or ["no message"])[0].rstrip(".")
