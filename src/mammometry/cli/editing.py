"""The command `edit`: draw boundaries and landmarks in the browser."""

from __future__ import annotations

import sys
import webbrowser
from contextlib import suppress
from typing import Annotated

import typer

from mammometry.cli.common import (
    Answer,
    Assignments,
    Bars,
    Json,
    Quiet,
    SessionFolder,
    SettingsFile,
    Verbose,
    examples,
)
from mammometry.cli.stages import opened

app = typer.Typer()


@app.command(epilog=examples("mammometry edit SESSION", "mammometry edit SESSION --no-browser --author 'A. Nurse'"))
def edit(
    session: SessionFolder,
    browser: Annotated[bool, typer.Option(help="Open the page in the browser.")] = True,
    author: Annotated[str | None, typer.Option(help="Your name. Without it, the page asks.")] = None,
    assignments: Assignments = None,
    settings: SettingsFile = None,
    quiet: Quiet = False,
    json: Json = False,
    verbose: Verbose = 0,
) -> Answer:
    """Draw or confirm boundaries and landmarks in the browser.

    Ctrl-C stops it.
    """
    from mammometry.editor.server import serve
    from mammometry.io.drawn import BOUNDARIES, LANDMARK_FILE

    def ready(address: str, local_page: str) -> None:
        # Standard output belongs to the answer, which comes after the page was closed.
        print(f"{address} (works once; Ctrl-C stops)", file=sys.stderr, flush=True)  # noqa: T201
        if browser:
            webbrowser.open(local_page)

    with Bars(quiet or json) as bars:
        job = opened(session, settings, assignments, bars)
        job.ensure("surface")
    with suppress(KeyboardInterrupt):  # the way to stop it
        serve(job, ready=ready, author=author)
    there = [name for name in (BOUNDARIES, LANDMARK_FILE) if (session / name).is_file()]
    return Answer({"session": str(session), "drawn": there}, [f"Then: mammometry run {session}"] if there else [])
