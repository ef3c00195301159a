"""Comparison of results with the truth of virtual sessions and plaster models (paper 2.7, Table 1)."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from mammometry.api.job import open_session
from mammometry.base.csv_cells import csv_text
from mammometry.base.errors import CalibrationError, MammometryError, MeasureError, SessionError
from mammometry.base.progress import MapTasks, Progress, StageProgress, map_in_sequence, no_progress, part
from mammometry.io.outputs import require_apart, require_free, write_outputs
from mammometry.io.results.stamp import stamped
from mammometry.io.truth import read_truth, read_volumes
from mammometry.io.write import write_text
from mammometry.job.stages import calibrate, match, measure, surface
from mammometry.settings import Settings
from mammometry.simulate.recipe import SessionRecipe
from mammometry.simulate.session import write_session
from mammometry.study.agreement import LEAST_SUBJECTS, PairedMeasurements
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
    """Errors of a session's current results, also written to ``SESSION/evaluation/``.

    Args:
        job: the session, with the settings of its results.
        truth_folder: the truth; None for the session's own ``truth/``.
        progress: called with the fraction done.

    Returns:
        The evaluation, and the folder with evaluation.json, evaluation.md and error-map.png.

    Raises:
        SessionError: there is no truth, there are no results, or they are of another rig or subject.
        StorageError: the evaluation cannot be written, or a foreign file is in its place.
    """
    folder = job.session.path / FOLDER
    truth_folder = truth_folder or job.session.path / "truth"
    require_apart(folder, [truth_folder])
    require_free(folder, FILES, command="evaluate")
    truth = read_truth(truth_folder, job.inputs.pair_names)
    results = current_results(job)
    differences = evaluate(results, truth, progress=part(progress, 0.0, 0.95))
    tables = evaluation_tables(differences)
    files: dict[str, bytes] = {
        "evaluation.json": (json.dumps(differences.as_table(), indent=1, ensure_ascii=False) + "\n").encode(),
        "evaluation.md": "\n".join(table.as_markdown() for table in tables).encode(),
    }
    if differences.error_map is not None:
        from mammometry.report.figures.surface import error_map

        mesh = list(results.surfaces.values())[-1]
        body = job.plan.current(measure.body)
        left = None if body is None else body.left
        files["error-map.png"] = error_map(results.rig, mesh, differences.error_map, patient_left_world=left)
    subject = job.identity.subject
    files = {name: stamped(name, data, subject) for name, data in files.items()}
    write_outputs(folder, files, command="evaluate")
    progress(1.0)
    return differences, folder


def current_results(job: Job) -> SessionResults:
    """A session's current results.

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


MODELS = tuple(f"plaster_{number}" for number in range(1, 10))
"""Models with volumes within 3 % of the paper's Table 1. Those with even numbers have a curved back."""
_RECORD = "study.json"


@dataclass(frozen=True, slots=True, kw_only=True)
class PhantomResult:
    """A plaster model's measured and exact volume."""

    name: str
    true_cc: float
    measured_cc: float | None
    """Measured volume, cc. None if it was refused."""
    interval_cc: tuple[float, float] | None
    """95 % interval, cc."""
    failed: str = ""
    """Reason of the refusal, one sentence."""

    @property
    def holds(self) -> bool | None:
        """Whether the interval contains the true volume. None without an interval."""
        return None if self.interval_cc is None else self.interval_cc[0] <= self.true_cc <= self.interval_cc[1]


def measure_phantoms(
    out: Path,
    *,
    scale: float = 0.25,
    seed: int = 1,
    models: tuple[str, ...] = MODELS,
    settings: Settings | None = None,
    map_tasks: MapTasks = map_in_sequence,
) -> tuple[PhantomResult, ...]:
    """Results of all models, simulated, calibrated and measured unless they exist.

    The study continues after a refused model, and ends after a refused calibration, because all models share it.

    Args:
        out: folder of the study, with one session per model.
        scale: size of the photographs relative to the reference rig's 4504 × 3000 pixels.
        seed: seed of the rig, its calibration poses and the models' shapes.
        models: names of the models; the first one's calibration is used for all.
        settings: settings of all stages; None for the recommended ones.
        map_tasks: how the models are distributed to processes.

    Raises:
        SessionError: the folder contains a study with another scale or seed, or other files.
        CalibrationError: the photographs of the target do not calibrate the rig.
        MammometryError: a process cannot be started, or ended.
    """
    _take(out, {"scale": scale, "seed": seed})
    text = (settings or Settings()).to_toml()
    arguments = {
        model: (out / model, SessionRecipe(subject=model, scale=scale, seed=seed), text, out / models[0])
        for model in models
    }
    results: dict[str, Any] = {}
    for some in (models[:1], models[1:]):
        results |= map_tasks(measure_model, {model: arguments[model] for model in some})
        for refused in (results[model].get("uncalibrated") for model in some):
            if refused is not None:
                remedy = "Choose a larger --scale, or another --seed"
                raise CalibrationError(f"{out}: {refused['subject']}", **{**refused["parts"], "remedy": remedy})
    return tuple(
        PhantomResult(
            name=model,
            true_cc=results[model]["true_cc"],
            measured_cc=results[model].get("measured_cc"),
            interval_cc=tuple(interval) if (interval := results[model].get("interval_cc")) is not None else None,
            failed=results[model].get("failed", ""),
        )
        for model in models
    )


