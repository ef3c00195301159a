"""Commands `study repeatability` and `study validation`: proof in a clinic."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from mammometry.base.errors import TableError
from mammometry.cli.common import Answer, Bars, Options, command
from mammometry.cli.study import table_lines

app = typer.Typer()  # `main` adds its commands to those of `study`
_COMMAND = "study repeatability"
SEM_CC = 6.0
"""Standard error that a plan expects where none is given, cc."""


@command(
    app,
    "mammometry study repeatability table.csv",
    "mammometry study repeatability WOMEN --claim 25cc --out repeatability",
    "mammometry study repeatability --plan 25cc --sem 6cc",
)
def repeatability(
    options: Options,
    source: Annotated[
        Path | None,
        typer.Argument(
            metavar="[TABLE.csv]",
            help="One row per capture; or a folder WOMAN/CAPTURE or WOMAN/RATER/CAPTURE of sessions or scans.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Folder for the report, its figures and its numbers.")
    ] = Path("repeatability"),
    measured: Annotated[
        str | None,
        typer.Option(metavar="COLUMN", help="Column of volumes.", show_default="volume_cc, or left_cc and right_cc"),
    ] = None,
    levels: Annotated[
        str,
        typer.Option(
            metavar="NAMES", help="What each level of folders names, such as woman,day,capture.", show_default=False
        ),
    ] = "",
    claim: Annotated[
        str, typer.Option(metavar="VOLUME", help="Detectable change to be shown, such as 25cc.", show_default=False)
    ] = "",
    plan: Annotated[
        str,
        typer.Option(metavar="VOLUME", help="Only plan: how many women for this claim.", show_default=False),
    ] = "",
    sem: Annotated[str, typer.Option(metavar="VOLUME", help="Standard error that the plan expects.")] = f"{SEM_CC:g}cc",
) -> Answer:
    """Analyse repeated captures: how large a change of volume is real.

    Gives the components of variance, the standard error of measurement, the smallest detectable change, intraclass
    correlations, limits of agreement, and a claim sheet.
    """  # fmt: skip
    if plan:
        return _planned(_cc(plan, "--plan"), _cc(sem, "--sem"))
    if source is None:
        raise typer.BadParameter("TABLE.csv or a folder is missing; --plan 25cc plans a study")
    if levels and not source.is_dir():
        raise typer.BadParameter("--levels names levels of folders: give a folder")
    if measured and source.is_dir():
        raise typer.BadParameter("--measured names a column: give a table")
    from mammometry.api.repeatability import read_captures
    from mammometry.base.identity import shown_name
    from mammometry.io.outputs import require_apart, require_free, write_outputs
    from mammometry.report.documents.repeatability_page import FILES, repeatability_files
    from mammometry.study.repeatability.plan import check_claim
    from mammometry.study.repeatability.study import repeatability as analyse
    from mammometry.study.repeatability.tables import (
        repeatability_json,
        repeatability_summary,
        repeatability_tables,
    )

    claim_cc = _cc(claim, "--claim") if claim else None
    require_apart(out, [source, options.file])
    require_free(out, FILES, command=_COMMAND)
    with Bars(options.silent) as bars, bars.task("repeatability", "captures") as progress:
        readings = read_captures(
            source, options.settings(), measured=measured, levels=levels.split(",") if levels else (), progress=progress
        )
        try:
            found = analyse(readings)
        except ValueError as error:
            raise TableError(
                str(source),
                found=str(error),
                expected="three or more women, two or more captures of each by one person with one device, each once",
                remedy="Add captures, or correct the columns that name woman, rater, device, day and capture",
            ) from None
        narrowest = found.repetitions[0]
        checked = None if claim_cc is None else check_claim(claim_cc, narrowest.sem_cc.value, narrowest.df)
        title = shown_name(source.with_suffix("") if source.suffix == ".csv" else source)
        write_outputs(out, repeatability_files(title, readings, found, checked), command=_COMMAND)
    lines: list[Any] = [*repeatability_summary(found, checked), ""]
    for table in repeatability_tables(found):
        lines += [*table_lines(table), ""]
    page = out / "report.html"
    return Answer({"report": str(page), **repeatability_json(found, checked)}, [*lines, f"Report: {page}"])


_TRUTH = "study validation"


@command(
    app,
    "mammometry study validation --template water --out specimens",
    "mammometry study validation specimens/water.csv --sem 6cc",
    "mammometry study validation table.csv --truth weight --out validation",
)
def validation(
    options: Options,
    table: Annotated[
        Path | None,
        typer.Argument(metavar="[TABLE.csv]", help="One row per breast, with its truth.", show_default=False),
    ] = None,
    out: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Folder for the report, its figures and its numbers.")
    ] = Path("validation"),
    truth: Annotated[
        str | None,
        typer.Option(help="Kind of truth: water, weight, segmentation or volume.", show_default="by the columns"),
    ] = None,
    template: Annotated[
        str | None,
        typer.Option(metavar="TRUTH", help="Only write an example of a table for a kind of truth.", show_default=False),
    ] = None,
    sem: Annotated[
        str,
        typer.Option(
            metavar="VOLUME", help="Standard error from your study of repeatability, such as 6cc.", show_default=False
        ),
    ] = "",
) -> Answer:
    """Compare measured volumes with a truth: specimens in water or on a scale, segmentations.

    Gives bias, limits of agreement and proportional bias for every definition of the volume, and the offsets between
    the definitions.
    """  # fmt: skip
    from mammometry.io.outputs import require_apart, require_free, write_outputs
    from mammometry.io.truth_tables import KINDS
    from mammometry.io.truth_tables import template as example

    for option, kind in (("--truth", truth), ("--template", template)):
        if kind is not None and kind not in KINDS:
            raise typer.BadParameter(f"{option}: one of {', '.join(KINDS)}")
    if template is not None:
        name, writer = f"{template}.csv", f"{_TRUTH} --template {template}"
        require_free(out, [name], command=writer)
        write_outputs(out, {name: example(template).encode()}, command=writer)
        return Answer({"table": str(out / name)}, [f"Table: {out / name}"])
    if table is None:
        raise typer.BadParameter("TABLE.csv is missing; --template water writes an example")
    from mammometry.api.validation import read_cases
    from mammometry.base.identity import shown_name
    from mammometry.report.documents.validation_page import validation_files, validation_names
    from mammometry.study.validation.study import validation as analyse
    from mammometry.study.validation.tables import validation_json, validation_summary, validation_tables

    sem_cc = _cc(sem, "--sem") if sem else None
    require_apart(out, [table, options.file])
    require_free(out, validation_names(1), command=_TRUTH)
    with Bars(options.silent) as bars, bars.task("validation", "volumes") as progress:
        kind, cases = read_cases(table, options.settings(), kind=truth, progress=progress)
        try:
            found = analyse(cases, kind, sem_cc)
        except ValueError as error:
            raise TableError(
                str(table), found=str(error), expected="three or more women", remedy="Add women to the table"
            ) from None
        require_free(out, validation_names(len(found.definitions)), command=_TRUTH)
        write_outputs(out, validation_files(shown_name(table.with_suffix("")), found), command=_TRUTH)
    lines: list[Any] = [*validation_summary(found), ""]
    for shown in validation_tables(found):
        lines += [*table_lines(shown), ""]
    page = out / "report.html"
    return Answer({"report": str(page), **validation_json(found)}, [*lines, f"Report: {page}"])


def _planned(claim_cc: float, sem_cc: float) -> Answer:
    from dataclasses import asdict

    from mammometry.study.repeatability.plan import DETECTABLE
    from mammometry.study.repeatability.plan import plan as planned_for
    from mammometry.study.repeatability.tables import plan_table

    found = planned_for(claim_cc, sem_cc)
    if not found.sizes:
        least = f"{DETECTABLE * sem_cc:.0f} cc"
        raise typer.BadParameter(f"--plan: an error of {sem_cc:g} cc allows no claim below about {least}")
    lines = [
        *table_lines(plan_table(found)),
        "",
        f"Each row shows the claim with {100 * found.power:.0f} % probability. Both breasts of a woman count once.",
    ]
    return Answer(asdict(found), lines)


def _cc(text: str, option: str) -> float:
    """A volume: ``25cc``, ``25 ml``, ``25``."""
    from mammometry.base.parse import number

    digits = text.strip().lower().removesuffix("cc").removesuffix("ml").strip()
    try:
        found = number(digits)
    except ValueError:
        found = 0.0
    if not found > 0:
        raise typer.BadParameter(f"{option}: a volume such as 25cc")
    return found
