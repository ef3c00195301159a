"""Compare a session's results with its truth. Only this module and studies may read both."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from mammometry.base.errors import SessionError
from mammometry.base.progress import Progress, no_progress, part
from mammometry.io.outputs import require_apart, require_free, write_outputs
from mammometry.io.results.stamp import stamped
from mammometry.io.truth import read_truth
from mammometry.job.stages import calibrate, match, measure, surface
from mammometry.study.evaluation import Evaluation, SessionResults, evaluate
from mammometry.study.evaluation_tables import evaluation_tables

if TYPE_CHECKING:
    from mammometry.api.job import Job
    from mammometry.job.products import Product

FOLDER = "evaluation"
FILES = ("evaluation.json", "evaluation.md", "error-map.png")
T = TypeVar("T")


def evaluate_session(
    job: Job, truth_folder: Path | None = None, *, progress: Progress = no_progress
) -> tuple[Evaluation, Path]:
    """Compare a session's current results with its truth.

    The comparison is written to ``SESSION/evaluation/``. Nothing is computed that is not there: stages without current
    results are left out.

    Args:
        job: the session, with the settings its results were made with.
        truth_folder: the truth; None for the session's own ``truth/``.
        progress: called with the fraction done.

    Returns:
        The evaluation, and the folder with evaluation.json, evaluation.md and error-map.png.

    Raises:
        SessionError: there is no truth, there are no results, or they are results of another rig or subject.
        StorageError: the evaluation cannot be written, or somebody else's file is in its way.
    """
    folder = job.session.path / FOLDER
    truth_folder = truth_folder or job.session.path / "truth"
    require_apart(folder, [truth_folder])
    require_free(folder, FILES, command="evaluate")
    truth = read_truth(truth_folder, job.inputs.pair_names)
    results = current_results(job)
    found = evaluate(results, truth, progress=part(progress, 0.0, 0.95))
    tables = evaluation_tables(found)
    files: dict[str, bytes] = {
        "evaluation.json": (json.dumps(found.as_table(), indent=1, ensure_ascii=False) + "\n").encode(),
        "evaluation.md": "\n".join(table.as_markdown() for table in tables).encode(),
    }
    if found.error_map is not None:
        from mammometry.report.figures.studies.accuracy import error_map

        mesh = list(results.surfaces.values())[-1]
        body = job.plan.current(measure.body)
        left = None if body is None else body.left
        files["error-map.png"] = error_map(results.rig, mesh, found.error_map, patient_left_world=left)
    subject = job.identity.subject
    files = {name: stamped(name, data, subject) for name, data in files.items()}
    write_outputs(folder, files, command="evaluate")
    progress(1.0)
    return found, folder


def current_results(job: Job) -> SessionResults:
    """Load what of a session's results is there and current.

    Raises:
        SessionError: there are no cameras yet.
    """
    plan = job.plan

    def all_current(products: Mapping[str, Product[T]]) -> dict[str, Callable[[], T]]:
        return {name: product.uncached for name, product in products.items() if not product.missing}

    cameras = plan.current(calibrate.cameras)
    if cameras is None:
        found = {"stale": "results of other photographs or settings", "damaged": "results that were changed since"}
        raise SessionError(
            str(job.session.path),
            found=found.get(job.store.state(plan[calibrate.cameras].key), "no results"),
            expected="a session that was measured, with these settings",
            remedy="Run `mammometry run` on it first, and give the same --set and --settings here",
        )
    calibration, repaired = plan.current(calibrate.calibration), plan.current(surface.repaired)
    first = plan.current(surface.initial_surface)
    surfaces = {"first": first, "repaired": None if repaired is None else repaired.mesh}
    return SessionResults(
        rig=cameras.rig,
        world_from_target={} if calibration is None else calibration.world_from_target,
        foregrounds=all_current(plan[match.foreground]),
        disparities=all_current(plan[match.disparity]),
        ranges=all_current(plan[surface.range_image]),
        surfaces={name: mesh for name, mesh in surfaces.items() if mesh is not None},
        claimed=None if repaired is None else repaired.claimed,
        boundaries=plan.current(measure.boundaries) or (),
        measurements=plan.current(measure.measurements) or (),
        absent=tuple(side.name for side in plan.current(measure.absent) or ()),
    )