def measure_model(
    progress: StageProgress, session: Path, recipe: SessionRecipe, settings: str, first: Path
) -> dict[str, Any]:
    """Result of one model, simulated unless it exists.

    Args:
        progress: called with the stage and its fraction done.
        session: folder of this model.
        recipe: recipe of its photographs.
        settings: settings of all stages, TOML.
        first: session whose calibration is copied if its photographs of the target are the same.

    Returns:
        ``true_cc``, and ``measured_cc`` and ``interval_cc``, or ``failed`` with the refusal as text, or
        ``uncalibrated`` with the parts of the refusal.

    Raises:
        MammometryError: the session cannot be made.
    """
    if not (session / "session.toml").is_file():
        write_session(session, recipe, progress=lambda fraction: progress("simulate", fraction))
    _share_calibration(first, session)
    progress("measure", 0.0)
    true_cc = read_volumes(session / "truth")["model"]
    try:
        measured = open_session(session, Settings.from_toml(settings)).run(report=False).measurements["model"]
    except CalibrationError as error:
        parts = {"found": error.found, "expected": error.expected}
        return {"true_cc": true_cc, "uncalibrated": {"subject": error.subject, "parts": parts}}
    except MammometryError as error:
        return {"true_cc": true_cc, "failed": str(error)}
    return {"true_cc": true_cc, "measured_cc": measured.volume_cc, "interval_cc": measured.interval_cc}


def paired(results: Sequence[PhantomResult]) -> PairedMeasurements:
    """The measured results for an agreement study, with the exact volume, cc, as reference.

    Raises:
        MeasureError: fewer than three were measured.
    """
    refused = [result for result in results if result.measured_cc is None]
    results = [result for result in results if result.measured_cc is not None]
    if len(results) < LEAST_SUBJECTS:
        raise MeasureError(
            refused[0].name if refused else "the study",
            found=f"{len(results)} measured models, since {refused[0].failed.rstrip('.')}" if refused else "no models",
            expected=f"{LEAST_SUBJECTS} or more",
            remedy="Choose a larger --scale, or another --seed",
        )
    return PairedMeasurements(
        names=tuple(result.name for result in results),
        reference=np.array([result.true_cc for result in results]),
        measured=np.array([result.measured_cc for result in results], dtype=np.float64),
        reference_name="exact volume",
        measured_name="photographs",
        unit="cc",
    )


def as_csv(results: Sequence[PhantomResult]) -> str:
    """CSV table of the measured results for `mammometry study agreement`."""
    rows = []
    for result in results:
        if result.measured_cc is None:
            continue
        low, high = ("", "") if result.interval_cc is None else (f"{bound:.4f}" for bound in result.interval_cc)
        rows.append((result.name, f"{result.true_cc:.4f}", f"{result.measured_cc:.4f}", low, high))
    return csv_text(("model", "reference_cc", "measured_cc", "low_cc", "high_cc"), rows)


def _take(out: Path, wanted: dict[str, float]) -> None:
    """Use the folder for a new study, or continue its study."""
    record = out / _RECORD
    if record.is_file():
        try:
            volumes = {
                str(name): float(value) for name, value in json.loads(record.read_text(encoding="utf-8")).items()
            }
        except (ValueError, TypeError, AttributeError, OverflowError, RecursionError):
            volumes = {}
        if volumes != wanted:
            raise SessionError(
                str(out),
                found=f"a study with {_worded(volumes)}" if volumes else f"a {_RECORD} of something else",
                expected=_worded(wanted),
                remedy="Continue with those, or choose another folder",
            )
        return
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        expected = "a new folder, or one of an earlier run of this study"
        raise SessionError(str(out), found="something else there", expected=expected, remedy="Choose another folder")
    out.mkdir(parents=True, exist_ok=True)
    write_text(record, json.dumps(wanted) + "\n")


def _worded(values: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:g}" for name, value in values.items())


def _share_calibration(first: Path, session: Path) -> None:
    """Copy the first session's calibration, which is used only if the photographs are the same."""
    made, wanted = first / "results" / "calibrate", session / "results" / "calibrate"
    if session == first or wanted.exists() or not made.is_dir():
        return
    wanted.parent.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".handed-on-", dir=wanted.parent) as folder:
        shutil.copytree(made, Path(folder) / wanted.name).rename(wanted)
