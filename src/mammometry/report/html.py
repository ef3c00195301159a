"""The report as one page that needs nothing but itself: pictures, style and 3D viewer inside, no network."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from mammometry.base.errors import StorageError
from mammometry.io.write import disk_errors, write_text
from mammometry.report import pages
from mammometry.report.arrangement import breast_pictures, first_pictures, stage_pictures
from mammometry.report.content import DISCLAIMER, ReportContent
from mammometry.report.figures.canvas import caption_of
from mammometry.report.pages import resource
from mammometry.report.scene import to_json

PAGE = "report.html"
_QUALITY = 88
_SMALL_BYTES = 60_000
"""A picture that is smaller than this without loss stays without: lines and text are sharper then."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """A picture as the page embeds it."""

    source: str
    """A data URI."""
    width: int
    height: int
    title: str
    text: str


def write(folder: Path, content: ReportContent) -> Path:
    """Write the page into a folder and return its path; an earlier page is replaced as a whole or not at all.

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
        viewer=None if content.scene is None else Markup(viewer_program()),
        pictures=_arranged(content),
    )


def embed(png: bytes) -> Shown:
    """A picture as a data URI, as WebP: a drawing without loss, a photograph at a third of what JPEG would take."""
    caption = caption_of(png)
    with Image.open(io.BytesIO(png), formats=("PNG",)) as image:
        width, height = image.size
        bare = Image.fromarray(np.asarray(image.convert("RGB")))  # without any metadata
    # Without loss a picture shrinks to half its PNG at the best: what cannot become small is not tried.
    data = _webp(bare, lossless=True, quality=60) if len(png) <= 2 * _SMALL_BYTES else None
    if data is None or len(data) > _SMALL_BYTES:
        data = _webp(bare, quality=_QUALITY, use_sharp_yuv=True)
    source = f"data:image/webp;base64,{base64.b64encode(data).decode('ascii')}"
    return Shown(source=source, width=width, height=height, title=caption.title, text=caption.text)


def _webp(image: Image.Image, **options: float) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, format="WEBP", method=4, **options)
    return buffer.getvalue()


def viewer_program() -> str:
    """The viewer's program, safe inside a script element.

    Raises:
        StorageError: the package was copied and not installed: the program is made when it is installed.
    """
    try:
        return resource("viewer.js").replace("</", "<\\/")
    except FileNotFoundError:
        raise StorageError(
            "mammometry/report/templates/viewer.js",
            found="no such file",
            expected="the 3D viewer, which is bundled when the package is installed",
            remedy="Install mammometry again: pip install .",
        ) from None


def _arranged(content: ReportContent) -> Mapping[str, object]:
    """Pictures where the page wants them, embedded."""
    return {
        "overview": [embed(png) for png in first_pictures(content)],
        "breasts": {
            breast.name: [embed(png) for png in breast_pictures(content, breast.name)] for breast in content.breasts
        },
        "stages": {stage: [embed(png) for png in stage_pictures(content, stage)] for stage in content.pictures},
    }
