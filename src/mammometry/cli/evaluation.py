"""The command `evaluate`: results of a virtual session against its truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mammometry.cli.common import Answer, Bars, Options, SessionFolder, command

if TYPE_CHECKING:
    from mammometry.study.tables import Table

app = typer.Typer()
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
    from mammometry.study.evaluation_tables import evaluation_tables

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
