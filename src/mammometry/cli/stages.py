"""The command `run` and its stages: calibrate, match, surface, measure, report."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mammometry.base.posture import POSTURES
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
    load_settings,
    nothing_made,
)
from mammometry.cli.compile_cache import compiled_ahead

if TYPE_CHECKING:
    from mammometry.api.job import Job
    from mammometry.api.results import Results
    from mammometry.job.products import Stage

app = typer.Typer()
_SET = "mammometry {} SESSION --set {}"
_MESHES = (".ply", ".obj", ".stl", ".glb")


def _mesh_option(*names: str, help: str, show_default: bool | str = False) -> Any:
    """Option of `measure` that is for meshes only."""
    return typer.Option(*names, help=help, show_default=show_default, rich_help_panel="For a scanner's mesh")


def opened(session: Path, settings: Path | None, assignments: list[str] | None, bars: Bars) -> Job:
    """Open the session's job and set the total of the bars."""
    from mammometry.api.job import open_session
    from mammometry.job.products import STAGES

    job = open_session(session, load_settings(settings, assignments), watch=bars.watch)
    for stage in STAGES:
        states = job.store.states(job.keys(stage))
        bars.expect(stage, sum(state != "current" for state in states))
    return job


def _stage(
    stage: Stage, session: Path, assignments: list[str] | None, settings: Path | None, quiet: bool
) -> tuple[Job, dict[str, Any]]:
    begun = time.monotonic()
    with Bars(quiet) as bars:
        job = opened(session, settings, assignments, bars)
        job.ensure(stage)
    return job, _summary(job, stage, begun)


def _summary(job: Job, stage: Stage, begun: float) -> dict[str, Any]:
    """What a stage made and took since `begun`, by `time.monotonic`."""
    from mammometry.base.machine.memory import peak_memory_mb

    return {
        "made": job.store.made,
        "made_at": job.made_at(stage),
        "seconds": round(time.monotonic() - begun, 3),
        "stage_seconds": {name: round(value, 3) for name, value in job.stage_seconds.items()},
        "peak_memory_mb": peak_memory_mb(),
        "results": str(job.session.results),
    }


def _made(table: dict[str, Any]) -> str:
    made = len(table["made"])
    return f"{made} results made in {table['seconds']:.1f} s" if made else nothing_made(table["made_at"])


@app.command(
    epilog=examples("mammometry run SESSION", "mammometry run SESSION --json", _SET.format("run", "measure.wall=plane"))
)
def run(
    session: SessionFolder,
    assignments: Assignments = None,
    settings: SettingsFile = None,
    quiet: Quiet = False,
    json: Json = False,
    verbose: Verbose = 0,
) -> Answer:
    """Do the whole job: calibrate, match, build the surface, measure, report.

    Results that are current are kept. Only what changed is computed again.
    """
    with Bars(quiet or json) as bars:
        job = opened(session, settings, assignments, bars)
        with compiled_ahead(wanted=not job.store.has(job.report_key)):
            results = job.run()
    return Answer(results.as_table(), volume_lines(results))


@app.command(
    epilog=examples("mammometry calibrate SESSION", _SET.format("calibrate", "calibration.bundle.model=paper"))
)
def calibrate(
    session: SessionFolder,
    assignments: Assignments = None,
    settings: SettingsFile = None,
    quiet: Quiet = False,
    json: Json = False,
    verbose: Verbose = 0,
) -> Answer:
    """Calibrate the cameras from photographs of the target. Writes results/calibrate/cameras.json."""
    job, table = _stage("calibrate", session, assignments, settings, quiet or json)
    cameras = job.plan.calibrated.cameras()
    table |= {"rms_px": cameras.rms_px, "world": cameras.world, "cameras": len(cameras.rig.cameras)}
    table |= {"verdict": cameras.verdict, "reasons": list(cameras.reasons)}
    rms = "ready-made" if cameras.rms_px is None else f"verdict: {cameras.verdict}"
    said = [f"- {reason}" for reason in cameras.reasons]
    return Answer(table, [f"{len(cameras.rig.cameras)} cameras, {rms}. World: {cameras.world}", *said, _made(table)])


