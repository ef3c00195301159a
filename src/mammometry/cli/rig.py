"""Commands on the rig: capture, skew, check for moved cameras, import and export cameras."""

from __future__ import annotations

from contextlib import suppress
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mammometry.base.shell import command_line
from mammometry.cli.common import SUBJECT_ID, Answer, Bars, Options, OutputOptions, SessionFolder, command, opener

if TYPE_CHECKING:
    from mammometry.io.drift import History


app = typer.Typer()
MOVED = 10
"""Exit code of a check that found a camera moved."""


@command(
    app,
    "mammometry check SESSION --image-set monday",
    "mammometry check SESSION --history",
    "mammometry check SESSION --image-set monday --set calibration.check.refuse_mm=0.2",
)
def check(
    options: Options,
    session: SessionFolder,
    image_set: Annotated[
        Path | None,
        typer.Option(help="Folder with a later exposure of the target, <camera>.jpg.", show_default=False),
    ] = None,
    history: Annotated[bool, typer.Option("--history", help="Only show earlier checks.")] = False,
) -> Answer:
    """Check with a new photograph whether a camera has moved.

    The photograph shows the calibration target. The exit code is 10 if a camera has moved. Photographs of the
    calibration itself, of an earlier check, or older than the calibration by their time stamps are refused.
    """
    from mammometry.base.notices.words import in_json, lines_of
    from mammometry.cli.stages import opened
    from mammometry.io import drift

    if history == (image_set is not None):
        raise typer.BadParameter("give either --image-set FOLDER or --history")
    loaded = options.settings()
    if image_set is not None:
        with Bars(options.silent) as bars:
            job = opened(session, options, bars)
            with bars.task("check", "photographs") as progress:
                result = job.check(image_set, progress=progress)
    known = drift.read_history(session)
    drawn = session / drift.FOLDER / drift.DRAWN
    if image_set is None:
        return _history(session, known, drawn, loaded.calibration.check.refuse_mm)
    # Another check may have ended in the meantime: use the last one with these photographs.
    entry = next(entry for entry in reversed(known.entries) if entry.image_set == str(image_set))
    table = drift.entry_table(entry) | {
        "unseen": list(result.unseen),
        "alternatives": [list(names) for names in result.alternatives],
        "pairs": {
            name: {
                "displacement_mm": round(pair.displacement_mm, 4),
                "shape_mm": round(pair.shape_mm, 4),
                "scale_ppm": round(pair.scale_ppm, 1),
            }
            for name, pair in result.pairs.items()
        },
        "history": str(session / drift.FOLDER / drift.HISTORY),
        "plot": str(drawn),
        **in_json(known.notices),
    }
    words = {
        "unmoved": "No camera has moved since the calibration.",
        "moved": "The rig moved, but too little to matter.",
        "refuse": "The rig moved. Calibrate it again before measuring.",
    }
    lines: list[Any] = [words[result.verdict], *(f"- {reason}" for reason in result.reasons), f"History: {drawn}"]
    lines += lines_of(known.notices)
    return Answer(table, lines, exit_code=0 if result.verdict == "unmoved" else MOVED)


def _history(session: Path, history: History, drawn: Path, limit_mm: float) -> Answer:
    from rich.table import Table

    from mammometry.base.notices.words import in_json, lines_of
    from mammometry.io import drift
    from mammometry.io.outputs import write_output
    from mammometry.report.figures.calibration import drift as draw

    warnings = lines_of(history.notices)
    if not history.entries:
        table: dict[str, Any] = {"session": str(session), "checks": [], **in_json(history.notices)}
        return Answer(table, [*warnings, "This rig has not been checked yet."])
    write_output(drawn, draw(history.entries, limit_mm), command="check")
    shown = Table("when", "image set", "verdict", "error, mm", "moved cameras", box=None, pad_edge=False)
    for entry in history.entries:
        moved = ", ".join(name for name, camera in entry.cameras.items() if camera.moved)
        shown.add_row(entry.when[:16], Path(entry.image_set).name, entry.verdict, f"{entry.effect_mm:.3f}", moved)
    table = {
        "session": str(session),
        "checks": [drift.entry_table(entry) for entry in history.entries],
        **in_json(history.notices),
        "plot": str(drawn),
    }
    return Answer(table, [*warnings, shown, f"Plot: {drawn}"])


