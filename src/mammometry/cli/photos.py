"""`photos`: photographs taken with one telephone and a printed board."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mammometry.base.shell import command_line
from mammometry.cli.common import SUBJECT_ID, Answer, Bars, Options, OutputOptions, command
from mammometry.cli.compile_cache import compiled_ahead
from mammometry.cli.mesh import named_subject
from mammometry.cli.stages import demo_answer, opened, volume_lines

if TYPE_CHECKING:
    from mammometry.api.photos import PreparedWalk
    from mammometry.simulate.walk import WalkRecipe
    from mammometry.walk.inputs import LeftOut

app = typer.Typer()
DEMO_FOLDER = Path("demo-photos")
_DEMO_SEED = 0  # the same woman as in the scan's demo
_DEMO_PICTURES, _DEMO_SCALE = 20, 0.3  # enough for both breasts, in about two minutes


@command(app, "mammometry photos anna", "mammometry photos anna --posture lying --out anna-measured")
def photos(
    options: Options,
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER", help="Photographs or one video from a telephone; board.toml if the board was measured.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="SESSION", help="Session to make.", show_default="FOLDER-session, next to it"),
    ] = None,
    posture: Annotated[
        str, typer.Option(help="How the patient held herself: standing, leaning or lying.")
    ] = "standing",
    subject: Annotated[
        str | None, typer.Option(*SUBJECT_ID, help="Pseudonym of the patient, never a name.", show_default=False)
    ] = None,
) -> Answer:  # fmt: skip
    """Measure a patient who wears a printed board, from photographs taken with one telephone.

    Take the photographs while walking around the patient; the board shows where each was taken. They are stored in a
    session, cropped to the body and without EXIF data, and measured as with `run`. Current photographs and results are
    kept.
    """
    from mammometry.measure.settings import POSTURES

    if posture not in POSTURES:
        raise typer.BadParameter(f"--posture: {posture}: one of {', '.join(POSTURES)}")
    session = _session_beside(folder) if out is None else out
    return _measured(folder, session, options, posture=posture, subject=named_subject(subject))


def photos_demo(folder: Path, options: Options) -> Answer:
    """Photograph and measure a virtual standing woman, and compare with her true volumes.

    Raises:
        MammometryError: the folder has other content, or she cannot be measured.
    """
    from mammometry.simulate.walk import BOARD, PHOTOGRAPHS, WalkRecipe, woman_of, write_walk

    options.settings()  # refuses wrong names before rendering, which takes a minute
    recipe = WalkRecipe(seed=_DEMO_SEED, pictures=_DEMO_PICTURES, scale=_DEMO_SCALE)
    begun = time.monotonic()
    try:
        present = recipe.line in (folder / PHOTOGRAPHS / BOARD).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        present = False
    with Bars(options.silent) as bars, compiled_ahead():
        if present:  # truth/ is only for "mammometry evaluate" and benchmarks
            truth = woman_of(recipe).volumes_cc
        else:
            with bars.task("simulate", "photographs") as progress:
                truth = dict(write_walk(folder, recipe, progress=progress).true_volumes_cc)
    simulated = time.monotonic() - begun
    answer = _measured(folder / PHOTOGRAPHS, folder / "session", options, posture="standing", subject=None)
    return demo_answer(answer, truth, begun=begun, simulated=simulated)


def simulated_walk(out: Path, recipe: WalkRecipe, options: OutputOptions) -> Answer:
    """Render a walk with a virtual telephone. The answer has the true volumes.

    Raises:
        MammometryError: the recipe cannot be rendered, or the folder is not new.
    """
    from mammometry.simulate.walk import PHOTOGRAPHS, write_walk

    begun = time.monotonic()
    with Bars(options.silent) as bars, bars.task("simulate", "photographs") as progress:
        made = write_walk(out, recipe, progress=progress)
    true_cc = {side: round(volume, 3) for side, volume in made.true_volumes_cc.items()}
    table = {"walk": str(out), "true_volumes_cc": true_cc, "seconds": round(time.monotonic() - begun, 3)}
    volumes = ", ".join(f"{side} {volume:.1f} cc" for side, volume in true_cc.items())
    then = command_line("mammometry", "photos", out / PHOTOGRAPHS)
    return Answer(table, [f"{out}: {len(made.cameras)} photographs, true volume {volumes}", f"Then: {then}"])


def _session_beside(folder: Path) -> Path:
    """FOLDER-session next to the folder, also for "." and ".."."""
    named = folder if folder.name not in ("", "..") else Path(os.path.abspath(folder))
    return named.parent / f"{named.name}-session"


def _measured(folder: Path, session: Path, options: Options, *, posture: str, subject: str | None) -> Answer:
    from mammometry.api.photos import prepare_walk

    with Bars(options.silent) as bars:
        with bars.task("calibrate", "board") as progress:
            walk = prepare_walk(folder, session, posture=posture, subject=subject, progress=progress)
        job = opened(session, options, bars)
        with compiled_ahead(wanted=not job.store.has(job.report_key)):
            results = job.run()
    names = walk.names(folder)
    left_out = {names[number]: why for number, why in walk.left_out.items()}
    table = results.as_table()
    table["walk"] = {
        "pictures": walk.pictures,
        "used": [names[number] for number in walk.used],
        "left_out": {name: asdict(why) for name, why in left_out.items()},
    }
    return Answer(table, [*_lines(walk, left_out), *volume_lines(results)])


def _lines(walk: PreparedWalk, left_out: Mapping[str, LeftOut]) -> list[str]:
    used = f"{len(walk.used)} of {walk.pictures} photographs are used"
    board = f"board: {walk.board_rms_px:.2f} px RMS, bow {walk.board_bow_mm:.1f} mm"
    by = "no bank card on it" if walk.card_scale is None else f"{100 * (walk.card_scale - 1):+.2f} % by the bank card"
    size = f"size of the print: {by}; all lengths ± {200 * walk.scale_std:.2f} % (95 %)"
    return [f"{used}; {board}", size, *(f"left out: {name}: {why}" for name, why in left_out.items())]
