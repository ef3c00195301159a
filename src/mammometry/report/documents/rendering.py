"""Render a report from its stored content, the attribution of boundaries, and a clinic's data."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

from mammometry.base.notices import Notice
from mammometry.measure.volume.attribution import Attribution, CurveConfirmation, attributed_remarks, attributed_words
from mammometry.report.content import BreastReport, Clinical, ReportContent, StageReport, sentence
from mammometry.report.first_page import first_page
from mammometry.report.words.describe import posture_fact


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderedReport:
    """A report as a web page and as a PDF."""

    html: bytes
    """A single page that needs no other files."""
    pdf: bytes
    warnings: tuple[Notice, ...]
    """Warnings that should be read before the numbers, worst first."""


def render(
    content: ReportContent,
    attributions: Mapping[str, Attribution],
    clinical: Clinical | None = None,
    *,
    named: bool = True,
    photographs: Mapping[str, str] = MappingProxyType({}),
) -> RenderedReport:
    """Render a report. Equal arguments give equal bytes.

    Args:
        content: content of the report.
        attributions: breast → author and confirmation of its boundary.
        clinical: a clinic's data. Its confirmation applies to all boundaries. None: the user works on the command line.
        named: whether names, dates and free text are included. False for de-identified reports.
        photographs: name → address of the session's photographs, for a page in its folder.
    """
    from mammometry.report.documents import html, pdf

    first = first_page(content, attributions, clinical, named=named)
    whole = attributed_content(content, attributions, clinical, named=named)
    return RenderedReport(
        html=html.render(whole, first, photographs).encode(), pdf=pdf.render(whole, first), warnings=whole.warnings
    )


def _in_posture(stages: Sequence[StageReport], posture: str) -> tuple[StageReport, ...]:
    """The stages with the posture from the clinic, which may have been entered after the measurement."""
    known = posture_fact(posture)
    return tuple(
        replace(stage, facts=tuple(known if fact.label == known.label else fact for fact in stage.facts))
        for stage in stages
    )


def attributed_content(
    content: ReportContent, attributions: Mapping[str, Attribution], clinical: Clinical | None, *, named: bool
) -> ReportContent:
    """The content with the author and confirmation of each boundary, and with warnings about boundaries."""
    breasts = []
    for breast in content.breasts:
        attribution = attributions.get(breast.name, Attribution())
        if clinical is not None:
            signed = clinical.confirmed
            at = "" if signed is None else signed.at.isoformat()
            seen = None if signed is None else CurveConfirmation(by=signed.by, at=at, curve=breast.curve)
            attribution = replace(attribution, confirmation=seen)
        if breast.absence is None:
            remarks, curve = breast.boundary_remarks, breast.curve
            breast = replace(
                breast,
                boundary=attributed_words(breast.boundary, remarks, curve, attribution, named=named),
                boundary_remarks=attributed_remarks(remarks, curve, attribution.confirmation),
            )
        breasts.append(breast)
    doubts = content.calibration_doubts if clinical is None else ()  # a clinic shows them on the rig's page
    of_boundaries = _boundary_warnings(breasts, in_clinic=clinical is not None)
    warnings = (*content.warnings, *of_boundaries, *content.concerns, *doubts)
    posture = "" if clinical is None else clinical.posture
    return replace(
        content,
        stages=_in_posture(content.stages, posture) if posture else content.stages,
        breasts=tuple(replace(breast, boundary=sentence(breast.boundary)) for breast in breasts),
        warnings=warnings,
    )


def _boundary_warnings(breasts: Sequence[BreastReport], *, in_clinic: bool) -> Iterator[Notice]:
    for breast in breasts:
        if breast.absence is not None:
            yield breast.absence
    unconfirmed = tuple(breast.name for breast in breasts if "to-be-confirmed" in breast.boundary_remarks)
    if unconfirmed:
        yield Notice(code="boundary-not-confirmed", about=unconfirmed)
    if not in_clinic and (unconfirmed or any(breast.absence for breast in breasts)):
        yield Notice(code="boundaries-drawn-with-edit", level="note")
