"""Agreement and observer studies, each on one self-contained page."""

import json
from collections.abc import Sequence
from typing import Any

from mammometry.base.notices.words import in_json, lines_of
from mammometry.report.documents.pages import embed, render
from mammometry.report.figures.observers import bland_altman, curves_on, regions, scatter, volumes
from mammometry.study.agreement import Agreement, CheckedFigure, PairedMeasurements
from mammometry.study.agreement_tables import agreement_json, agreement_tables, summary
from mammometry.study.observers import DrawnSurface, ObservedCurve, ObserverStudy
from mammometry.study.observers_tables import observers_json, observers_summary, observers_tables
from mammometry.study.tables import TextTable

FILES = ("report.html", "agreement.json", "bland-altman.png", "scatter.png")


def agreement_files(
    title: str,
    data: PairedMeasurements,
    figures: Agreement,
    checked: Sequence[CheckedFigure] = (),
    *,
    more: Sequence[TextTable] = (),
    remarks: Sequence[str] = (),
) -> dict[str, bytes]:
    """The page, its figures and its numbers: file name → content.

    Args:
        title: of the page.
        data: measurements.
        figures: statistics.
        checked: published figures and the recomputed ones.
        more: further tables.
        remarks: sentences at the end of the page.
    """
    pictures = {"bland-altman.png": bland_altman(data, figures), "scatter.png": scatter(data)}
    page = render(
        "agreement.html.j2",
        kind="agreement study",
        title=title,
        subtitle=f"{data.measured_name} against {data.reference_name}",
        summary=[*lines_of(data.notices), *summary(data, figures)],
        pictures=[embed(png) for png in pictures.values()],
        tables=[*agreement_tables(data, figures, checked), *more],
        remarks=[*remarks, *(check.published.note for check in checked if not check.follows and check.published.note)],
    )
    numbers = json.dumps({"title": title, **study_json(data, figures, checked)}, indent=1, ensure_ascii=False)
    return {"report.html": page.encode(), "agreement.json": (numbers + "\n").encode(), **pictures}


def study_json(data: PairedMeasurements, figures: Agreement, checked: Sequence[CheckedFigure]) -> dict[str, Any]:
    """All results and notices of a study of agreement, as data for JSON."""
    return in_json(data.notices) | agreement_json(data, figures, checked)


_SURFACES_SHOWN = 12  # most surfaces whose pictures are on a page; appearance only
_REMARKS = (
    "All volumes have the same kind of wall on the same mesh: only the curves differ.",
    "ICC(2,1) is for single measurements, and counts a constant offset as error: the observers are a sample of "
    "all observers.",
    "The standard uncertainty of one curve is the root mean square distance of two, divided by √2. To use yours "
    "in measurements, set `measure.observers`.",
)


def observers_names(surfaces: int) -> tuple[str, ...]:
    """Names of all files of a study with this number of surfaces."""
    shown = (_picture_of(number) for number in range(min(surfaces, _SURFACES_SHOWN)))
    return ("report.html", "observers.json", "volumes.png", "regions.png", *shown)


def observers_files(
    title: str, surfaces: Sequence[DrawnSurface], drawings: Sequence[ObservedCurve], study: ObserverStudy
) -> dict[str, bytes]:
    """The page, its pictures and its numbers: file name → content.

    Args:
        title: of the page.
        surfaces: surfaces with the curves drawn on them.
        drawings: one per curve.
        study: statistics.
    """
    pictures = {"volumes.png": volumes(drawings, study), "regions.png": regions(study)}
    pictures |= {
        _picture_of(number): curves_on(surface, study.observers)
        for number, surface in enumerate(surfaces[:_SURFACES_SHOWN])
    }
    left_out = len(surfaces) - _SURFACES_SHOWN
    page = render(
        "agreement.html.j2",
        kind="observer study",
        title=title,
        subtitle="The same breasts, outlined by several persons or several times",
        summary=observers_summary(study),
        pictures=[embed(png) for png in pictures.values()],
        tables=observers_tables(study, drawings),
        remarks=[*_REMARKS, *([f"{left_out} more surfaces are not shown."] if left_out > 0 else [])],
    )
    numbers = json.dumps({"title": title, **observers_json(study, drawings)}, indent=1, ensure_ascii=False)
    return {"report.html": page.encode(), "observers.json": (numbers + "\n").encode(), **pictures}


def _picture_of(number: int) -> str:
    return f"curves-{number + 1}.png"
