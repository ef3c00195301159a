"""The command `run`, its stages, and pictures of them: `figure`, `graph`."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mammometry.cli.common import Answer, Bars, Options, SessionFolder, SessionOrScan, command, nothing_made
from mammometry.cli.compile_cache import compiled_ahead
from mammometry.cli.mesh import MESHES, MeshOptions, measure_mesh

if TYPE_CHECKING:
    from mammometry.api.job import Job
    from mammometry.api.results import Results
    from mammometry.base.notices import Notice
    from mammometry.job.products import Stage


app = typer.Typer()
_SET = "mammometry {} SESSION --set {}"


def opened(session: Path, options: Options, bars: Bars, *assignments: str) -> Job:
    """Open the session's job with further assignments, and set the total of the bars."""
    from mammometry.api.job import open_session

    job = open_session(session, options.settings(*assignments), watch=bars.watch)
    expect(job, bars)
    return job


def expect(job: Job, bars: Bars) -> None:
    """Set the total of the bars: the results that are not current."""
    for stage in job.stages:
        keys = job.keys(stage)
        records = {key.product: job.store.record(key) for key in keys}
        seconds = {name: record.seconds for name, record in records.items() if record is not None}
        bars.expect(stage, sum(state != "current" for state in job.store.states(keys)), seconds)


def _stage(stage: Stage, session: Path, options: Options) -> tuple[Job, dict[str, Any]]:
    begun = time.monotonic()
    with Bars(options.silent) as bars:
        job = opened(session, options, bars)
        job.ensure(stage)
    return job, _summary(job, stage, begun)


def _summary(job: Job, stage: Stage, begun: float) -> dict[str, Any]:
    """Results and seconds of a stage since `begun` (`time.monotonic`)."""
    from mammometry.base.machine.system import peak_memory_mb

    return {
        "made": job.store.made,
        "made_at": job.made_at(stage),
        "seconds": round(time.monotonic() - begun, 3),
        "stage_seconds": {name: round(value, 3) for name, value in job.stage_seconds.items()},
        "peak_memory_mb": peak_memory_mb(),
        "results": str(job.store.folder),
    }


def _made(table: dict[str, Any]) -> str:
    made = len(table["made"])
    return f"{made} results made in {table['seconds']:.1f} s" if made else nothing_made(table["made_at"])


@command(app, "mammometry run SESSION", "mammometry run SESSION --json", _SET.format("run", "measure.wall=plane"))
def run(options: Options, session: SessionOrScan) -> Answer:
    """Do the whole job: calibrate, match, build the surface, measure, report.

    A scan is measured and reported. Results that are current are kept. Only what changed is computed again.
    """
    with Bars(options.silent) as bars:
        job = opened(session, options, bars)
        with compiled_ahead(wanted=not job.store.has(job.report_key)):
            results = job.run()
    return Answer(results.as_table(), volume_lines(results))


@command(app, "mammometry calibrate SESSION", _SET.format("calibrate", "calibration.bundle.model=paper"))
def calibrate(options: Options, session: SessionFolder) -> Answer:
    """Calibrate the cameras from photographs of the target. Writes results/calibrate/cameras.json."""
    from mammometry.job.stages.calibrate import cameras as product

    job, table = _stage("calibrate", session, options)
    cameras = job.plan[product]()
    table |= {"rms_px": cameras.rms_px, "world": cameras.world, "cameras": len(cameras.rig.cameras)}
    table |= {"verdict": cameras.verdict, "reasons": list(cameras.reasons)}
    table |= {"notices": [notice.as_table() for notice in cameras.notices]}
    given = "ready-made" if job.inputs.walk is None else "placed by the printed board"
    rms = given if cameras.rms_px is None else f"verdict: {cameras.verdict}"
    reasons = [f"- {reason}" for reason in cameras.reasons]
    return Answer(table, [f"{len(cameras.rig.cameras)} cameras, {rms}. World: {cameras.world}", *reasons, _made(table)])


