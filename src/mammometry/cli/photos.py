"""`photos`: photographs by one telephone and a printed board."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mammometry.cli.common import SUBJECT_ID, Answer, Bars, Options, command
from mammometry.cli.compile_cache import compiled_ahead
from mammometry.cli.mesh import named_subject
from mammometry.cli.stages import opened, volume_lines

if TYPE_CHECKING:
    from mammometry.api.photos import PreparedWalk

app = typer.Typer()


@command(app, "mammometry photos anna", "mammometry photos anna --posture lying --out anna-measured")
def photos(
    options: Options,
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER", help="Photographs by one telephone, and board.toml with the measured board.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="SESSION", help="Session to make.", show_default="FOLDER-session, beside it"),
    ] = None,
    posture: Annotated[
        str, typer.Option(help="How the patient held herself: standing, leaning or lying.")
    ] = "standing",
    subject: Annotated[
        str | None, typer.Option(*SUBJECT_ID, help="Pseudonym of the patient, never a name.", show_default=False)
    ] = None,
) -> Answer:  # fmt: skip
    """Measure a patient who wears a printed board, from photographs by one telephone.

    The photographs are taken on a walk around the patient. The board gives the position of each. They are stored in a
    session, cropped to the body and without EXIF data, and measured as with `run`. Photographs and results that are
    current are kept.
    """
    from mammometry.api.photos import prepare_walk, walk_files
    from mammometry.measure.settings import POSTURES

    if posture not in POSTURES:
        raise typer.BadParameter(f"--posture: {posture}: one of {', '.join(POSTURES)}")
    session = folder.with_name(f"{folder.resolve().name}-session") if out is None else out
    with Bars(options.silent) as bars:
        with bars.task("calibrate", "board") as progress:
            walk = prepare_walk(folder, session, posture=posture, subject=named_subject(subject), progress=progress)
        job = opened(session, options, bars)
        with compiled_ahead(wanted=not job.store.has(job.report_key)):
            results = job.run()
    names = {number: path.name for number, path in walk_files(folder).items()}
    left_out = {names[number]: why for number, why in walk.left_out.items()}
    table = results.as_table()
    table["walk"] = {"pictures": walk.pictures, "used": [names[number] for number in walk.used], "left_out": left_out}
    return Answer(table, [*_lines(walk, left_out), *volume_lines(results)])


def _lines(walk: PreparedWalk, left_out: Mapping[str, str]) -> list[str]:
    used = f"{len(walk.used)} of {walk.pictures} photographs are used"
    board = f"board: {walk.board_rms_px:.2f} px RMS, bow {walk.board_bow_mm:.1f} mm"
    return [f"{used}; {board}", *(f"left out: {name}: {why}" for name, why in left_out.items())]
