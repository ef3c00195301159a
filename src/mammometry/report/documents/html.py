"""The report as one self-contained page.

Pictures, style and 3D viewer are embedded, so it needs no network.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from mammometry.base.notices.words import words_of
from mammometry.report.content import DISCLAIMER, ReportContent, ReportPicture
from mammometry.report.documents import pages
from mammometry.report.documents.pages import breast_pictures, stage_pictures, whole_pictures
from mammometry.report.first_page import FirstPage, signature
from mammometry.report.words.volumes import MEANINGS_INTRODUCTION

PAGE = "report.html"


def render(content: ReportContent, first: FirstPage, photographs: Mapping[str, str] = MappingProxyType({})) -> str:
    """HTML of the report's page.

    Args:
        content: content of the report.
        first: content of the first page.
        photographs: ``capture/CAMERA`` and ``calibration/POSE/CAMERA`` → address of the file, for a page in the same
            folder. Warnings about a photograph link to it.
    """
    from markupsafe import Markup

    return pages.render(
        "report.html.j2",
        styles=(pages.STYLE, "viewer.css"),
        content=content,
        warnings=[
            (words_of(notice), {name: photographs[name] for name in notice.photographs if name in photographs})
            for notice in content.warnings
        ],
        first=first,
        signature="" if first.conclusion is None else signature(first.conclusion),
        disclaimer=DISCLAIMER,
        introduction=MEANINGS_INTRODUCTION,
        scene=Markup(content.scene) if content.scene else None,
        viewer=Markup(pages.viewer_program()) if content.scene else None,
        pictures=_arranged(content, first),
    )


def _arranged(content: ReportContent, first: FirstPage) -> Mapping[str, object]:
    """Embedded pictures, by their place on the page."""
    return {
        "first": _embedded(first.pictures),
        "whole": _embedded(whole_pictures(content)),
        "breasts": {breast.name: _embedded(breast_pictures(content, breast.name)) for breast in content.breasts},
        "stages": {stage: _embedded(stage_pictures(content, stage)) for stage in content.pictures},
    }


def _embedded(pictures: Sequence[ReportPicture]) -> list[pages.EmbeddedPicture]:
    return [pages.shown(picture) for picture in pictures]
