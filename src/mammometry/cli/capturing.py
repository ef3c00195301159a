"""Commands that drive the rig's cameras: capture, skew."""

from __future__ import annotations

import sys
import webbrowser
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer

from mammometry.cli.common import Answer, Bars, OutputOptions, SessionFolder, command

app = typer.Typer()
RigToml = Annotated[
    Path, typer.Option("--rig", metavar="RIG.toml", help="The rig's cameras and calibration.", show_default=False)
]
BackendName = Annotated[
    str | None,
    typer.Option("--backend", help="Kind of cameras, instead of the file's: virtual, folder, aravis, pylon, gphoto2."),
]
REFUSED = 12
"""Exit code of a firing that must not be measured."""


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
        str | None, typer.Option("--id", help="Pseudonym of the patient, never a name.", show_default=False)
    ] = None,
    pose: Annotated[
        bool, typer.Option("--pose", help="Fire at the calibration board, and say where to hold it next.")
    ] = False,
    page: Annotated[
        bool, typer.Option("--page", help="Aim, focus and fire on a page in the browser. Ctrl-C ends it.")
    ] = False,
    browser: Annotated[bool, typer.Option(help="With --page: open it in the browser.")] = True,
) -> Answer:
    """Fire all cameras, and judge the pictures at once.

    The pictures become SESSION/capture if nothing speaks against it. All firings are kept in SESSION/shots. The exit
    code is 12 if a camera failed or the pictures are refused.
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
        lines = ["The pictures may be measured.", *lines, f"Next: mammometry run {session}"]
    else:
        lines = ["Do not measure these pictures.", *lines, f"What came is kept in {fired.shot}."]
    return Answer(table, lines, exit_code=0 if fired.accepted else REFUSED)


def _pose(session: Path, rig: Path, backend: str | None, silent: bool) -> Answer:
    from mammometry.capture.loop import OpenRig

    with Bars(silent) as bars, bars.task("open", "cameras"), OpenRig(rig, backend=backend) as rigged:
        posed = rigged.fire_pose(session)
    lines: list[Any] = [f"Pose {posed.pose} is taken, {posed.count} in all."]
    table: dict[str, Any] = {"session": str(session), "pose": posed.pose, "poses": posed.count, "next": posed.sentence}
    if posed.progress is None:
        lines.append(f"Not calibrated yet: {posed.why}")
    else:
        lines.append(posed.progress.sentence)
        table |= {"error_mm": posed.progress.error_mm, "good_enough": posed.progress.good_enough}
    if posed.suggestion is not None:
        found = posed.suggestion
        table["expected_mm"] = found.then_mm
        table["outlines_px"] = {name: outline.round(1).tolist() for name, outline in found.outlines_px.items()}
    lines.append(f"Next: {posed.sentence}")
    return Answer(table, lines)


def _on_a_page(
    session: Path, rig: Path, backend: str | None, subject_id: str | None, *, browser: bool, posing: bool
) -> Answer:
    from mammometry.base.extras import WEB, require

    require("edit", *WEB)
    from mammometry.capture.loop import OpenRig
    from mammometry.capture.page import Goal, serve

    def ready(address: str, local_page: str) -> None:
        # Standard output belongs to the answer, which comes after the page was closed.
        print(f"{address} (works once; Ctrl-C stops)", file=sys.stderr, flush=True)  # noqa: T201
        if browser:
            webbrowser.open(local_page)

    with OpenRig(rig, backend=backend) as rigged, suppress(KeyboardInterrupt):  # the way to stop it
        serve(rigged, Goal(session=session, subject_id=subject_id, posing=posing), ready=ready)
    made = session / ("calibration" if posing else "capture")
    taken = made.is_dir() and any(made.iterdir())
    lines: list[Any] = [f"Next: mammometry run {session}"] if taken else ["Nothing was captured that may be measured."]
    return Answer({"session": str(session), "accepted": taken}, lines, exit_code=0 if taken else REFUSED)


@command(app, "mammometry skew CALIBRATION-SESSION --rig rig.toml")
def skew(
    options: OutputOptions,
    session: SessionFolder,
    rig: RigToml,
    backend: BackendName = None,
    firings: Annotated[int, typer.Option(min=1, max=100, help="Firings of which the median counts.")] = 5,
) -> Answer:
    """Measure how far apart the cameras expose, with the counting lamps.

    Writes SESSION/skew.json. Captures with this calibration then know it. The exit code is 12 above the rig's limit.
    """
    from mammometry.capture.loop import OpenRig

    with Bars(options.silent) as bars, bars.task("open", "cameras"), OpenRig(rig, backend=backend) as rigged:
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
