"""The commands `figure` and `graph`: figures of the paper, and what a session's results are made from."""

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


@command(app, "mammometry graph SESSION", "mammometry graph SESSION --out products.svg")
def graph(
    options: Options,
    session: SessionFolder,
    out: Annotated[
        Path | None, typer.Option(help="SVG file to write.", show_default="products.svg in results/")
    ] = None,
) -> Answer:
    """Draw what each result is made from, whether it is current, and how long it took.

    Nothing is computed. All result files are read, which takes a second or two per gigabyte.
    """
    from mammometry.api.job import open_session
    from mammometry.io.outputs import require_apart, write_output
    from mammometry.report.figures.product_graph import Known, product_graph

    if out is not None and out.suffix != ".svg":
        raise typer.BadParameter(f"--out ends with .svg, found {out.name}")
    job = open_session(session, options.settings())
    path = out or job.session.results / "products.svg"
    require_apart(path, [*job.session.brought, options.file])
    keys = [product.key for product in job.plan.products()]
    known = {}
    for key, state in zip(keys, job.store.states(keys), strict=True):
        record = job.store.record(key)
        known[f"{key.stage}/{key.product}"] = Known(state=state, seconds=None if record is None else record.seconds)
    write_output(path, product_graph(job.plan, known, job.identity.subject).encode(), command="graph")
    return Answer({"graph": str(path)}, [f"Graph: {path}"])