@command(
    app,
    "mammometry import-cameras SESSION front_left.yml front_right.yml",
    "mammometry import-cameras SESSION cameras.txt images.txt",
    name="import-cameras",
)
def import_cameras(
    options: OutputOptions,
    session: SessionFolder,
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...",
            help="Files of OpenCV (YAML, XML), COLMAP (cameras.txt, images.txt), Kalibr (YAML), Agisoft (XML), "
            "MATLAB (.mat), HALCON (.cal, .dat), or a cameras.json.",
            show_default=False,
        ),
    ],
) -> Answer:
    """Import cameras calibrated with another program.

    Writes SESSION/cameras.json. The session is then not calibrated.
    """
    import json as json_module

    from mammometry.base.errors import SessionError
    from mammometry.base.notices.words import in_json, lines_of
    from mammometry.io.cameras import formats
    from mammometry.io.cameras.formats import require_rig
    from mammometry.io.cameras.own import cameras_table
    from mammometry.io.meshes.measured import session_with_photographs
    from mammometry.io.outputs import require_apart, require_free, write_output

    opened = session_with_photographs(session)
    path = session / "cameras.json"
    require_apart(path, files)
    require_free(session, [path.name], command="import-cameras")
    cameras = formats.import_cameras(files, opened.pair_names)
    missing = [name for name in opened.cameras if name not in cameras]
    if missing:
        raise SessionError(
            ", ".join(file.name for file in files),
            found=f"cameras {', '.join(cameras) or 'without names'}",
            expected=f"also {', '.join(missing)}",
            remedy="Import every camera of the rig, named as in session.toml (a file of one camera is named after it)",
        )
    names = ", ".join(file.name for file in files)
    upside_down = [name for name, mounting in opened.manifest.rig.turned.items() if mounting == "upside-down"]
    notices = require_rig(names, cameras, opened.pair_names, opened.manifest.subject.kind, upside_down)
    content = json_module.dumps(cameras_table(cameras), indent=1) + "\n"
    write_output(path, content.encode(), command="import-cameras")
    return Answer(
        {"cameras": list(cameras), "file": str(path), **in_json(notices)},
        [f"{path}: {', '.join(cameras)}", *lines_of(notices), "Remove this file to calibrate from photographs again."],
    )


class CameraFormatName(StrEnum):
    """Programs for which cameras can be written."""

    opencv = "opencv"
    colmap = "colmap"
    kalibr = "kalibr"
    json = "json"


@command(
    app,
    "mammometry export-cameras SESSION OUT",
    "mammometry export-cameras SESSION OUT --format colmap",
    name="export-cameras",
)
def export_cameras(
    options: Options,
    session: SessionFolder,
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder for the files.", show_default=False)],
    form: Annotated[
        CameraFormatName, typer.Option("--format", help="Format of this program.")
    ] = CameraFormatName.opencv,
) -> Answer:
    """Write the cameras for OpenCV, COLMAP or Kalibr. Calibrates first if needed."""
    from mammometry.cli.stages import opened
    from mammometry.io.cameras.formats import camera_file_names, camera_texts
    from mammometry.io.outputs import require_apart, require_free, write_outputs

    command = f"export-cameras --format {form.value}"
    with Bars(options.silent) as bars:
        job = opened(session, options, bars)
        require_apart(out, [*job.session.brought, options.file])
        require_free(out, camera_file_names(job.session.cameras, form.value), command=command)
        cameras = job.calibrate()
    texts = camera_texts(cameras.rig.cameras, form.value)
    write_outputs(out, {name: text.encode() for name, text in texts.items()}, command=command)
    files = [str(out / name) for name in texts]
    frame = "relative to the first camera, metres" if form is CameraFormatName.kalibr else cameras.world
    return Answer({"files": files, "format": form.value, "world": frame}, [*files, f"World: {frame}"])


RigToml = Annotated[
    Path, typer.Option("--rig", metavar="RIG.toml", help="The rig's cameras and calibration.", show_default=False)
]
BackendName = Annotated[
    str | None,
    typer.Option("--backend", help="Kind of cameras, instead of the file's: virtual, folder, aravis, pylon, gphoto2."),
]
REFUSED = 12
"""Exit code: the captured pictures must not be measured."""


