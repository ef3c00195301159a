"""The command `figure`: figures of the paper, drawn from a session."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mammometry.cli.common import Answer, Bars, Options, SessionFolder, command
from mammometry.cli.stages import opened

app = typer.Typer()


@command(app, "mammometry figure 5 SESSION", "mammometry figure 7 SESSION --out surface.svg")
def figure(
    options: Options,
    number: Annotated[int, typer.Argument(metavar="N", help="Number of the figure in the paper, 1 to 7.")],
    session: SessionFolder,
    out: Annotated[
        Path | None, typer.Option(help="File to write: .pdf, .svg or .png.", show_default="figure-N.pdf in results/")
    ] = None,
) -> Answer:
    """Draw a figure of the paper from a session, for print.

    Text and lines are vectors, pictures have 300 dpi.
    """
    from mammometry.io.outputs import require_apart, require_free
    from mammometry.report.figures.catalogue import PAPER_FIGURES
    from mammometry.report.figures.paper import FORMATS, write_figure

    if str(number) not in PAPER_FIGURES:
        raise typer.BadParameter(f"N is one of {', '.join(PAPER_FIGURES)}, found {number}")
    if out is not None and out.suffix not in FORMATS:
        raise typer.BadParameter(f"--out ends with one of {', '.join(FORMATS)}, found {out.name}")
    with Bars(options.silent) as bars:
        job = opened(session, options, bars)
        path = out or job.session.results / f"figure-{number}.pdf"
        require_apart(path, [*job.session.brought, options.file])
        require_free(path.parent, [path.name], command="figure")
        job.ensure("surface")
        with bars.task("figure", str(number)):
            write_figure(number, (job.plan, job.inputs, job.settings), path, job.identity.subject)
    return Answer({"figure": str(path)}, [f"Figure {number}: {path}"])
