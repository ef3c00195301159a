"""The report as one self-contained page.

Pictures, style and 3D viewer are inside. It needs no network.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mammometry.report import pages
from mammometry.report.arrangement import breast_pictures, first_pictures, stage_pictures
from mammometry.report.content import DISCLAIMER, Picture, ReportContent

PAGE = "report.html"


def render(content: ReportContent) -> str:
    """The page's text."""
    from markupsafe import Markup

    return pages.render(
        "report.html.j2",
        styles=(pages.STYLE, "viewer.css"),
        content=content,
        disclaimer=DISCLAIMER,
        scene=Markup(content.scene) if content.scene else None,
        viewer=Markup(pages.viewer_program()) if content.scene else None,
        pictures=_arranged(content),
    )


def _arranged(content: ReportContent) -> Mapping[str, object]:
    """Pictures where the page wants them, embedded."""
    return {
        "overview": _embedded(first_pictures(content)),
        "breasts": {breast.name: _embedded(breast_pictures(content, breast.name)) for breast in content.breasts},
        "stages": {stage: _embedded(stage_pictures(content, stage)) for stage in content.pictures},
    }


def _embedded(pictures: Sequence[Picture]) -> list[pages.Shown]:
    return [pages.shown(picture) for picture in pictures]