@app.command(epilog=examples("mammometry match SESSION", _SET.format("match", "matching.window_px=11")))
def match(
    session: SessionFolder,
    assignments: Assignments = None,
    settings: SettingsFile = None,
    quiet: Quiet = False,
    json: Json = False,
    verbose: Verbose = 0,
) -> Answer:
    """Find the subject in the photographs and match every pair.

    Writes the disparities to results/match, as TIFF files of float32.
    """
    job, table = _stage("match", session, assignments, settings, quiet or json)
    from mammometry.matching.quality import assess, concerns

    table |= {"matched_pixels": {}, "weak_percent": {}, "d_v_px": {}, "warnings": []}
    lines = []
    for pair, product in job.plan.matched.disparities.items():
        quality = assess(product())
        product.release()
        table["matched_pixels"][pair] = quality.matched_pixels
        table["weak_percent"][pair] = round(quality.weak_percent, 2)
        table["d_v_px"][pair] = [round(quality.d_v_median_px, 4), round(quality.d_v_spread_px, 4)]
        table["warnings"] += concerns(pair, quality)
        lines.append(
            f"{pair}: {quality.matched_pixels} pixels matched, expected error {quality.sigma_median_px:.3f} px, "
            f"texture too weak on {quality.weak_percent:.1f} %, vertical disparity {quality.d_v_median_px:+.3f} ± "
            f"{quality.d_v_spread_px:.3f} px"
        )
    return Answer(table, [*lines, *(f"Warning: {words}" for words in table["warnings"]), _made(table)])


@app.command(epilog=examples("mammometry surface SESSION", _SET.format("surface", "surface.repair.rho=2.0")))
def surface(
    session: SessionFolder,
    assignments: Assignments = None,
    settings: SettingsFile = None,
    quiet: Quiet = False,
    json: Json = False,
    verbose: Verbose = 0,
) -> Answer:
    """Build, repair and colour the surface.

    Writes results/surface/mesh.ply (mm, world frame), model.glb and the range images.
    """
    job, table = _stage("surface", session, assignments, settings, quiet or json)
    from mammometry.surface.motion.motion_messages import concerns, summary

    mesh, stillness = job.surface().repaired.mesh, job.plan.surfaced.stillness()
    path = job.session.results / "surface" / "mesh.ply"
    table |= {
        "mesh": str(path),
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "watertight": mesh.is_watertight(),
        "euler_number": mesh.euler_number(),
        "apart_mm": [round(value, 4) for value in stillness.apart_mm],
        "moved": stillness.moved,
        "warnings": list(concerns(stillness)),
    }
    closed = "closed" if table["watertight"] else "open"
    said = [f"Cameras and body: {summary(stillness)}", *(f"Warning: {words}" for words in table["warnings"])]
    return Answer(table, [f"{path}: {len(mesh.vertices)} vertices, {closed}", *said, _made(table)])


