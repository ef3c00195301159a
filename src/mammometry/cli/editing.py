"""The command `edit`: draw boundaries and landmarks in the browser."""

from __future__ import annotations

import sys
import webbrowser
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated

import typer

from mammometry.cli.common import Answer, Bars, Options, SessionFolder, command
from mammometry.cli.stages import opened

if TYPE_CHECKING:
    from mammometry.editor.session import Drawable

app = typer.Typer()


@command(app, "mammometry edit SESSION", "mammometry edit SESSION --no-browser --author 'A. Nurse'")
def edit(
    options: Options,
    session: SessionFolder,
    browser: Annotated[bool, typer.Option(help="Open the page in the browser.")] = True,
    author: Annotated[str | None, typer.Option(help="Your name. Without it, the page asks.")] = None,
) -> Answer:
    """Draw or confirm boundaries and landmarks of a session or an imported scan in the browser.

    Ctrl-C stops it.
    """
    from mammometry.base.extras import WEB, require

    require("edit", *WEB)
    from mammometry.editor.server import serve
    from mammometry.io.drawn import BOUNDARIES, LANDMARK_FILE
    from mammometry.io.meshes.scans import MESH, is_scan

    def ready(address: str, local_page: str) -> None:
        # Standard output belongs to the answer, which comes after the page was closed.
        print(f"{address} (works once; Ctrl-C stops)", file=sys.stderr, flush=True)  # noqa: T201
        if browser:
            webbrowser.open(local_page)

    def drawable() -> Drawable:
        from mammometry.api.job import open_session
        from mammometry.api.mesh import folder_for, scan_job

        chosen = options.settings()
        return scan_job(session, folder_for(session / MESH), chosen) if scan else open_session(session, chosen)

    scan = is_scan(session)
    if not scan:
        with Bars(options.silent) as bars:
            opened(session, options, bars).ensure("surface")
    with suppress(KeyboardInterrupt):  # the way to stop it
        serve(drawable, ready=ready, author=author)
    present = [name for name in (BOUNDARIES, LANDMARK_FILE) if (session / name).is_file()]
    then = f"mammometry measure {session / MESH}" if scan else f"mammometry run {session}"
    return Answer({"session": str(session), "drawn": present}, [f"Then: {then}"] if present else [])
