"""Commands on the session folder itself: new, info, settings, verify, edit."""

from __future__ import annotations

import sys
import webbrowser
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mammometry.cli.common import Answer, Bars, Options, OutputOptions, SessionFolder, SessionOrScan, command
from mammometry.cli.stages import opened

if TYPE_CHECKING:
    from mammometry.api.job import Job
    from mammometry.editor.session import Drawable
    from mammometry.io.results.store import Store
    from mammometry.io.results.verify import Findings
    from mammometry.job.graph import Plan
    from mammometry.job.inputs import Inputs
    from mammometry.job.products import Key
    from mammometry.settings import Settings

app = typer.Typer()


class RigName(StrEnum):
    """Rigs that a new manifest can describe."""

    reference = "reference"
    single = "single"


class TargetKind(StrEnum):
    """Targets that a new manifest can describe."""

    charuco = "charuco"
    chessboard = "chessboard"
    circles = "circles"
    dotted_cylinder = "dotted-cylinder"
    points = "points"


class SubjectKind(StrEnum):
    """Subjects that a new manifest can describe."""

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
        f"Then: mammometry run {session}",
    ]
    return Answer({"session": str(session), "manifest": str(session / MANIFEST), "folders": folders}, lines)


@command(app, "mammometry info SESSION", "mammometry info SESSION --json")
def info(options: Options, session: SessionOrScan) -> Answer:
    """Show what a session holds, which results are current, and what to do next.

    A stale result was made from other photographs or settings than the present ones. -v lists every result.
    All result files are read, which takes a second or two per gigabyte.
    """
    from mammometry.api.job import open_session
    from mammometry.io.meshes.scans import is_scan
    from mammometry.job.inputs import MISSING
    from mammometry.job.products import STAGES

    if is_scan(session):
        return _scan_info(session, options.settings(), every_product=options.verbose > 0)
    job = open_session(session, options.settings())
    inputs = job.inputs
    poses = sorted({pose for pose, _ in inputs.calibration_photographs})
    stages = {stage: _stage_about(job.store, job.keys(stage)) for stage in STAGES}
    table = {
        "session": str(session),
        "rig": inputs.rig_name,
        "name": job.identity.name,
        "subject": inputs.subject_kind,
        "subject_id": job.identity.subject,
        "pairs": {name: list(pair) for name, pair in inputs.pair_names.items()},
        "poses": poses,
        "missing": [f"capture/{name}" for name in inputs.photographs if inputs.digests[f"capture/{name}"] == MISSING],
        "ready_made_cameras": inputs.cameras is not None,
        "masks": sorted(inputs.masks),
        "boundaries": sorted(inputs.boundaries),
        "drawn": _drawn_words(job.plan, inputs),
        "stages": stages,
        "report_shows": _shown_by(job),
        "pages": job.pages(),
    }
    return Answer(table, _info_lines(table, every_product=options.verbose > 0))


def _scan_info(folder: Path, settings: Settings, *, every_product: bool) -> Answer:
    """What an imported scan holds, which results are current, and what to do next."""
    from mammometry.api.scan_folders import open_scan

    scan = open_scan(folder, settings)
    keys = [product.key for product in scan.plan.products()]
    stages = {"measure": _stage_about(scan.store, keys), "report": _stage_about(scan.store, [scan.content_key])}
    words = _drawn_words(scan.plan, scan.inputs)
    drawn = [f"boundary {name}: {how}" for name, how in words.items()]
    table = {
        "scan": str(folder),
        "scanner": scan.scanner,
        "name": scan.identity.name,
        "subject_id": scan.identity.subject,
        "units": scan.units,
        "posture": scan.posture or None,
        "notes": list(scan.notes),
        "boundaries": sorted(scan.inputs.boundaries),
        "drawn": words,
        "stages": stages,
    }
    first = f"scanner {scan.scanner}, unit {scan.units}, posture {scan.posture or 'not given'}"
    shown = _products_table(stages) if every_product else _stages_table(stages)
    done = all(about["state"] == "current" for about in stages.values())
    then = f"open {scan.page}" if done else f"mammometry measure {folder}"
    return Answer(table, [first, *drawn, *scan.notes, "", shown, "", f"Next: {then}"])


def _stage_about(store: Store, keys: Sequence[Key]) -> dict[str, Any]:
    """State of a stage and of its products."""
    products: dict[str, dict[str, Any]] = {}
    for key, state in zip(keys, store.states(keys), strict=True):
        record = store.record(key)
        products[key.product] = {
            "state": state,
            "made": None if record is None else record.made,
            "seconds": None if record is None else record.seconds,
        }
    return {"state": _overall([product["state"] for product in products.values()]), "products": products}