@command(app, "mammometry match SESSION", _SET.format("match", "matching.window_px=11"))
def match(options: Options, session: SessionFolder) -> Answer:
    """Find the subject in the photographs and match every pair.

    Writes the disparities to results/match, as TIFF files of float32.
    """
    from mammometry.job.stages.match import disparity

    job, table = _stage("match", session, options)
    from mammometry.base.notices.words import in_json, lines_of
    from mammometry.matching.quality import assess, concerns

    missing = _without_outline(job)
    table |= {"matched_pixels": {}, "weak_percent": {}, "d_v_px": {}}
    lines: list[Any] = []
    notices: list[Notice] = []
    for pair, product in job.plan[disparity].items():
        quality = assess(product.uncached())
        table["matched_pixels"][pair] = quality.matched_pixels
        table["weak_percent"][pair] = round(quality.weak_percent, 2)
        table["d_v_px"][pair] = [round(quality.d_v_median_px, 4), round(quality.d_v_spread_px, 4)]
        if job.inputs.walk is None:  # a walk's pairs are tested by `walk.motion`
            notices += concerns(pair, quality, missing[pair])
        lines.append(
            f"{pair}: {quality.matched_pixels} pixels matched, expected error {quality.sigma_median_px:.3f} px, "
            f"texture too weak on {quality.weak_percent:.1f} %, vertical disparity {quality.d_v_median_px:+.3f} ± "
            f"{quality.d_v_spread_px:.3f} px"
        )
    return Answer(table | in_json(notices), [*lines, *lines_of(notices), _made(table)])


def _without_outline(job: Job) -> dict[str, tuple[str, ...]]:
    """Pair → its cameras whose outlines are not known."""
    from mammometry.job.stages.match import subjects
    from mammometry.matching.foreground.outlines_first import without_outline

    found = job.plan.value(subjects)
    doubts = {} if found is None else found.doubts
    return {pair: without_outline(cameras, doubts) for pair, cameras in job.inputs.pair_names.items()}


@command(app, "mammometry surface SESSION", _SET.format("surface", "surface.repair.rho=2.0"))
def surface(options: Options, session: SessionFolder) -> Answer:
    """Build, repair and colour the surface.

    Writes results/surface/mesh.ply (mm, world frame), model.glb and the range images.
    """
    from mammometry.job.stages.surface import stillness as product
    from mammometry.job.stages.surface import walk_motion

    job, table = _stage("surface", session, options)
    from mammometry.base.notices.words import in_json, lines_of
    from mammometry.report.warnings import walk_concerns
    from mammometry.report.words.stage_facts import motion_words
    from mammometry.surface.motion.motion_detection import concerns

    mesh, stillness, walk = job.surface().repaired.mesh, job.plan[product](), job.plan.value(walk_motion)
    path = job.store.folder / "surface" / "mesh.ply"
    notices = list(concerns(stillness, _without_outline(job)))
    distance_mm, moved = stillness.distance_mm, stillness.moved and not stillness.refuted
    if walk is not None and job.inputs.walk is not None:
        notices = list(walk_concerns(job.inputs.walk, walk))
        distance_mm, moved = (walk.before_mm, walk.rest_mm), walk.moved
    table |= {
        "mesh": str(path),
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "watertight": mesh.is_watertight(),
        "euler_number": mesh.euler_number(),
        "apart_mm": [round(value, 4) for value in distance_mm],
        "moved": moved,
        **in_json(notices),
    }
    closed = "closed" if table["watertight"] else "open"
    remarks = [f"Cameras and body: {motion_words(job.plan)}", *lines_of(notices)]
    return Answer(table, [f"{path}: {len(mesh.vertices)} vertices, {closed}", *remarks, _made(table)])