@command(
    app,
    "mammometry capture SESSION --rig rig.toml",
    "mammometry capture SESSION --rig rig.toml --page",
    "mammometry capture CALIBRATION-SESSION --rig rig.toml --pose",
    "mammometry capture CALIBRATION-SESSION --rig rig.toml --pose --page",
    "mammometry capture SESSION --rig rig.toml --backend virtual && mammometry run SESSION",
)
def capture(
    options: OutputOptions,
    session: SessionFolder,
    rig: RigToml,
    backend: BackendName = None,
    subject_id: Annotated[
        str | None, typer.Option(*SUBJECT_ID, help="Pseudonym of the patient, never a name.", show_default=False)
    ] = None,
    pose: Annotated[
        bool, typer.Option("--pose", help="Photograph the calibration board, and suggest where to hold it next.")
    ] = False,
    page: Annotated[
        bool, typer.Option("--page", help="Aim, focus and fire on a page in the browser. Ctrl-C ends it.")
    ] = False,
    browser: Annotated[bool, typer.Option(help="With --page: open it in the browser.")] = True,
) -> Answer:
    """Fire all cameras, and check the pictures at once.

    If they can be measured, they become SESSION/capture. All firings are kept in SESSION/shots. With --pose no
    calibration is needed: these are its photographs. The exit code is 12 if a camera failed, the pictures are refused,
    or no camera saw the board.
    """
    from mammometry.capture.loop import OpenRig

    if page:
        return _on_a_page(session, rig, backend, subject_id, browser=browser, posing=pose)
    if pose:
        return _pose(session, rig, backend, options.silent)
    with Bars(options.silent) as bars, bars.task("open", "cameras"), OpenRig(rig, backend=backend) as rigged:
        faults = rigged.faults()
        fired = rigged.fire_into(session, subject_id=subject_id)
    table: dict[str, Any] = {
        "session": str(session),
        "shot": str(fired.shot),
        "accepted": fired.accepted,
        "written_s": round(fired.written_s, 3),
        "faults": faults,
        **fired.verdict.as_table(),
    }
    lines: list[Any] = [f"- {sentence}" for sentence in fired.verdict.sentences]
    if fired.accepted:
        lines = ["The pictures may be measured.", *lines, f"Next: {command_line('mammometry', 'run', session)}"]
    else:
        lines = ["Do not measure these pictures.", *lines, f"The pictures are kept in {fired.shot}."]
    return Answer(table, lines, exit_code=0 if fired.accepted else REFUSED)


def _pose(session: Path, rig: Path, backend: str | None, silent: bool) -> Answer:
    from mammometry.capture.loop import OpenRig

    with (
        Bars(silent) as bars,
        bars.task("open", "cameras"),
        OpenRig(rig, backend=backend, needs_calibration=False) as rigged,
    ):
        posed = rigged.fire_pose(session)
    lines: list[Any] = [f"Pose {posed.pose} is stored, {posed.count} in all."]
    table: dict[str, Any] = {"session": str(session), "pose": posed.pose, "poses": posed.count, "next": posed.sentence}
    if posed.progress is None:
        lines.append(f"Not calibrated yet: {posed.why}")
    else:
        lines.append(posed.progress.sentence)
        table |= {"error_mm": posed.progress.error_mm, "good_enough": posed.progress.good_enough}
    if posed.suggestion is not None:
        suggestion = posed.suggestion
        table["expected_mm"] = suggestion.then_mm
        table["outlines_px"] = {name: outline.round(1).tolist() for name, outline in suggestion.outlines_px.items()}
    lines.append(f"Next: {posed.sentence}")
    return Answer(table, lines)


def _on_a_page(
    session: Path, rig: Path, backend: str | None, subject_id: str | None, *, browser: bool, posing: bool
) -> Answer:
    from mammometry.base.extras import WEB, require

    require("edit", *WEB)
    from mammometry.capture.loop import OpenRig
    from mammometry.capture.page import Goal, serve

    with (
        OpenRig(rig, backend=backend, needs_calibration=not posing) as rigged,
        suppress(KeyboardInterrupt),
    ):  # stops the page
        serve(rigged, Goal(session=session, subject_id=subject_id, posing=posing), ready=opener(browser))
    made = session / ("calibration" if posing else "capture")
    taken = made.is_dir() and any(made.iterdir())
    lines: list[Any] = (
        [f"Next: {command_line('mammometry', 'run', session)}"]
        if taken
        else ["Nothing was captured that may be measured."]
    )
    return Answer({"session": str(session), "accepted": taken}, lines, exit_code=0 if taken else REFUSED)


@command(app, "mammometry skew CALIBRATION-SESSION --rig rig.toml")
def skew(
    options: OutputOptions,
    session: SessionFolder,
    rig: RigToml,
    backend: BackendName = None,
    firings: Annotated[int, typer.Option(min=1, max=100, help="Number of firings; their median is used.")] = 5,
) -> Answer:
    """Measure the time between the cameras' exposures, with the counting lamps.

    Writes SESSION/skew.json, which captures with this calibration use. The exit code is 12 above the rig's limit.
    """
    from mammometry.capture.loop import OpenRig

    with (
        Bars(options.silent) as bars,
        bars.task("open", "cameras"),
        OpenRig(rig, backend=backend, needs_calibration=False) as rigged,
    ):
        measured = rigged.measure_skew(session, firings=firings)
        limit_ms = rigged.file.capture.skew_limit_ms
    good = measured.spread_ms <= limit_ms
    lines: list[Any] = [
        f"The cameras expose within {measured.spread_ms:.2f} ± {measured.std_ms:.2f} ms; {limit_ms:g} ms are allowed.",
        *(f"- {name}: {offset:+.2f} ms" for name, offset in measured.offset_ms.items()),
    ]
    if not good:
        lines.append(f"Check the trigger wire of {measured.worst}. Patients must not be measured with this rig.")
    return Answer({**measured.as_table(), "limit_ms": limit_ms, "good": good}, lines, exit_code=0 if good else REFUSED)
