"""Commands on the session folder itself: new, settings, edit."""

from __future__ import annotations

from contextlib import suppress
from enum import StrEnum
from typing import Annotated, Any

import typer

from mammometry.base.shell import command_line
from mammometry.cli.common import Answer, Bars, Options, OutputOptions, SessionFolder, SessionOrScan, command, opener
from mammometry.cli.stages import expect

app = typer.Typer()


class RigName(StrEnum):
    """Rigs for a new manifest."""

    reference = "reference"
    single = "single"


class TargetKind(StrEnum):
    """Targets for a new manifest."""

    charuco = "charuco"
    chessboard = "chessboard"
    circles = "circles"
    dotted_cylinder = "dotted-cylinder"
    points = "points"


class SubjectKind(StrEnum):
    """Subjects for a new manifest."""

    model = "model"
    torso = "torso"
    surface = "surface"


@command(app, "mammometry new SESSION", "mammometry new SESSION --rig single --target chessboard")
def new(
    options: OutputOptions,
    session: SessionFolder,
    rig: Annotated[RigName, typer.Option(help="reference has four pairs, single has one.")] = RigName.reference,
    target: Annotated[TargetKind, typer.Option(help="The calibration target.")] = TargetKind.charuco,
    subject: Annotated[SubjectKind, typer.Option(help="What is photographed.")] = SubjectKind.model,
) -> Answer:
    """Make an empty session: folders and a commented manifest."""
    from mammometry.base.errors import SessionError, StorageError
    from mammometry.io.manifest import MANIFEST, manifest_template
    from mammometry.io.write import write_text

    if session.exists() and (not session.is_dir() or any(session.iterdir())):
        raise SessionError(
            str(session),
            found="a folder with files in it" if session.is_dir() else "a file",
            expected="a new or empty folder",
            remedy="Choose another name",
        )
    folders = ["calibration/01", "calibration/02", "calibration/03", "capture"]
    try:
        for folder in folders:
            (session / folder).mkdir(parents=True)
        text = manifest_template(rig=rig.value, target=target.value, subject=subject.value)
        write_text(session / MANIFEST, text)
    except OSError as error:
        remedy = "Choose another place"
        expected = "permission and room to write"
        raise StorageError(
            str(session), found=f"a folder that cannot be made ({error.strerror})", expected=expected, remedy=remedy
        ) from None
    lines: list[Any] = [
        f"{session / MANIFEST}: describe your rig and target here",
        f"{session / 'calibration'}: one folder per pose, with <camera>.jpg in it",
        f"{session / 'capture'}: photographs of the subject, <camera>.jpg",
        f"Then: {command_line('mammometry', 'run', session)}",
    ]
    return Answer({"session": str(session), "manifest": str(session / MANIFEST), "folders": folders}, lines)


@command(
    app,
    "mammometry settings",
    "mammometry settings --set matching.window_px=11 > my.toml",
    "mammometry settings --paper > paper.toml",
)
def settings(
    options: Options,
    paper: Annotated[bool, typer.Option("--paper", help="Only the settings of the paper's method.")] = False,
) -> Answer:
    """List all settings with their values, as TOML for --settings."""
    from mammometry.settings import Settings, as_table, paper_method

    if paper:
        if options.file or options.assignments:
            raise typer.BadParameter("--paper prints only the paper's settings; leave out --settings and --set")
        text = paper_method()
        return Answer({"settings": as_table(Settings.from_toml(text))}, [text])
    loaded = options.settings()
    return Answer({"settings": as_table(loaded)}, [loaded.to_toml()])


@command(app, "mammometry edit SESSION", "mammometry edit SESSION --no-browser --author 'A. Nurse'")
def edit(
    options: Options,
    session: SessionOrScan,
    browser: Annotated[bool, typer.Option(help="Open the page in the browser.")] = True,
    author: Annotated[str | None, typer.Option(help="Your name. Without it, the page asks.")] = None,
) -> Answer:
    """Draw or confirm boundaries and landmarks of a session or a scan in the browser.

    Ctrl-C stops it.
    """
    from mammometry.base.extras import WEB, require

    require("edit", *WEB)
    from mammometry.api.job import drawable
    from mammometry.editor.server import serve
    from mammometry.io.drawn import BOUNDARIES, LANDMARK_FILE

    chosen = options.settings()
    with Bars(options.silent) as bars:
        job = drawable(session, chosen, watch=bars.watch)
        expect(job, bars)
        job.surface()
    with suppress(KeyboardInterrupt):  # the way to stop it
        serve(lambda: drawable(session, chosen), ready=opener(browser), author=author)
    present = [name for name in (BOUNDARIES, LANDMARK_FILE) if (session / name).is_file()]
    then = command_line("mammometry", "run", session, *options.words)
    return Answer({"session": str(session), "drawn": present}, [f"Then: {then}"] if present else [])