@command(
    app,
    "mammometry measure SESSION",
    _SET.format("measure", "measure.wall=plane") + " --json",
    "mammometry measure scan.ply --units mm --boundary b.json",
    "mammometry measure scan.glb --landmarks l.json --out measured",
    "mammometry measure front.ply --units mm --automatic --head y",
)
def measure(
    options: Options,
    session: Annotated[
        Path,
        typer.Argument(metavar="SESSION|MESH", help="A session, a scan, or a mesh: PLY, OBJ, STL, GLB or USDZ."),
    ],
    mesh: MeshOptions,
    wall: Annotated[
        str | None,
        typer.Option(
            help="Name of the chest wall (measure.wall). For a mesh also a file with the wall.", show_default=False
        ),
    ] = None,
) -> Answer:
    """Measure the breasts of a session, or of another scanner's mesh.

    Finds the boundary, closes the breast with a chest wall and computes the volume. A session gets no report: use `run`
    or `report`. A mesh needs a boundary, landmarks or --automatic. Its results and its report are written next to it.
    """
    from mammometry.io.meshes.scans import MESH, is_scan

    back = Path(wall) if wall is not None and Path(wall).suffix.lower() in MESHES else None
    assignments = [f"measure.wall={wall}"] if wall is not None and back is None else []
    if session.suffix.lower() in MESHES and not session.is_dir():
        results, remarks = measure_mesh(session, mesh, back, options, assignments)
    elif is_scan(session):
        results, remarks = measure_mesh(session / MESH, mesh, back, options, assignments)
    elif (option := "--wall MESH" if back is not None else mesh.given()) is not None:
        raise typer.BadParameter(f"{option} is for a mesh. A session has this in its files")
    else:
        with Bars(options.silent) as bars:
            results, remarks = opened(session, options, bars, *assignments).run(report=False), []
    return Answer(results.as_table(), [*volume_lines(results), *remarks])


@command(app, "mammometry report SESSION", "mammometry report SESSION --deidentify --out for-a-colleague")
def report(
    options: Options,
    session: SessionOrScan,
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
) -> Answer:
    """Write the report, as a page and as a PDF.

    With --deidentify, --geometry-only or --out, the report is a copy for others. The session's own report is
    results/report/report.html and report.pdf.
    """
    from mammometry.io.outputs import require_apart
    from mammometry.report.privacy import Privacy

    privacy = Privacy(deidentify=deidentify, geometry_only=geometry_only)
    if out is not None and not privacy.guarded:
        raise typer.BadParameter("--out needs --deidentify or --geometry-only")
    name = "deidentified" if deidentify else "geometry-only"
    if out is not None:
        require_apart(out, [options.file])
    if not privacy.guarded:
        job, table = _stage("report", session, options)
        table["report"] = str(job.report())
        return Answer(table, [f"Report: {table['report']}", _made(table)])
    begun = time.monotonic()
    with Bars(options.silent) as bars:
        job = opened(session, options, bars)
        page = job.share(out or job.store.folder / name, privacy)
    table = {**_summary(job, "measure", begun), "report": str(page)}
    return Answer(table, [f"Report: {table['report']}", "The last lines of the report say what it contains."])


def demo_answer(
    measured: Answer, truth_cc: Mapping[str, float], *, begun: float, simulated: float, cast: bool = False
) -> Answer:
    """A demo's answer: what was measured, with the true volumes before it.

    Args:
        measured: the answer of the measurement, whose table has volumes and times.
        truth_cc: name of a solid → true volume.
        begun: when the demo began, s, by `time.monotonic`.
        simulated: duration of the simulation, s.
        cast: whether the solid is a cast, whose volume is compared with more decimals.
    """
    table = dict(measured.table)
    table["seconds"] = round(time.monotonic() - begun, 3)
    table["stage_seconds"] = {"simulate": round(simulated, 3), **table["stage_seconds"]}
    table["true_volumes_cc"] = {name: round(volume, 3) for name, volume in truth_cc.items()}
    lines: list[Any] = []
    for name, true_cc in truth_cc.items():
        measured_cc = table["volumes_cc"].get(name)
        if measured_cc is None:
            lines.append(f"{name}: not measured, true {true_cc:.0f} cc")
            continue
        off = 100 * (measured_cc / true_cc - 1)
        if cast:
            lines.append(f"{name}: measured {measured_cc:.1f} cc, true {true_cc:.1f} cc ({off:+.2f} %)")
        else:
            lines.append(f"{name}: measured {measured_cc:.0f} cc, true {true_cc:.0f} cc ({off:+.0f} %)")
    return Answer(table, [*lines, *measured.lines])


