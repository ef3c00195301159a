"""Acceptance test as a page and as a document, and the protocol with positions to tick off."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import mammometry
from mammometry.report.content import DISCLAIMER, Fact
from mammometry.report.documents import paper
from mammometry.report.documents.pages import EmbeddedPicture, embed, render
from mammometry.report.figures.acceptance import control_chart, deviations, positions
from mammometry.report.pictures import encoded
from mammometry.study.acceptance.artefacts import KINDS, POSITIONS, TITLES, Kind
from mammometry.study.acceptance.evaluate import Outcome
from mammometry.study.acceptance.tables import (
    PastTest,
    acceptance_tables,
    headline,
    kinds_of,
    meaning,
    missing_sentences,
    reference_words,
)
from mammometry.study.tables import TextTable

PAGE, DOCUMENT, PROTOCOL = "acceptance.html", "acceptance.pdf", "protocol.html"
_PICTURE_HEIGHT = 300  # largest height of a picture in the document, points
_RULES = (
    "After VDI/VDE 2634-3 and ISO 10360-13, with artefacts that a clinic can make. It does not replace an accredited "
    "laboratory's test.",
    "Spheres and planes are fitted by least squares to the measured patch. The patch is chosen by position alone. It "
    "excludes 6° at the edge of a ball, 4 % of the longer side at the edge of a plane, and stands and tables.",
    "A fit excludes at most the 0.3 % of the points with the largest deviations (VDI/VDE 2634). Form error and "
    "flatness include these points: they are the widths that contain 95 % of all points (ISO 10360-13).",
    "Accepted: error and expanded uncertainty (95 %) together are within the limit at every position. Rejected: the "
    "error less its uncertainty is beyond the limit. Otherwise undecided (ISO 14253-1).",
    "The uncertainty combines that of the artefact and that of the fit, for errors that are correlated over less than "
    "a fifth of the ball's diameter. Errors correlated over longer distances count as the device's.",
    "Effect on a breast of 400 cc: an error of length scales the breast. An error of size moves its skin by half of "
    "the error, an error of form or flatness by at most half of it, if it has the same sign everywhere.",
)
_HOW: Mapping[Kind, str] = {
    "sphere": "A speckled or matt ball of 100 to 200 mm. Put it at each position and measure it like a patient.",
    "bar": "Two equal balls on a stiff bar. Turn it as drawn.",
    "plane": "A sheet from `mammometry target --speckle`, glued without bubbles on glass or aluminium.",
    "cast": "A body of known volume, closed on all sides, or measured as a session of a cast.",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class PageSection:
    """A section of the page."""

    title: str
    sentences: Sequence[str] = ()
    ticks: Sequence[str] = ()
    pictures: Sequence[EmbeddedPicture] = ()
    tables: Sequence[TextTable] = field(default_factory=tuple)


def acceptance_page_files(outcome: Outcome, history: Sequence[PastTest]) -> dict[str, bytes]:
    """Page, document and pictures: file name → content.

    Args:
        outcome: result of the test.
        history: all tests of the device, including this one, oldest first.
    """
    pictures = acceptance_pictures(outcome, history)
    worst, tables = acceptance_tables(outcome)
    parts = [
        PageSection(
            title=TITLES[kind],
            sentences=[_reference(outcome, kind)],
            pictures=[embed(png) for name, png in pictures.items() if name.endswith(f"-{kind}.png")],
            tables=[tables[kind]] if kind in tables else [],
        )
        for kind in KINDS
        if kind in outcome.test.artefacts
    ]
    if "control-chart.png" in pictures:
        parts.append(PageSection(title="History of this device", pictures=[embed(pictures["control-chart.png"])]))
    page = render(
        "acceptance.html.j2",
        kind="acceptance test",
        title=_title(outcome),
        subtitle=_subtitle(outcome),
        headline=headline(outcome),
        summary=[*map(meaning, outcome.worst.values()), *missing_sentences(outcome)],
        about=about(outcome),
        first_tables=[worst],
        parts=parts,
        remarks=_RULES,
        signed=True,
        disclaimer=DISCLAIMER,
    )
    document = paper.document(_title(outcome), _subtitle(outcome), lambda width: _story(outcome, pictures, width))
    return {PAGE: page.encode(), DOCUMENT: document, **pictures}


def acceptance_pictures(outcome: Outcome, history: Sequence[PastTest]) -> dict[str, bytes]:
    """Positions and deviations of each artefact. With several tests, also the control chart."""
    pictures = {}
    for kind in kinds_of(outcome):
        results = [result for result in outcome.results if result.kind == kind]
        pictures[f"positions-{kind}.png"] = positions(kind, {result.position for result in results})
        if any(result.patches for result in results):
            pictures[f"deviations-{kind}.png"] = deviations(kind, results)
    if len(history) > 1:
        pictures["control-chart.png"] = control_chart(history)
    return pictures


def picture_names() -> tuple[str, ...]:
    """Names of all pictures that a test can have."""
    return (*(f"{what}-{kind}.png" for what in ("positions", "deviations") for kind in KINDS), "control-chart.png")


def protocol_page(device: str) -> bytes:
    """Page with the positions of all artefacts as pictures, to tick off."""
    parts = [
        PageSection(
            title=f"{TITLES[kind]}: {len(POSITIONS[kind])} positions",
            sentences=[_HOW[kind].replace("`", ""), f"Save position 1 as {kind}/1, position 2 as {kind}/2, and so on."],
            ticks=[f"{place.name}: {place.words}" for place in POSITIONS[kind]],
            pictures=[embed(positions(kind))],
        )
        for kind in KINDS
    ]
    return render(
        "acceptance.html.j2",
        kind="acceptance test",
        title=f"Protocol: {device}" if device else "Protocol",
        subtitle="Positions to tick off. Left and right as seen from the device.",
        headline="",
        summary=[
            "Let device and artefacts stand in the room for half an hour. Calibrate the device as before patients.",
            "Measure each artefact that you have at all its positions. Missing positions leave the test undecided.",
        ],
        about=(),
        first_tables=(),
        parts=parts,
        remarks=(),
        signed=True,
        disclaimer=DISCLAIMER,
    ).encode()


def about(outcome: Outcome) -> tuple[Fact, ...]:
    """Device, date, person and software."""
    test = outcome.test
    own = f"mammometry {mammometry.__version__}"
    return (
        Fact("Device", test.device),
        Fact("Date", test.date.isoformat()),
        Fact("Tested by", test.person),
        Fact("Measured with", test.software or own),
        Fact("Evaluated with", own),
        Fact("Measurements", str(len(outcome.results))),
    )


def _title(outcome: Outcome) -> str:
    return f"Acceptance test: {outcome.test.device}"


def _subtitle(outcome: Outcome) -> str:
    return f"{outcome.test.date.isoformat()}, after VDI/VDE 2634-3 and ISO 10360-13"


def _reference(outcome: Outcome, kind: Kind) -> str:
    artefact = outcome.test.artefacts[kind]
    words = reference_words(artefact)
    return f"Reference: {words}. Source: {artefact.source}."


def _story(outcome: Outcome, pictures: Mapping[str, bytes], width: float) -> Iterator[Any]:
    from reportlab.platypus import KeepTogether, Spacer

    yield paper.text("mammometry: acceptance test", size=8, colour=paper.ACCENT)
    yield paper.text(outcome.test.device, size=18, bold=True)
    yield paper.text(_subtitle(outcome), size=8.5, colour=paper.FAINT)
    yield Spacer(0, 6)
    yield paper.text(headline(outcome), size=10.5, bold=True)
    for sentence in map(meaning, outcome.worst.values()):
        yield paper.text(sentence)
    if warnings := missing_sentences(outcome):
        yield Spacer(0, 4)
        yield paper.box([paper.text(sentence) for sentence in warnings], width)
    yield Spacer(0, 6)
    yield from paper.facts(about(outcome))
    worst, tables = acceptance_tables(outcome)
    yield paper.table(worst, width, first=0.34)
    yield from paper.signature_line(0.6 * width, 0)
    for kind in kinds_of(outcome):
        yield paper.text(TITLES[kind], size=11, bold=True, before=8)
        yield paper.text(_reference(outcome, kind))
        for name, png in pictures.items():
            if name.endswith(f"-{kind}.png"):
                picture = encoded(png)
                title = paper.text(picture.title, size=8, bold=True, before=4)
                yield KeepTogether([title, paper.picture(picture.jpeg, width, _PICTURE_HEIGHT)])
        if kind in tables:
            yield paper.table(tables[kind], width, first=0.4)
    if "control-chart.png" in pictures:
        title = paper.text("History of this device", size=11, bold=True, before=8)
        chart = paper.picture(encoded(pictures["control-chart.png"]).jpeg, width, 1.5 * _PICTURE_HEIGHT)
        yield KeepTogether([title, chart])
    yield paper.text("Rules", size=11, bold=True, before=8)
    for rule in _RULES:
        yield paper.text(f"• {rule}", size=7.5)
