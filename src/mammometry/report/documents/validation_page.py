"""Validation against a hospital's own reference volumes, on one self-contained page."""

import json

from mammometry.report.documents.pages import embed, render
from mammometry.report.figures.observers import bland_altman
from mammometry.report.figures.validation import definitions_side_by_side
from mammometry.study.validation.study import ValidationStudy
from mammometry.study.validation.tables import (
    validation_csv,
    validation_json,
    validation_remarks,
    validation_summary,
    validation_tables,
)

_MOST_PLOTS = 4  # most Bland–Altman plots on a page, one per definition


def validation_names(definitions: int) -> tuple[str, ...]:
    """Names of all files of a validation with this number of definitions."""
    plots = (f"bland-altman-{number + 1}.png" for number in range(min(definitions, _MOST_PLOTS)))
    return ("report.html", "validation.json", "volumes.csv", "definitions.png", *plots)


def validation_files(title: str, found: ValidationStudy) -> dict[str, bytes]:
    """The page, its pictures, its numbers and the volumes: file name → content."""
    pictures = {"definitions.png": definitions_side_by_side(found)}
    for place, one in enumerate(found.definitions[:_MOST_PLOTS]):
        pictures[f"bland-altman-{place + 1}.png"] = bland_altman(one.data, one.agreement)
    page = render(
        "agreement.html.j2",
        kind="validation",
        title=title,
        subtitle="Measured volumes against a truth by another method",
        summary=validation_summary(found),
        pictures=[embed(png) for png in pictures.values()],
        tables=validation_tables(found),
        remarks=validation_remarks(found),
    )
    numbers = json.dumps({"title": title, **validation_json(found)}, indent=1, ensure_ascii=False)
    return {
        "report.html": page.encode(),
        "validation.json": (numbers + "\n").encode(),
        "volumes.csv": validation_csv(found).encode(),
        **pictures,
    }
