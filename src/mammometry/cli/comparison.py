"""The command `compare`: two dates of one patient."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mammometry.cli.common import Answer, Bars, Options, command

if TYPE_CHECKING:
    from mammometry.api.dates import Comparison

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
