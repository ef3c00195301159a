"""The report as one self-contained page.

Pictures, style and 3D viewer are inside. It needs no network.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from mammometry.base.cores import each_at_once
from mammometry.io.write import disk_errors, write_text
from mammometry.report import pages
from mammometry.report.arrangement import breast_pictures, first_pictures, stage_pictures
from mammometry.report.content import DISCLAIMER, ReportContent
from mammometry.report.scene import to_json

PAGE = "report.html"


def write(folder: Path, content: ReportContent) -> Path:
    """Write the page into a folder and return its path.

    An earlier page is replaced as a whole or not at all.

    Raises:
        StorageError: the folder cannot be written to.
    """
    page = folder / PAGE
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    write_text(page, render(content))
    return page


def render(content: ReportContent) -> str:
    """The page's text."""
    from markupsafe import Markup

    return pages.render(
        "report.html.j2",
        styles=(pages.STYLE, "viewer.css"),
        content=content,
        disclaimer=DISCLAIMER,
        scene=None if content.scene is None else Markup(to_json(content.scene)),
        viewer=None if content.scene is None else Markup(pages.viewer_program()),
        pictures=_arranged(content),
    )


def _arranged(content: ReportContent) -> Mapping[str, object]:
    """Pictures where the page wants them, embedded."""
    return {
        "overview": _embedded(first_pictures(content)),
        "breasts": {breast.name: _embedded(breast_pictures(content, breast.name)) for breast in content.breasts},
        "stages": {stage: _embedded(stage_pictures(content, stage)) for stage in content.pictures},
    }


def _embedded(pictures: Sequence[bytes]) -> list[pages.Shown]:
    return each_at_once(pages.embed, pictures)