@app.command(
    epilog=examples(
        "mammometry measure SESSION",
        _SET.format("measure", "measure.wall=plane") + " --json",
        "mammometry measure scan.ply --units mm --boundary b.json",
        "mammometry measure scan.glb --landmarks l.json --out measured",
        "mammometry measure front.ply --units mm --automatic --head y",
    )
)
def measure(
    session: Annotated[
        Path, typer.Argument(metavar="SESSION|MESH", help="A session folder, or a mesh: PLY, OBJ, STL or GLB.")
    ],
    units: Annotated[
        str | None,
        _mesh_option(help="Unit of the mesh: mm, cm or m.", show_default="as the file states, or a torso's size shows"),
    ] = None,
    boundary: Annotated[Path | None, _mesh_option(help="A boundaries.json: closed curves on the mesh.")] = None,
    landmarks: Annotated[
        Path | None, _mesh_option(help="A landmarks.json. Without --boundary they give the boundary.")
    ] = None,
    wall: Annotated[
        str | None,
        typer.Option(
            help="Name of the chest wall (measure.wall). For a mesh also a file with the wall.", show_default=False
        ),
    ] = None,
    out: Annotated[Path | None, _mesh_option(help="Folder for the results.", show_default="MESH-measured")] = None,
    scale_sd: Annotated[
        float | None, _mesh_option(help="Relative standard uncertainty of the scale.", show_default="0.001")
    ] = None,
    surface_sd: Annotated[
        float | None, _mesh_option(help="Standard uncertainty of the surface, mm.", show_default="0.1")
    ] = None,
    subject: Annotated[str | None, _mesh_option(help="Identifier of the subject, a pseudonym.")] = None,
    largest: Annotated[bool, _mesh_option("--largest", help="Measure only the largest piece.")] = False,
    automatic: Annotated[
        bool, _mesh_option("--automatic", help="Find the boundaries of a torso along its creases.")
    ] = False,
    head: Annotated[
        str | None, _mesh_option(help="The file's axis towards the head: y, -z and so on.", show_default="y")
    ] = None,
    ahead: Annotated[
        str | None,
        _mesh_option(help="The axis straight ahead.", show_default="where an open mesh faces"),
    ] = None,
    posture: Annotated[
        str | None, _mesh_option(help="How the patient held herself: standing, leaning or lying.")
    ] = None,
    assignments: Assignments = None,
    settings: SettingsFile = None,
    quiet: Quiet = False,
    json: Json = False,
    verbose: Verbose = 0,
) -> Answer:
    """Measure the breasts of a session, or of another scanner's mesh.

    Finds the boundary, closes the breast with a chest wall and computes the volume. A session gets no report: use `run`
    or `report`. A mesh needs a boundary, landmarks or --automatic. Its results and its report are written beside it.
    """
    is_mesh = session.suffix.lower() in _MESHES and not session.is_dir()
    back = Path(wall) if wall is not None and Path(wall).suffix.lower() in _MESHES else None
    if wall is not None and back is None:
        assignments = [*(assignments or []), f"measure.wall={wall}"]
    if not is_mesh:
        given: dict[str, object] = {"--units": units, "--boundary": boundary, "--landmarks": landmarks, "--out": out}
        given |= {"--wall MESH": back}
        given |= {
            "--subject": subject,
            "--scale-sd": scale_sd,
            "--surface-sd": surface_sd,
            "--largest": largest or None,
            "--automatic": automatic or None,
            "--head": head,
            "--ahead": ahead,
            "--posture": posture,
        }
        for name, value in given.items():
            if value is not None:
                raise typer.BadParameter(f"{name} is for a mesh. A session has this in its files")
        with Bars(quiet or json) as bars:
            job = opened(session, settings, assignments, bars)
            results = job.run(report=False)
        return Answer(results.as_table(), volume_lines(results))
    from mammometry.api.mesh import SCALE_STD, SURFACE_STD_MM, MeshFiles, MeshJob, folder_for, scan_files
    from mammometry.io.meshes.scans import MESH, is_scan, read_scan
    from mammometry.io.outputs import require_apart

    if out is not None and out.is_symlink():
        out = out.resolve()  # a link that the user names is meant; one that came with the files is refused
    if posture not in (None, *POSTURES):
        raise typer.BadParameter(f"--posture is {', '.join(POSTURES)}, found {posture!r}")
    for option, number in (("--scale-sd", scale_sd), ("--surface-sd", surface_sd)):
        if number is not None and not 0 <= number < float("inf"):
            raise typer.BadParameter(f"{option} is a standard uncertainty, 0 or more")
    scan = read_scan(session.parent) if session.name == MESH and is_scan(session.parent) else None
    if scan is not None:
        own = scan_files(session.parent, subject=subject)
        head, ahead, subject = head or own.head, ahead or own.ahead, own.subject
        if boundary is None and own.boundary is not None:
            boundary, automatic = own.boundary, True
        landmarks = landmarks or own.landmarks
    files = MeshFiles(
        mesh=session,
        units=units,
        boundary=boundary,
        landmarks=landmarks,
        back=back,
        automatic=automatic,
        head=head,
        ahead=ahead,
        largest=largest,
        scale_std=SCALE_STD if scale_sd is None else scale_sd,
        surface_std_mm=SURFACE_STD_MM if surface_sd is None else surface_sd,
        subject=named_subject(subject),
        posture=posture or "",
        scan=scan,
    )
    folder = out or folder_for(session)
    require_apart(folder, [settings])
    with Bars(quiet or json) as bars:
        with bars.task("measure", "mesh"):
            mesh_job = MeshJob(files, folder, load_settings(settings, assignments), watch=bars.watch)
        results = mesh_job.run()
    said = f"Standard uncertainty: scale {100 * files.scale_std:g} %, surface {files.surface_std_mm:g} mm"
    return Answer(results.as_table(), [*volume_lines(results), said])


