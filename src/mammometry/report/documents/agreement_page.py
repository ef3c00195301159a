"""An agreement study on one page that needs nothing but itself."""

from __future__ import annotations

import json
from collections.abc import Sequence

from mammometry.report.documents.pages import embed, render
from mammometry.report.figures.studies.agreement import bland_altman, scatter
from mammometry.study.agreement import (
    Agreement,
    CheckedFigure,
    PairedMeasurements,
    agreement_json,
    agreement_tables,
    summary,
)
from mammometry.study.tables import Table

FILES = ("report.html", "agreement.json", "bland-altman.png", "scatter.png")


def agreement_files(
    title: str,
    data: PairedMeasurements,
    found: Agreement,
    checked: Sequence[CheckedFigure] = (),
    *,
    more: Sequence[Table] = (),
    remarks: Sequence[str] = (),
) -> dict[str, bytes]:
    """The page, its figures and its numbers: file name → content.

    Args:
        title: of the page.
        data: the measurements.
        found: what they come to.
        checked: published figures beside the recomputed ones.
        more: further tables.
        remarks: sentences for the end.
    """
    pictures = {"bland-altman.png": bland_altman(data, found), "scatter.png": scatter(data)}
    page = render(
        "agreement.html.j2",
        kind="agreement study",
        title=title,
        subtitle=f"{data.measured_name} against {data.reference_name}",
        summary=summary(data, found),
        pictures=[embed(png) for png in pictures.values()],
        tables=[*agreement_tables(data, found, checked), *more],
        remarks=[*remarks, *(check.published.note for check in checked if not check.follows and check.published.note)],
    )
    numbers = json.dumps({"title": title, **agreement_json(data, found, checked)}, indent=1, ensure_ascii=False)
    return {"report.html": page.encode(), "agreement.json": (numbers + "\n").encode(), **pictures}
