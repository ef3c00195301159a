"""The command `verify`: are all results as they were written?"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mammometry.cli.common import Answer, Options, command

if TYPE_CHECKING:
    from mammometry.io.results.verify import Findings

app = typer.Typer()
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
    """Check that all result files are as they were written.

    Names the damaged ones and says which of them a rerun renews. The exit code is 9 if a file is damaged. Changed
    photographs and settings are not damage: `mammometry info` shows those.
    """
    from mammometry.base.errors import StorageError
    from mammometry.io.results.verify import results_in
    from mammometry.io.results.verify import verify as verified

    results = results_in(session)
    findings = verified(results)
    renewed, left, remark = _renewed(session, results, findings, options)
    table: dict[str, Any] = {"results": str(results), **asdict(findings), "renewed": renewed, "not_renewed": left}
    lines: list[Any] = [f"{damage.file}: {damage.found}" for damage in findings.damaged]
    lines += [f"A rerun renews {', '.join(renewed)}"] if renewed else []
    lines += [f"A rerun does not renew {', '.join(left)}: {remark}"] if left else []
    lines += [f"{results.name}/{name}: left by an interrupted run or set aside" for name in findings.leftovers]
    lines += [f"{name}: not written by mammometry, not checked" for name in findings.unrecorded]
    sums = f"{findings.products} products, {findings.files} files, {findings.bytes / _MB:.0f} MB"
    lines.append(f"{sums}: {'DAMAGED' if findings.damaged else 'all as they were written'}")
    return Answer(table, lines, exit_code=StorageError.exit_code if findings.damaged else 0)


def _renewed(session: Path, results: Path, findings: Findings, options: Options) -> tuple[list[str], list[str], str]:
    """Damaged products that a rerun makes again, those it cannot, and why."""
    from mammometry.api.job import open_session
    from mammometry.base.errors import MammometryError
    from mammometry.io.results.verify import shown
    from mammometry.job.products import STAGES

    loaded = options.settings()
    damaged = {f"{damage.stage}/{damage.product}": None for damage in findings.damaged if damage.product is not None}
    stages = [damage.stage for damage in findings.damaged if damage.product is None]
    if results == session:
        return [*damaged, *stages], [], ""
    if not damaged and not stages:
        return [], [], ""
    try:
        job = open_session(session, loaded)
        keys = [key for stage in STAGES[:-1] if job.plan.products(stage) for key in job.keys(stage)]
        wanted = {f"{key.stage}/{key.product}" for key in [*keys, job.content_key, job.report_key]}
    except MammometryError as error:
        return [], [*damaged, *stages], shown(str(error))
    left = [name for name in damaged if name not in wanted]
    return [name for name in damaged if name in wanted] + stages, left, "no longer part of this session"