def _shown_by(job: Job) -> dict[str, Any] | None:
    """Name, subject and date on the report's page. None without a page."""
    record = job.store.record(job.content_key)
    return None if record is None else record.settings.get("identity", {})


def _drawn_words(plan: Plan, inputs: Inputs) -> dict[str, str]:
    """Breast → who drew its boundary and who confirmed it, from boundaries.json."""
    from mammometry.job.stages.measure import boundaries
    from mammometry.measure.volume.attribution import confirmed_words, curve_digest

    outlines = (plan.current(boundaries) if inputs.attributions else None) or ()
    curves = {boundary.name: boundary.points_world for boundary in outlines} | dict(inputs.boundaries)
    words = {}
    for name, attribution in inputs.attributions.items():
        how = attribution.origin or ("given" if name in inputs.boundaries else "automatic")
        if name in curves:
            how = confirmed_words(how, curve_digest(curves[name]), attribution.confirmation)
        elif attribution.confirmation is not None:
            how += "; a curve was confirmed by eye. Measure to see whether it is still the same"
        words[name] = how
    return words


def _overall(states: list[str]) -> str:
    if not states:
        return "not needed"
    for state in ("current", "absent"):
        if all(product_state == state for product_state in states):
            return state
    return next((state for state in ("damaged", "stale") if state in states), "partial")


_STAGES = {
    "calibrate": "cameras calibrated",
    "match": "pairs matched",
    "surface": "surface built",
    "measure": "breasts measured",
    "report": "report written",
}
_STATES = {
    "current": "yes",
    "absent": "not yet",
    "partial": "in part",
    "stale": "to be done again: a photograph, a drawing or a setting was changed",
    "damaged": "to be done again: a file of it is damaged",
    "not needed": "not needed",
}


def _stages_table(stages: dict[str, Any]) -> Any:
    """Table with a line for every stage."""
    from rich.table import Table

    shown = Table.grid(padding=(0, 3))
    for stage, about in stages.items():
        made = [product["made"] for product in about["products"].values() if product["made"]]
        seconds = sum(product["seconds"] or 0.0 for product in about["products"].values())
        when = (
            f"{max(made)[:16].replace('T', ' ')} UTC, {seconds:.0f} s" if about["state"] == "current" and made else ""
        )
        shown.add_row(_STAGES[stage], _STATES[about["state"]], when)
    return shown


def _products_table(stages: dict[str, Any]) -> Any:
    """Table with a line for every product."""
    from rich.table import Table

    shown = Table("stage", "product", "state", "made", "seconds", box=None, pad_edge=False)
    for stage, about in stages.items():
        if not about["products"]:
            shown.add_row(stage, "", about["state"], "", "")
        for number, (name, product) in enumerate(about["products"].items()):
            seconds = "" if product["seconds"] is None else f"{product['seconds']:.1f}"
            shown.add_row("" if number else stage, name, product["state"], product["made"] or "", seconds)
    return shown


def _next_words(table: dict[str, Any]) -> str:
    """What to do next."""
    if table["missing"]:
        return "Next: put the missing photographs there"
    states = [about["state"] for about in table["stages"].values()]
    if all(state in ("current", "not needed") for state in states):
        return "Next: open results/report/report.html"
    return f"Next: mammometry run {table['session']}"


def _info_lines(table: dict[str, Any], *, every_product: bool) -> list[Any]:
    calibration = "ready-made cameras" if table["ready_made_cameras"] else f"{len(table['poses'])} calibration poses"
    pairs = ", ".join(f"{name} ({left} + {right})" for name, (left, right) in table["pairs"].items())
    subject = table["subject"] if table["subject_id"] is None else f"{table['subject']} {table['subject_id']}"
    missing = [f"missing: {', '.join(table['missing'])}"] if table["missing"] else []
    drawn = [f"boundary {name}: {how}" for name, how in table["drawn"].items()]
    shows = table["report_shows"]
    other = shows is not None and (shows.get("name"), shows.get("subject")) != (table["name"], table["subject_id"])
    named = " ".join(filter(None, (shows.get("subject"), shows.get("name")))) if other else ""
    warned = [f"the report shows another name ({named or 'not recorded'}). Make it again"] if other else []
    stale = [page for page, state in table["pages"].items() if state == "stale"]
    warned += [f"results/{page} shows other results or another name. Make it again or delete it" for page in stale]
    first = f"rig {table['rig']}, subject {subject}, {calibration}"
    shown = _products_table(table["stages"]) if every_product else _stages_table(table["stages"])
    return [first, f"pairs: {pairs}", *drawn, *missing, *warned, "", shown, "", _next_words(table)]


