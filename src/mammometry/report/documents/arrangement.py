"""Places of a report's pictures, in the browser and on paper."""

from __future__ import annotations

from collections.abc import Sequence

from mammometry.report.content import Picture, ReportContent
from mammometry.report.figures.catalogue import in_order, is_on_paper
from mammometry.report.first_page import FIRST_PICTURES

_MEASURE = "measure"


def whole_pictures(content: ReportContent) -> list[Picture]:
    """Pictures of the whole measurement, without those of the first page."""
    of_breasts = {name for breast in content.breasts for name in _of_breast(content, breast.name)}
    measure = _drawn(content, _MEASURE)
    left_out = {*of_breasts, *FIRST_PICTURES}
    return [measure[name] for name in in_order(_MEASURE, measure) if name not in left_out]


def breast_pictures(content: ReportContent, breast: str) -> list[Picture]:
    """Pictures of one breast."""
    return [_drawn(content, _MEASURE)[name] for name in _of_breast(content, breast)]


def stage_pictures(content: ReportContent, stage: str) -> list[Picture]:
    """Pictures of one stage for the technician. Those of the measurement stand with the breasts."""
    return [picture for _, picture in _of_stage(content, stage)]


def paper_pictures(content: ReportContent, stages: Sequence[str]) -> list[Picture]:
    """Pictures of these stages that the paper has room for."""
    return [picture for stage in stages for name, picture in _of_stage(content, stage) if is_on_paper(name)]


def _of_stage(content: ReportContent, stage: str) -> list[tuple[str, Picture]]:
    drawn = {} if stage == _MEASURE else _drawn(content, stage)
    return [(name, drawn[name]) for name in in_order(stage, drawn)]


def _of_breast(content: ReportContent, breast: str) -> list[str]:
    return in_order(_MEASURE, (name for name in _drawn(content, _MEASURE) if name.endswith(f"-{breast}")))


def _drawn(content: ReportContent, stage: str) -> dict[str, Picture]:
    return dict(content.pictures.get(stage, {}))
