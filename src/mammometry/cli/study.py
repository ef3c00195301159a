"""Commands `compare`, `evaluate` and `study …`.

Dates, truth, agreement, observers, landmarks and phantoms.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mammometry.cli.batch import SOME_FAILED
from mammometry.cli.common import Answer, Bars, Options, OutputOptions, SessionFolder, command

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mammometry.api.dates import Comparison
    from mammometry.api.truth import PhantomResult
    from mammometry.base.progress import MapTasks
    from mammometry.study.agreement import Agreement, CheckedFigure, PairedMeasurements
    from mammometry.study.tables import TextTable


dates_app = typer.Typer()


@command(dates_app, "mammometry compare BEFORE AFTER", "mammometry compare BEFORE AFTER --deidentify --out for-others")
def compare(
    options: Options,
    before: Annotated[Path, typer.Argument(metavar="BEFORE", help="The earlier session.", show_default=False)],
    after: Annotated[Path, typer.Argument(metavar="AFTER", help="The later session.", show_default=False)],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Folder for the page.", show_default="AFTER/results/compare/BEFORE"),
    ] = None,
    deidentify: Annotated[
        bool, typer.Option("--deidentify", help="For others: no names, no dates, no colours above the sternal notch.")
    ] = False,
    geometry_only: Annotated[
        bool, typer.Option("--geometry-only", help="For others: no photographic colours.")
    ] = False,
) -> Answer:
    """Compare two dates of one patient on one page.

    The page shows the change of volume with its interval and verdict, a map of the change, and the lengths.
    """
    from mammometry.api.dates import compare as compare_sessions
    from mammometry.io.outputs import require_apart
    from mammometry.report.privacy import Privacy

    chosen = options.settings()
    if out is not None:
        require_apart(out, [options.file])
    with Bars(options.silent) as bars:
        watches = tuple(bars.watch_as(number) for number in (1, 2))
        with bars.task("compare", "") as progress:
            comparison = compare_sessions(
                before,
                after,
                chosen,
                out=out,
                privacy=Privacy(deidentify=deidentify, geometry_only=geometry_only),
                watches=(watches[0], watches[1]),
                progress=progress,
            )
    table = {
        "before": str(comparison.before),
        "after": str(comparison.after),
        "page": str(comparison.page),
        **comparison.table,
    }
    return Answer(table, _lines(comparison))


def _lines(comparison: Comparison) -> list[Any]:
    from mammometry.base.notices.words import lines_of

    lines: list[Any] = lines_of(comparison.notices)
    lines += [breast["verdict"] for breast in comparison.table["breasts"].values()]
    fit = comparison.change.fit
    lines.append(f"80 % of the trunk fits within {fit.within_mm:.1f} mm. The posture differs by {fit.turned_deg:.0f}°.")
    return [*lines, f"Page: {comparison.page}"]


_IN_WORDS = ("meaning", "remark")


@command(dates_app, "mammometry evaluate SESSION", "mammometry evaluate SESSION --truth ELSEWHERE/truth --json")
def evaluate(
    options: Options,
    session: SessionFolder,
    truth: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Folder of the truth. Without it, SESSION/truth.", show_default=False),
    ] = None,
) -> Answer:
    """Compare the results of a virtual session with its truth.

    Every stage is compared. Writes SESSION/evaluation.
    """
    from mammometry.api.job import open_session
    from mammometry.api.truth import evaluate_session
    from mammometry.study.evaluation_tables import evaluation_tables

    job = open_session(session, options.settings())
    with Bars(options.silent) as bars, bars.task("evaluate", "results against truth") as progress:
        differences, folder = evaluate_session(job, truth, progress=progress)
    table = {"session": str(session), "evaluation": str(folder), **differences.as_table()}
    lines: list[Any] = [part for shown in evaluation_tables(differences) for part in (*table_lines(shown), "")]
    return Answer(table, [*lines, f"World and truth were aligned by {differences.frame}.", f"Evaluation: {folder}"])


def table_lines(table: TextTable) -> list[Any]:
    """A table with a title for the terminal. Columns of text are only on the page."""
    from rich.table import Table as RichTable

    shown = RichTable(box=None, pad_edge=False)
    kept = [index for index, name in enumerate(table.columns) if name not in _IN_WORDS]
    for index in kept:
        shown.add_column(table.columns[index], justify="left" if index == 0 else "right")
    for row in table.rows:
        shown.add_row(*(row[index] for index in kept))
    return [table.title, shown]


app = typer.Typer(name="study", help="Studies of accuracy: two methods, several observers, and nine virtual models.")
_OUT = Path("agreement")
_CAMERAS = 8  # of the reference rig
_LEAST_SCALE = 0.15  # with the eight poses of the study; at 0.12 its calibration was refused


@command(
    app,
    "mammometry study agreement",
    "mammometry study agreement table.csv --reference water_cc --measured imaging_cc --out agreement",
)
def agreement(
    options: OutputOptions,
    table: Annotated[
        Path | None,
        typer.Argument(
            metavar="[TABLE.csv]",
            help="One row per pair of measurements. Without it, Table 1 of the paper.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Folder for the report, its figures and its numbers.")
    ] = _OUT,
    reference: Annotated[str, typer.Option(metavar="COLUMN", help="Column of the reference method.")] = "reference_cc",
    measured: Annotated[str, typer.Option(metavar="COLUMN", help="Column of the method under test.")] = "measured_cc",
    published: Annotated[
        Path | None, typer.Option(metavar="FILE.toml", help="Published figures to check.", show_default=False)
    ] = None,
) -> Answer:
    """Compare two methods of measurement on the same subjects.

    Gives bias, limits of agreement, intraclass correlation and minimal detectable change.
    """
    from mammometry.base.identity import shown_name
    from mammometry.io.outputs import require_apart, require_free, write_outputs
    from mammometry.io.paired_tables import read_pairs, read_published
    from mammometry.report.documents.study_pages import FILES, agreement_files
    from mammometry.study.agreement import agreement as agree
    from mammometry.study.agreement import check_published

    require_apart(out, [table, published])
    require_free(out, FILES, command="study agreement")
    if table is None:
        paper = files("mammometry.study").joinpath("paper")
        with as_file(paper.joinpath("table_1.csv")) as path, as_file(paper.joinpath("published.toml")) as figures:
            data = read_pairs(path, reference="water_cc", measured="imaging_cc")
            stated = read_published(published or figures)
        title = "Table 1: nine plaster models, water displacement and 3D imaging"
    else:
        data = read_pairs(table, reference=reference, measured=measured)
        stated = () if published is None else read_published(published)
        title = shown_name(table.with_suffix(""))
    study_figures = agree(data)
    try:
        checked = check_published(study_figures, stated)
    except ValueError as error:
        raise typer.BadParameter(f"--published: {error}") from None
    with Bars(options.silent) as bars, bars.task("agreement", "figures"):
        write_outputs(out, agreement_files(title, data, study_figures, checked), command="study agreement")
    return _answer(out, data, study_figures, checked)


@command(
    app,
    "mammometry study observers curves --mesh front.ply --units mm",
    "mammometry study observers table.csv --units mm --out observers",
)
def observers(
    options: Options,
    curves: Annotated[
        Path,
        typer.Argument(
            metavar="CURVES",
            help="Folder of boundary files such as anna-1.json, or a CSV with mesh, boundary, observer and repeat.",
            show_default=False,
        ),
    ],
    mesh: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The surface that they were drawn on.", show_default=False)
    ] = None,
    out: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Folder for the report, its figures and its numbers.")
    ] = Path("observers"),
    units: Annotated[
        str | None, typer.Option(metavar="UNIT", help="Unit of the meshes: mm, cm, m, in or ft.", show_default=False)
    ] = None,
    head: Annotated[
        str | None, typer.Option(metavar="AXIS", help="The meshes' axis towards the head.", show_default=False)
    ] = None,
    ahead: Annotated[
        str | None, typer.Option(metavar="AXIS", help="The meshes' axis straight ahead.", show_default=False)
    ] = None,
) -> Answer:
    """Compare boundaries drawn by several people, or several times by one.

    Gives the standard deviation of the volume, its intraclass correlation and minimal detectable change, and the
    distance between curves by region.
    """
    from mammometry.api.observers import measure_drawings, read_drawn_by
    from mammometry.base.identity import shown_name
    from mammometry.io.outputs import require_apart, require_free, write_outputs
    from mammometry.report.documents.study_pages import observers_files, observers_names
    from mammometry.study.observers import observer_study
    from mammometry.study.observers_tables import observers_json, observers_summary, observers_tables

    chosen = options.settings()
    drawn = read_drawn_by(curves, mesh)
    meshes = tuple(dict.fromkeys(drawing.mesh for drawing in drawn))
    require_apart(out, [curves, options.file, *meshes, *(drawing.boundary for drawing in drawn)])
    require_free(out, observers_names(len(meshes)), command="study observers")
    with Bars(options.silent) as bars:
        with bars.task("observers", "drawings") as progress:
            measured = measure_drawings(
                drawn, units=units, head=head, ahead=ahead, settings=chosen.measure, progress=progress
            )
        try:
            study = observer_study(measured.drawings)
        except ValueError as error:
            raise typer.BadParameter(f"CURVES: {error}") from None
        title = f"{shown_name(curves.with_suffix(''))}: {len(measured.drawings)} curves"
        with bars.task("report", "figures"):
            files = observers_files(title, measured.surfaces, measured.drawings, study)
            write_outputs(out, files, command="study observers")
    page = out / "report.html"
    lines: list[Any] = [*observers_summary(study), ""]
    lines += [part for table in observers_tables(study, measured.drawings) for part in (*table_lines(table), "")]
    return Answer({"report": str(page), **observers_json(study, measured.drawings)}, [*lines, f"Report: {page}"])


@command(
    app, "mammometry study landmarks FOUND.json TRUTH.json", "mammometry study landmarks FOUND.json TRUTH.json --json"
)
def landmarks(
    options: OutputOptions,
    output: Annotated[
        Path,
        typer.Argument(metavar="FOUND.json", help="What a program found: woman, name, place.", show_default=False),
    ],
    truth: Annotated[
        Path, typer.Argument(metavar="TRUTH.json", help="Truth file of the benchmark's meshes.", show_default=False)
    ],
) -> Answer:
    """Score any program's landmarks and borders on the benchmark's meshes.

    Gives for each landmark and kind of input how many were found, and the errors in mm.
    """
    from mammometry.io.truth import read_found_landmarks, read_true_landmarks
    from mammometry.study.landmarks import score_tables, scores, scores_json

    found = scores(read_found_landmarks(output), read_true_landmarks(truth))
    return Answer(scores_json(found), [part for table in score_tables(found) for part in (*table_lines(table), "")])


@command(app, "mammometry study phantoms OUT", "mammometry study phantoms OUT --scale 0.5 --seed 3 --json")
def phantoms(
    options: Options,
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder of the study.", show_default=False)],
    scale: Annotated[
        float,
        typer.Option(
            help="Image size as a share of 4504 × 3000 pixels. Smaller pictures do not calibrate the rig.",
            min=_LEAST_SCALE,
            max=2.0,
        ),
    ] = 0.25,
    seed: Annotated[
        int, typer.Option(help="Seed of the rig, its calibration and the shapes of the models.", min=0)
    ] = 1,
) -> Answer:
    """Measure nine virtual plaster models and compare with their exact volumes.

    An interrupted study continues where it stopped. A refused model is listed, and the exit code is then 11.
    """
    from mammometry.api.truth import MODELS, as_csv, measure_phantoms, paired
    from mammometry.io.outputs import require_apart, require_free, write_outputs
    from mammometry.report.documents.study_pages import FILES, agreement_files
    from mammometry.study.agreement import agreement as agree

    chosen = options.settings()
    require_apart(out, [options.file])
    require_free(out / "report", (*FILES, "table.csv"), command="study phantoms")
    with Bars(options.silent) as bars, _tasks_side_by_side(bars, len(MODELS), scale) as map_tasks:
        results = measure_phantoms(out, scale=scale, seed=seed, settings=chosen, map_tasks=map_tasks)
    data = paired(results)
    figures = agree(data)
    intervals = interval_table(results)
    failed = {result.name: result.failed for result in results if result.failed}
    remark = (
        "These are virtual models, photographed by our own renderer. A real rig is harder: boards bend, cameras move, "
        "and there is stray light. The sessions give the rim radius of the models as 0 mm. The paper measured nine "
        "plaster models: 11.12 ± 23.23 cc, slope 0.078."
    )
    refusals = [f"{name} was not measured: {sentence}" for name, sentence in failed.items()]
    written = agreement_files(
        "Nine virtual plaster models", data, figures, more=(intervals,), remarks=(*refusals, remark)
    )
    written |= {"table.csv": as_csv(results).encode()}
    write_outputs(out / "report", written, command="study phantoms")
    answer = _answer(out / "report", data, figures, (), intervals)
    code = SOME_FAILED if failed else 0
    return Answer({**answer.table, "failed": failed}, [*answer.lines, *refusals], exit_code=code)


@contextmanager
def _tasks_side_by_side(bars: Bars, count: int, scale: float) -> Iterator[MapTasks]:
    """Measure on all cores, each model in its own process. The workers start with the first model."""
    from mammometry.batch.batch import map_tasks_on
    from mammometry.batch.cluster import machines
    from mammometry.batch.engine import Began, Ended
    from mammometry.simulate.rigs.build import FULL_SIZE_WH

    width, height = FULL_SIZE_WH
    megapixels, done = _CAMERAS * width * height * scale**2 / 1e6, Counter[str]()
    with ExitStack() as stack, bars.task("study", "models") as progress:

        def watch(event: Began | Ended) -> None:
            done["models"] += isinstance(event, Ended)
            progress(done["models"] / count)

        @cache
        def loop() -> MapTasks:
            return map_tasks_on(stack.enter_context(machines(None)), megapixels=megapixels, watch=watch)

        yield lambda function, arguments: loop()(function, arguments)


def interval_table(results: Sequence[PhantomResult]) -> TextTable:
    """Interval of each model, and whether it contains the true volume."""
    from mammometry.study.tables import TextTable, number

    return TextTable(
        title="Intervals of single measurements",
        columns=("model", "true cc", "95 % interval cc", "contains the truth"),
        rows=tuple(
            (
                result.name,
                number(result.true_cc, ".1f"),
                "–" if result.interval_cc is None else " … ".join(number(bound, ".1f") for bound in result.interval_cc),
                "not measured" if result.failed else {True: "yes", False: "no", None: "–"}[result.holds],
            )
            for result in results
        ),
    )


def _answer(
    folder: Path, data: PairedMeasurements, figures: Agreement, checked: Sequence[CheckedFigure], *more: TextTable
) -> Answer:
    from mammometry.base.notices.words import lines_of
    from mammometry.report.documents.study_pages import study_json
    from mammometry.study.agreement_tables import agreement_tables, summary

    tables = (*agreement_tables(data, figures, checked), *more)
    lines: list[Any] = [*lines_of(data.notices), *summary(data, figures), ""]
    lines += [part for table in tables for part in (*table_lines(table), "")]
    page = folder / "report.html"
    return Answer({"report": str(page), **study_json(data, figures, checked)}, [*lines, f"Report: {page}"])