@command(
    app,
    "mammometry settings",
    "mammometry settings --set matching.window_px=11 > my.toml",
    "mammometry settings --paper > paper.toml",
)
def settings(
    options: Options,
    paper: Annotated[
        bool, typer.Option("--paper", help="Only those that make the method the paper's, as printed.")
    ] = False,
) -> Answer:
    """List all settings with their values, as TOML for --settings."""
    from mammometry.settings import Settings, as_table, paper_method

    if paper:
        if options.file or options.assignments:
            raise typer.BadParameter("--paper: prints the paper's settings alone; leave out --settings and --set")
        text = paper_method()
        return Answer({"settings": as_table(Settings.from_toml(text))}, [text])
    loaded = options.settings()
    return Answer({"settings": as_table(loaded)}, [loaded.to_toml()])


_MB = 1e6  # bytes in a MB


@command(app, "mammometry verify SESSION", "mammometry verify scan-measured --json")
def verify(
    options: Options,
    session: Annotated[
        Path,
        typer.Argument(
            metavar="SESSION",
            help="A session, or the results of a measured mesh. Nothing is written to it.",
            show_default=False,
        ),
    ],
) -> Answer:
    """Check that all result files are as they were written.

    Names the damaged ones and says which of them a rerun renews. The exit code is 9 if a file is damaged. Changed
    photographs and settings are not damage: `mammometry info` shows those.
    """
    from mammometry.base.errors import StorageError
    from mammometry.io.results.verify import results_in
    from mammometry.io.results.verify import verify as verified

    results = results_in(session)
    findings = verified(results)
    renewed, left, remark = _renewed(session, results, findings, options)
    table: dict[str, Any] = {"results": str(results), **asdict(findings), "renewed": renewed, "not_renewed": left}
    lines: list[Any] = [f"{damage.file}: {damage.found}" for damage in findings.damaged]
    lines += [f"A rerun renews {', '.join(renewed)}"] if renewed else []
    lines += [f"A rerun does not renew {', '.join(left)}: {remark}"] if left else []
    lines += [f"{results.name}/{name}: left by an interrupted run or set aside" for name in findings.leftovers]
    lines += [f"{name}: not written by mammometry, not checked" for name in findings.unrecorded]
    sums = f"{findings.products} products, {findings.files} files, {findings.bytes / _MB:.0f} MB"
    lines.append(f"{sums}: {'DAMAGED' if findings.damaged else 'all as they were written'}")
    return Answer(table, lines, exit_code=StorageError.exit_code if findings.damaged else 0)


def _renewed(session: Path, results: Path, findings: Findings, options: Options) -> tuple[list[str], list[str], str]:
    """Damaged products that a rerun makes again, those it cannot, and why."""
    from mammometry.api.job import open_session
    from mammometry.base.errors import MammometryError
    from mammometry.io.results.verify import shown
    from mammometry.job.products import STAGES

    loaded = options.settings()
    damaged = {f"{damage.stage}/{damage.product}": None for damage in findings.damaged if damage.product is not None}
    stages = [damage.stage for damage in findings.damaged if damage.product is None]
    if results == session:
        return [*damaged, *stages], [], ""
    if not damaged and not stages:
        return [], [], ""
    try:
        job = open_session(session, loaded)
        keys = [key for stage in STAGES[:-1] if job.plan.products(stage) for key in job.keys(stage)]
        wanted = {f"{key.stage}/{key.product}" for key in [*keys, job.content_key, job.report_key]}
    except MammometryError as error:
        return [], [*damaged, *stages], shown(str(error))
    left = [name for name in damaged if name not in wanted]
    return [name for name in damaged if name in wanted] + stages, left, "no longer part of this session"


@command(app, "mammometry edit SESSION", "mammometry edit SESSION --no-browser --author 'A. Nurse'")
def edit(
    options: Options,
    session: SessionOrScan,
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
    from mammometry.io.meshes.scans import is_scan

    def ready(address: str, local_page: str) -> None:
        # Standard output belongs to the answer, which comes after the page was closed.
        print(f"{address} (works once; Ctrl-C stops)", file=sys.stderr, flush=True)  # noqa: T201
        if browser:
            webbrowser.open(local_page)

    def drawable() -> Drawable:
        from mammometry.api.job import open_session
        from mammometry.api.scan_folders import drawable_scan

        chosen = options.settings()
        return drawable_scan(session, chosen) if scan else open_session(session, chosen)

    scan = is_scan(session)
    if not scan:
        with Bars(options.silent) as bars:
            opened(session, options, bars).ensure("surface")
    with suppress(KeyboardInterrupt):  # the way to stop it
        serve(drawable, ready=ready, author=author)
    present = [name for name in (BOUNDARIES, LANDMARK_FILE) if (session / name).is_file()]
    then = f"mammometry measure {session}" if scan else f"mammometry run {session}"
    return Answer({"session": str(session), "drawn": present}, [f"Then: {then}"] if present else [])
