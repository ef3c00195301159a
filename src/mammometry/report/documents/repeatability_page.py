"""A study of repeatability on one self-contained page."""

import json
from collections.abc import Sequence

from mammometry.report.content import Fact
from mammometry.report.documents.pages import embed, render
from mammometry.report.figures.repeated import capture_differences, variances
from mammometry.study.repeatability.design import Reading
from mammometry.study.repeatability.plan import ClaimCheck
from mammometry.study.repeatability.study import RepeatabilityStudy
from mammometry.study.repeatability.tables import (
    claim_sheet,
    readings_csv,
    repeatability_json,
    repeatability_remarks,
    repeatability_summary,
    repeatability_tables,
)

FILES = ("report.html", "repeatability.json", "volumes.csv", "captures.png", "variances.png")


def repeatability_files(
    title: str, readings: Sequence[Reading], found: RepeatabilityStudy, claim: ClaimCheck | None = None
) -> dict[str, bytes]:
    """The page, its pictures, its numbers and the volumes: file name → content.

    Args:
        title: of the page.
        readings: all volumes.
        found: the statistics.
        claim: the claim that was checked.
    """
    pictures = {"captures.png": capture_differences(readings, found), "variances.png": variances(found)}
    page = render(
        "agreement.html.j2",
        kind="study of repeatability",
        title=title,
        subtitle="The same breasts, captured again",
        summary=repeatability_summary(found, claim),
        sheet={"title": "Claim sheet", "lines": [Fact(label=part, value=text) for part, text in claim_sheet(found)]},
        pictures=[embed(png) for png in pictures.values()],
        tables=repeatability_tables(found),
        remarks=repeatability_remarks(found),
    )
    numbers = json.dumps({"title": title, **repeatability_json(found, claim)}, indent=1, ensure_ascii=False)
    return {
        "report.html": page.encode(),
        "repeatability.json": (numbers + "\n").encode(),
        "volumes.csv": readings_csv(readings).encode(),
        **pictures,
    }