@app.command(
    epilog=examples("mammometry report SESSION", "mammometry report SESSION --deidentify --out for-a-colleague")
)
def report(
    session: SessionFolder,
    deidentify: Annotated[
        bool,
        typer.Option(
            "--deidentify", help="For others: no names, dates, photographs, and no colours above the sternal notch."
        ),
    ] = False,
    geometry_only: Annotated[
        bool, typer.Option("--geometry-only", help="For others: no photographic colours.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="Folder for a report for others.", show_default="in results/")
    ] = None,
    assignments: Assignments = None,
    settings: SettingsFile = None,
    quiet: Quiet = False,
    json: Json = False,
    verbose: Verbose = 0,
) -> Answer:
    """Write the report, as a page and as a PDF.

    With --deidentify, --geometry-only or --out, the report is a copy for others. The session's own report is
    results/report/report.html and report.pdf.
    """
    if not (deidentify or geometry_only):
        if out is not None:
            raise typer.BadParameter("--out needs --deidentify or --geometry-only")
        job, table = _stage("report", session, assignments, settings, quiet or json)
        table["report"] = str(job.report())
        return Answer(table, [f"Report: {table['report']}", _made(table)])
    from mammometry.io.outputs import require_apart

    begun = time.monotonic()
    with Bars(quiet or json) as bars:
        job = opened(session, settings, assignments, bars)
        folder = out or job.session.results / ("deidentified" if deidentify else "geometry-only")
        require_apart(folder, [settings])
        from mammometry.report.privacy import Privacy

        page = job.share(folder, Privacy(deidentify=deidentify, geometry_only=geometry_only))
    table = {**_summary(job, "measure", begun), "report": str(page)}
    return Answer(table, [f"Report: {table['report']}", "The last lines of the report say what it contains."])


def named_subject(text: str | None) -> str | None:
    """A pseudonym as `--subject` gives it."""
    from mammometry.base.identity import subject_id

    try:
        return None if text is None else subject_id(text)
    except ValueError as error:
        raise typer.BadParameter(f"--subject: expected {error}") from None


def volume_lines(results: Results) -> list[Any]:
    """Volumes in words, and where the report is."""
    from mammometry.report.words.volume_words import MEANINGS, definition_words, interval_words, volume_words

    lines: list[Any] = []
    for name, measured in results.measurements.items():
        volume, interval = volume_words(measured.volume_cc, measured.interval_cc), interval_words(measured.interval_cc)
        lines.append(f"{name}: {volume} {interval}, wall: {measured.wall_kind}")
        for defined in measured.definitions:
            lines.append(f"    {MEANINGS[defined.meaning]}: {definition_words(defined)}")
    for name, why in results.no_breast.items():
        lines.append(f"{name}: no breast measured. {why}.")
    for name, found in results.lacking.items():
        lines.append(
            f"    {name} lacks {volume_words(found.volume_cc, found.interval_cc)} to the other side, mirrored "
            f"{interval_words(found.interval_cc)}"
        )
    lines += [f"note: {note}" for note in results.notes]
    if not lines:
        lines.append("The session shows an open surface, which has no volume.")
    made = f"{len(results.made)} results made in {results.seconds:.1f} s"
    if results.peak_memory_mb is not None:
        made += f", with {results.peak_memory_mb:.0f} MB at most"
    lines.append(made if results.made else nothing_made(results.made_at))
    lines.append(f"Results: {results.folder}" if results.report is None else f"Report: {results.report}")
    return lines
