"""Comparisons: two dates of one patient, and results with the truth of a virtual session."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mammometry.cli.common import Answer, Bars, Options, command

if TYPE_CHECKING:
    from mammometry.api.dates import Comparison


from typing import TYPE_CHECKING

from mammometry.cli.common import SessionFolder

if TYPE_CHECKING:
    from mammometry.study.tables import Table


app = typer.Typer()


@command(app, "mammometry compare BEFORE AFTER", "mammometry compare BEFORE AFTER --deidentify --out for-others")
def compare(
    options: Options,
    before: Annotated[Path, typer.Argument(metavar="BEFORE", help="The earlier session.", show_default=False)],
    after: Annotated[Path, typer.Argument(metavar="AFTER", help="The later session.", show_default=False)],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Folder for the page.", show_default="AFTER/results/compare/BEFORE"),
    ] = None,
    deidentify: Annotated[
        bool,
        typer.Option("--deidentify", help="For others: no names, no dates, no colours above the sternal notch."),
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
            found = compare_sessions(
                before,
                after,
                chosen,
                out=out,
                privacy=Privacy(deidentify=deidentify, geometry_only=geometry_only),
                watches=(watches[0], watches[1]),
                progress=progress,
            )
    table = {"before": str(found.before), "after": str(found.after), "page": str(found.page), **found.table}
    return Answer(table, _lines(found))


def _lines(found: Comparison) -> list[Any]:
    lines: list[Any] = [f"Warning: {warning}" for warning in found.warnings]
    lines += [breast["verdict"] for breast in found.table["breasts"].values()]
    fit = found.change.fit
    lines.append(f"80 % of the trunk fits within {fit.within_mm:.1f} mm. The lean differs by {fit.turned_deg:.0f}°.")
    return [*lines, *found.remarks, f"Page: {found.page}"]


_IN_WORDS = ("meaning", "remark")


@command(app, "mammometry evaluate SESSION", "mammometry evaluate SESSION --truth ELSEWHERE/truth --json")
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
    from mammometry.study.evaluation import evaluation_tables

    job = open_session(session, options.settings())
    with Bars(options.silent) as bars, bars.task("evaluate", "results against truth") as progress:
        found, folder = evaluate_session(job, truth, progress=progress)
    table = {"session": str(session), "evaluation": str(folder), **found.as_table()}
    lines: list[Any] = [part for shown in evaluation_tables(found) for part in (*table_lines(shown), "")]
    return Answer(table, [*lines, f"World and truth were aligned by {found.frame}.", f"Evaluation: {folder}"])


def table_lines(table: Table) -> list[Any]:
    """A table for the terminal, under its title. Columns of words are left to the page."""
    from rich.table import Table as RichTable

    shown = RichTable(box=None, pad_edge=False)
    kept = [index for index, name in enumerate(table.columns) if name not in _IN_WORDS]
    for index in kept:
        shown.add_column(table.columns[index], justify="left" if index == 0 else "right")
    for row in table.rows:
        shown.add_row(*(row[index] for index in kept))
    return [table.title, shown]
