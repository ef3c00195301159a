"""`photos`: photographs by one telephone and a printed board."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mammometry.base.errors import SettingsError
from mammometry.base.shell import command_line
from mammometry.cli.common import SUBJECT_ID, Answer, Bars, Options, OutputOptions, command
from mammometry.cli.compile_cache import compiled_ahead
from mammometry.cli.mesh import named_subject
from mammometry.cli.stages import opened, volume_lines

if TYPE_CHECKING:
    from mammometry.api.photos import PreparedWalk

app = typer.Typer()
DEMO_FOLDER = Path("demo-photos")
_DEMO_SEED = 0  # the woman of the scan's demo
_DEMO_PICTURES, _DEMO_SCALE = 20, 0.3  # enough for both breasts, in about two minutes


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
    from mammometry.measure.settings import POSTURES

    if posture not in POSTURES:
        raise typer.BadParameter(f"--posture: {posture}: one of {', '.join(POSTURES)}")
    session = folder.with_name(f"{folder.resolve().name}-session") if out is None else out
    return _measured(folder, session, options, posture=posture, subject=named_subject(subject))


def photos_demo(folder: Path, options: Options) -> Answer:
    """Photograph and measure a virtual standing woman, and compare with her volumes.

    Raises:
        MammometryError: the folder holds something else, or she cannot be measured.
    """
    from mammometry.simulate.walk import BOARD, PHOTOGRAPHS, WalkRecipe, woman_of, write_walk

    options.settings()  # a wrong name shows at once, not after a minute
    recipe = WalkRecipe(seed=_DEMO_SEED, pictures=_DEMO_PICTURES, scale=_DEMO_SCALE)
    begun = time.monotonic()
    try:
        present = recipe.line in (folder / PHOTOGRAPHS / BOARD).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        present = False
    with Bars(options.silent) as bars, compiled_ahead():
        if present:  # truth/ is for "mammometry evaluate" and benchmarks alone
            truth = woman_of(recipe).volumes_cc
        else:
            with bars.task("simulate", "photographs") as progress:
                truth = dict(write_walk(folder, recipe, progress=progress).true_volumes_cc)
    simulated = time.monotonic() - begun
    answer = _measured(folder / PHOTOGRAPHS, folder / "session", options, posture="standing", subject=None)
    table = dict(answer.table)
    table["seconds"] = round(time.monotonic() - begun, 3)
    table["stage_seconds"] = {"simulate": round(simulated, 3), **table["stage_seconds"]}
    table |= {"true_volumes_cc": {side: round(volume, 3) for side, volume in truth.items()}}
    return Answer(table, [*compared(table["volumes_cc"], truth), *answer.lines])


def simulated_walk(
    out: Path,
    options: OutputOptions,
    *,
    subject: str | None,
    seed: int,
    scale: float | None,
    skin: str | None,
    contrast: float | None,
    noise: float,
    disturb: str,
) -> Answer:
    """Render a walk. None: the recipe's own.

    Raises:
        MammometryError: an argument is unknown, or the folder is not new.
    """
    from mammometry.simulate.recipe import parse_situation
    from mammometry.simulate.rendering.skin import make_skin
    from mammometry.simulate.studio import refusing
    from mammometry.simulate.walk import PHOTOGRAPHS, WalkRecipe, write_walk

    begun = time.monotonic()
    plain = WalkRecipe()
    expected, remedy = "options that can be rendered", "Correct the option; --help names the choices"
    with refusing(SettingsError, expected=expected, remedy=remedy):
        recipe = WalkRecipe(
            subject=subject or plain.subject,
            seed=seed,
            scale=scale or plain.scale,
            skin=make_skin(skin or "skin", contrast=contrast),
            film=plain.film.with_noise(noise),
            situation=parse_situation(disturb),
        )
    with Bars(options.silent) as bars, bars.task("simulate", "photographs") as progress:
        made = write_walk(out, recipe, progress=progress)
    true_cc = {side: round(volume, 3) for side, volume in made.true_volumes_cc.items()}
    table = {"walk": str(out), "true_volumes_cc": true_cc, "seconds": round(time.monotonic() - begun, 3)}
    volumes = ", ".join(f"{side} {volume:.1f} cc" for side, volume in true_cc.items())
    then = command_line("mammometry", "photos", out / PHOTOGRAPHS)
    return Answer(table, [f"{out}: {len(made.cameras)} photographs, true volume {volumes}", f"Then: {then}"])


def compared(volumes_cc: Mapping[str, float], truth_cc: Mapping[str, float]) -> list[str]:
    """A line for each breast of a virtual woman: what was measured, and the truth."""
    lines = []
    for side, true_cc in truth_cc.items():
        measured_cc = volumes_cc.get(side)
        result = "not measured" if measured_cc is None else f"measured {measured_cc:.0f} cc"
        off = "" if measured_cc is None else f" ({100 * (measured_cc / true_cc - 1):+.0f} %)"
        lines.append(f"{side}: {result}, true {true_cc:.0f} cc{off}")
    return lines


def _measured(folder: Path, session: Path, options: Options, *, posture: str, subject: str | None) -> Answer:
    from mammometry.api.photos import prepare_walk, walk_files

    with Bars(options.silent) as bars:
        with bars.task("calibrate", "board") as progress:
            walk = prepare_walk(folder, session, posture=posture, subject=subject, progress=progress)
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
