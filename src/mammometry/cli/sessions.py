"""Commands on the session folder itself: new, info, settings."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mammometry.cli.common import Answer, Options, OutputOptions, SessionFolder, command

if TYPE_CHECKING:
    from mammometry.api.job import Job

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
        raise StorageError(
            str(session),
            found=f"a folder that cannot be made ({error.strerror})",
            expected="permission and room to write",
            remedy="Choose another place",
        ) from None
    lines: list[Any] = [
        f"{session / MANIFEST}: describe your rig and target here",
        f"{session / 'calibration'}: one folder per pose, with <camera>.jpg in it",
        f"{session / 'capture'}: photographs of the subject, <camera>.jpg",
        f"Then: mammometry run {session}",
    ]
    return Answer({"session": str(session), "manifest": str(session / MANIFEST), "folders": folders}, lines)


@command(app, "mammometry info SESSION", "mammometry info SESSION --json")
def info(options: Options, session: SessionFolder) -> Answer:
    """Show what a session holds, which results are current, and what to do next.

    A stale result was made from other photographs or settings than the present ones. -v lists every result.
    All result files are read, which takes a second or two per gigabyte.
    """
    from mammometry.api.job import open_session
    from mammometry.job.inputs import MISSING
    from mammometry.job.products import STAGES

    job = open_session(session, options.settings())
    inputs = job.inputs
    poses = sorted({pose for pose, _ in inputs.calibration_photographs})
    stages: dict[str, dict[str, Any]] = {}
    for stage in STAGES:
        products: dict[str, dict[str, Any]] = {}
        keys = job.keys(stage)
        for key, state in zip(keys, job.store.states(keys), strict=True):
            record = job.store.record(key)
            products[key.product] = {
                "state": state,
                "made": None if record is None else record.made,
                "seconds": None if record is None else record.seconds,
            }
        stages[stage] = {"state": _overall([product["state"] for product in products.values()]), "products": products}
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
        "drawn": _drawn_words(job),
        "stages": stages,
        "report_shows": _shown_by(job),
        "pages": job.pages(),
    }
    return Answer(table, _info_lines(table, every_product=options.verbose > 0))


def _shown_by(job: Job) -> dict[str, Any] | None:
    """Name, subject and date on the report's page. None without a page."""
    record = job.store.record(job.content_key)
    return None if record is None else record.settings.get("identity", {})


def _drawn_words(job: Job) -> dict[str, str]:
    """Breast → who drew its boundary and who confirmed it, from boundaries.json."""
    from mammometry.job.stages.measure import boundaries
    from mammometry.measure.volume.attribution import confirmed_words, curve_digest

    inputs = job.inputs
    found = (job.plan.current(boundaries) if inputs.attributions else None) or ()
    curves = {boundary.name: boundary.points_world for boundary in found} | dict(inputs.boundaries)
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
    """A line a stage."""
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
    """A line a product."""
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
