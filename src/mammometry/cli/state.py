"""Commands that look at a session's results: info, verify."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mammometry.base.shell import command_line
from mammometry.cli.common import Answer, Options, SessionOrScan, command

if TYPE_CHECKING:
    from mammometry.api.job import Job
    from mammometry.api.mesh import MeshJob
    from mammometry.api.sources import Sources
    from mammometry.io.results.store import Store
    from mammometry.io.results.verify import Findings
    from mammometry.job.graph import Plan
    from mammometry.job.inputs import Inputs
    from mammometry.job.products import Key

app = typer.Typer()


@command(app, "mammometry info SESSION", "mammometry info SESSION --json")
def info(options: Options, session: SessionOrScan) -> Answer:
    """Show a session's contents, which results are current, and what to do next.

    A result is stale if photographs or settings have changed since. -v lists every result. All result files are read,
    which takes a second or two per gigabyte.
    """
    from mammometry.api.job import open_session
    from mammometry.api.mesh import MeshJob
    from mammometry.job.inputs import MISSING

    job = open_session(session, options.settings())
    stages: dict[str, Any] = {stage: _stage_about(job.store, job.plan, job.keys(stage)) for stage in job.stages}
    if isinstance(job, MeshJob):
        return _scan_info(session, job, stages, options)
    inputs = job.inputs
    poses = sorted({pose for pose, _ in inputs.calibration_photographs})
    table: dict[str, Any] = {
        "session": str(session),
        "rig": inputs.rig_name,
        "name": job.identity.name,
        "subject": inputs.subject_kind,
        "subject_id": job.identity.subject,
        "pairs": {name: list(pair) for name, pair in inputs.pair_names.items()},
        "poses": poses,
        "missing": [f"capture/{name}" for name in inputs.photographs if inputs.digests[f"capture/{name}"] == MISSING],
        "ready_made_cameras": inputs.cameras is not None,
        "walk": inputs.walk is not None,
        "masks": sorted(inputs.masks),
        "boundaries": sorted(inputs.boundaries),
        "drawn": _drawn_words(job.plan, inputs),
        "stages": stages,
        "report_shows": _shown_by(job),
        "pages": job.pages(),
        "at_work": job.store.at_work,
    }
    table["next"] = _next(table, session, job.page, options)
    return Answer(table, _info_lines(table, every_product=options.verbose > 0))


def _scan_info(folder: Path, scan: MeshJob, stages: dict[str, Any], options: Options) -> Answer:
    """Contents of a scan, its current results, and the next step."""
    from mammometry.base.notices.words import words_of

    words = _drawn_words(scan.plan, scan.inputs)
    drawn = [f"boundary {name}: {how}" for name, how in words.items()]
    notes = list(map(words_of, scan.notices))
    table: dict[str, Any] = {
        "scan": str(folder),
        "scanner": scan.scanner,
        "name": scan.identity.name,
        "subject_id": scan.identity.subject,
        "units": scan.units,
        "posture": scan.posture or None,
        "notes": notes,
        "notices": [notice.as_table() for notice in scan.notices],
        "boundaries": sorted(scan.inputs.boundaries),
        "drawn": words,
        "stages": stages,
        "pages": scan.pages(),
        "at_work": scan.store.at_work,
        "missing": [],
    }
    table["next"] = _next(table, folder, scan.page, options)
    first = f"scanner {scan.scanner or 'not given'}, unit {scan.units}, posture {scan.posture or 'not given'}"
    shown = _products_table(stages) if options.verbose > 0 else _stages_table(stages)
    lines = [first, *drawn, *notes, "", shown, *_after_table(table), "", f"Next: {table['next']}"]
    return Answer(table, lines)


def _stage_about(store: Store, plan: Plan, keys: Sequence[Key]) -> dict[str, Any]:
    """State of a stage and of its products, and the changes since they were made."""
    from mammometry.api.changes import changes

    products: dict[str, dict[str, Any]] = {}
    for key, state in zip(keys, store.states(keys), strict=True):
        record = store.record(key)
        products[key.product] = {
            "state": state,
            "made": None if record is None else record.made,
            "seconds": None if record is None else record.seconds,
        }
    stale = [key for key in keys if products[key.product]["state"] == "stale"]
    return {
        "state": _overall([product["state"] for product in products.values()]),
        "changed": list(changes(store, plan, stale).words),
        "products": products,
    }


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
_MADE = {
    "calibrate": "the calibration",
    "match": "the matching",
    "surface": "the surface was built",
    "measure": "the measurement",
    "report": "the report was written",
}
_MOST_CHANGES = 4  # named on a line; --json has all
_STATES = {
    "current": "yes",
    "absent": "not yet",
    "partial": "in part",
    "stale": "to be done again",
    "damaged": "to be done again: one of its files is damaged",
    "not needed": "not needed",
}


def _stages_table(stages: dict[str, Any]) -> Any:
    """Table with a row for every stage."""
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


def _changed_lines(stages: dict[str, Any]) -> list[str]:
    """Inputs and settings changed since each stage's results were made."""
    lines = []
    for stage, about in stages.items():
        changed = about["changed"]
        more = f" and {len(changed) - _MOST_CHANGES} more" if len(changed) > _MOST_CHANGES else ""
        lines += [f"Changed since {_MADE[stage]}: {', '.join(changed[:_MOST_CHANGES])}{more}"] if changed else []
    return lines