def volume_lines(results: Results) -> list[Any]:
    """Volumes in words, and where the report is."""
    from mammometry.base.notices.words import lines_of
    from mammometry.report.words.volumes import MEANINGS, definition_words, measured_words, verdict_words

    lines: list[Any] = []
    for name, measured in results.measurements.items():
        volume = measured_words(measured.volume_cc, measured.interval_cc)
        lines.append(f"{name}: {volume}, wall: {measured.wall_kind}")
        for defined in measured.definitions:
            lines.append(f"    {MEANINGS[defined.meaning]}: {definition_words(defined)}")
    if (apart := results.difference) is not None:
        words = measured_words(apart.difference_cc, apart.difference_interval_cc, sign=True)
        lines.append(f"left minus right: {words}: {verdict_words(apart.beyond_error)}")
    for name, why in results.no_breast.items():
        lines.append(f"{name}: no breast measured. {why}.")
    for name, deficit in results.lacking.items():
        lines.append(
            f"    {name} lacks {measured_words(deficit.volume_cc, deficit.interval_cc)} to the other side, mirrored"
        )
    lines += lines_of(results.notices)
    if not lines:
        lines.append("The session shows an open surface, which has no volume.")
    made = f"{len(results.made)} results made in {results.seconds:.1f} s"
    if results.peak_memory_mb is not None:
        made += f", with {results.peak_memory_mb:.0f} MB at most"
    lines.append(made if results.made else nothing_made(results.made_at))
    lines.append(f"Results: {results.folder}" if results.report is None else f"Report: {results.report}")
    return lines


@command(app, "mammometry figure 5 SESSION", "mammometry figure 7 SESSION --out surface.svg")
def figure(
    options: Options,
    number: Annotated[int, typer.Argument(metavar="N", help="Number of the figure in the paper, 1 to 7.")],
    session: SessionOrScan,
    out: Annotated[
        Path | None, typer.Option(help="File to write: .pdf, .svg or .png.", show_default="figure-N.pdf in results/")
    ] = None,
) -> Answer:
    """Draw a figure of the paper from a session, for print. From a scan, figure 7: its surface.

    Text and lines are vectors, pictures have 300 dpi.
    """
    from mammometry.io.outputs import require_apart, require_free
    from mammometry.report.figures.catalogue import PAPER_FIGURES
    from mammometry.report.figures.paper import FORMATS, OF_SURFACE, write_figure

    if str(number) not in PAPER_FIGURES:
        raise typer.BadParameter(f"N is one of {', '.join(PAPER_FIGURES)}, found {number}")
    if out is not None and out.suffix not in FORMATS:
        raise typer.BadParameter(f"--out ends with one of {', '.join(FORMATS)}, found {out.name}")
    with Bars(options.silent) as bars:
        job = opened(session, options, bars)
        path = out or job.store.folder / f"figure-{number}.pdf"
        require_apart(path, [*job.brought, options.file])
        require_free(path.parent, [path.name], command="figure")
        if str(number) in OF_SURFACE:
            job.surface()
        else:
            job.ensure("surface")
        with bars.task("figure", str(number)):
            write_figure(number, (job.plan, job.inputs, job.settings), path, job.identity.subject)
    return Answer({"figure": str(path)}, [f"Figure {number}: {path}"])


@command(app, "mammometry graph SESSION", "mammometry graph SESSION --out products.svg")
def graph(
    options: Options,
    session: SessionOrScan,
    out: Annotated[
        Path | None, typer.Option(help="SVG file to write.", show_default="products.svg in results/")
    ] = None,
) -> Answer:
    """Draw all results with their inputs, whether they are current, and how long they took.

    Nothing is computed. All result files are read, which takes a second or two per gigabyte.
    """
    from mammometry.api.job import open_session
    from mammometry.io.outputs import require_apart, write_output
    from mammometry.report.figures.product_graph import Known, product_graph

    if out is not None and out.suffix != ".svg":
        raise typer.BadParameter(f"--out ends with .svg, found {out.name}")
    job = open_session(session, options.settings())
    path = out or job.store.folder / "products.svg"
    require_apart(path, [*job.brought, options.file])
    keys = [product.key for product in job.plan.products()]
    known = {}
    for key, state in zip(keys, job.store.states(keys), strict=True):
        record = job.store.record(key)
        known[f"{key.stage}/{key.product}"] = Known(state=state, seconds=None if record is None else record.seconds)
    write_output(path, product_graph(job.plan, known, job.identity.subject).encode(), command="graph")
    return Answer({"graph": str(path)}, [f"Graph: {path}"])
