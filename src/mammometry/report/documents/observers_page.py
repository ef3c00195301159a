"""An observer study on one page that needs nothing but itself."""

from __future__ import annotations

import json
from collections.abc import Sequence

from mammometry.report.documents.pages import embed, render
from mammometry.report.figures.studies.observers import curves_on, regions, volumes
from mammometry.study.observers import (
    Drawing,
    DrawnSurface,
    ObserverStudy,
    observers_json,
    observers_summary,
    observers_tables,
)

_SURFACES_SHOWN = 12  # pictures of surfaces on a page; chosen by eye
_REMARKS = (
    "All volumes are before the same kind of wall on the same mesh: they differ by the curves alone.",
    "ICC(2,1) is about single measurements, and counts a constant offset as error: whoever drew is one of many who "
    "might.",
    "The standard uncertainty of one curve is the root mean square distance of two, over √2. The measurement takes "
    "`measure.observers` for it: set yours there.",
)


def observers_names(surfaces: int) -> tuple[str, ...]:
    """Names of all files that a study of so many surfaces writes."""
    shown = (_picture_of(number) for number in range(min(surfaces, _SURFACES_SHOWN)))
    return ("report.html", "observers.json", "volumes.png", "regions.png", *shown)


def observers_files(
    title: str, surfaces: Sequence[DrawnSurface], drawings: Sequence[Drawing], found: ObserverStudy
) -> dict[str, bytes]:
    """The page, its pictures and its numbers: file name → content.

    Args:
        title: of the page.
        surfaces: with the curves on them.
        drawings: one a curve.
        found: what they come to.
    """
    pictures = {"volumes.png": volumes(drawings, found), "regions.png": regions(found)}
    pictures |= {
        _picture_of(number): curves_on(surface, found.observers)
        for number, surface in enumerate(surfaces[:_SURFACES_SHOWN])
    }
    left_out = len(surfaces) - _SURFACES_SHOWN
    page = render(
        "agreement.html.j2",
        kind="observer study",
        title=title,
        subtitle="The same breasts, outlined by several persons or several times",
        summary=observers_summary(found),
        pictures=[embed(png) for png in pictures.values()],
        tables=observers_tables(found, drawings),
        remarks=[*_REMARKS, *([f"{left_out} more surfaces are not shown."] if left_out > 0 else [])],
    )
    numbers = json.dumps({"title": title, **observers_json(found, drawings)}, indent=1, ensure_ascii=False)
    return {"report.html": page.encode(), "observers.json": (numbers + "\n").encode(), **pictures}


def _picture_of(number: int) -> str:
    return f"curves-{number + 1}.png"