def _products_table(stages: dict[str, Any]) -> Any:
    """Table with a row for every product."""
    from rich.table import Table

    shown = Table("stage", "product", "state", "made", "seconds", box=None, pad_edge=False)
    for stage, about in stages.items():
        if not about["products"]:
            shown.add_row(stage, "", about["state"], "", "")
        for number, (name, product) in enumerate(about["products"].items()):
            seconds = "" if product["seconds"] is None else f"{product['seconds']:.1f}"
            shown.add_row("" if number else stage, name, product["state"], product["made"] or "", seconds)
    return shown


def _next(table: dict[str, Any], session: Path, page: Path, options: Options) -> str:
    """The next step: a command that can be pasted, if there is one."""
    if table["missing"]:
        return f"put the missing photographs into {session.absolute() / 'capture'}"
    states = [about["state"] for about in table["stages"].values()]
    if all(state in ("current", "not needed") for state in states):
        return f"open {command_line(page)}"
    return command_line("mammometry", "run", session, *options.words)


def _after_table(table: dict[str, Any]) -> list[str]:
    """List changes, and whether a run is in progress."""
    lines = _changed_lines(table["stages"])
    lines += [f"A run is in progress ({table['at_work']}). Wait for it to end"] if table["at_work"] else []
    return ["", *lines] if lines else []


def _info_lines(table: dict[str, Any], *, every_product: bool) -> list[Any]:
    calibration = "ready-made cameras" if table["ready_made_cameras"] else f"{len(table['poses'])} calibration poses"
    if table["walk"]:
        calibration = "a walk with a telephone and a printed board"
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
    next_line = f"Next: {table['next']}"
    return [first, f"pairs: {pairs}", *drawn, *missing, *warned, "", shown, *_after_table(table), "", next_line]


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
    """Check every byte of the results, and that the photographs are unchanged.

    All files are read. Lists damaged and changed files, and the results that a rerun renews. Files that cannot be
    checked are listed.
    The exit code is 9 if a result is damaged, or a photograph or a drawing has changed since the measurement.
    """
    from mammometry.api.sources import sources
    from mammometry.base.errors import MammometryError, SessionError, StorageError
    from mammometry.io.meshes.measured import can_be_opened
    from mammometry.io.results.verify import results_in, shown
    from mammometry.io.results.verify import verify as verified

    results = results_in(session)
    findings = verified(results, None if results == session else session)
    if not findings.files and not findings.damaged:
        remedy = f"Measure it: {command_line('mammometry', 'run', session, *options.words)}"
        raise SessionError(str(session), found="no results yet", expected="results to be checked", remedy=remedy)
    now, refused = None, ""
    if can_be_opened(session):
        try:
            now = sources(session, options.settings(), frozenset(findings.outputs))
        except MammometryError as error:
            refused = shown(str(error))
    renewed, left, remark = _renewed(findings, now, refused)
    changed = () if now is None else now.changed.inputs
    table: dict[str, Any] = {
        "results": str(results),
        **asdict(findings),
        "renewed": renewed,
        "not_renewed": left,
        "changed": list(changed),
        "absent": [] if now is None else list(now.changed.absent),
        "not_compared": [] if now is None else list(now.not_compared),
        "refused": refused,
    }
    lines: list[Any] = [f"{damage.file}: {damage.found}" for damage in findings.damaged]
    lines += [f"A rerun renews {', '.join(renewed)}"] if renewed else []
    lines += [f"A rerun does not renew {', '.join(left)}: {remark}"] if left else []
    lines += [f"{name}: changed since the results were made" for name in changed]
    lines += [f"{name}: missing, not compared" for name in table["absent"]]
    lines += [f"Photographs and drawings cannot be compared. {refused}"] if refused else []
    lines += [f"{results.name}/{name}: left by an interrupted run or set aside" for name in findings.leftovers]
    lines += [f"{name}: not written by mammometry, not checked" for name in findings.unrecorded]
    lines += [f"{name}: not checked, no result was made from it" for name in table["not_compared"]]
    lines += [f"{name}: from an earlier version, its times are not checked" for name in findings.without_digest]
    sums = f"{findings.products} products, {findings.files} files, {findings.bytes / _MB:.0f} MB"
    other = bool(changed or refused)
    lines.append(f"{sums}: {'DAMAGED' if findings.damaged else 'CHANGED' if other else 'all unchanged'}")
    return Answer(table, lines, exit_code=StorageError.exit_code if findings.damaged or other else 0)


def _renewed(findings: Findings, now: Sources | None, refused: str) -> tuple[list[str], list[str], str]:
    """Damaged products that a rerun renews, those that it cannot, and why."""
    damaged = {f"{damage.stage}/{damage.product}": None for damage in findings.damaged if damage.product is not None}
    stages = [damage.stage for damage in findings.damaged if damage.product is None and damage.stage is not None]
    if refused:
        return [], [*damaged, *stages], refused
    wanted = damaged if now is None else now.wanted
    left = [name for name in damaged if name not in wanted]
    return [name for name in damaged if name in wanted] + stages, left, "no longer part of this session"
