"""Pictures of a report for its page and PDF, each encoded once."""

import io
from collections.abc import Mapping

import numpy as np
from PIL import Image

from mammometry.base.machine.cores import map_in_threads
from mammometry.report.content import ReportPicture
from mammometry.report.figures.canvas import caption_in
from mammometry.report.figures.catalogue import is_on_paper

_PAPER_PX = 1400  # longer side of a picture in the PDF: about 190 dpi at the text width of A4
_QUALITY = 88  # quality of WebP and JPEG, 0 to 100: WebP then has a third of a JPEG's size; appearance only
_WEBP_EFFORT = 2  # effort of its encoder, 0 to 6: takes half as long as 4, with 4 % more bytes
_SMALL_BYTES = 60_000
"""Size in bytes below which pictures stay lossless, because lines and text are sharper."""


def encoded(png: bytes, *, on_paper: bool = True) -> ReportPicture:
    """Encode a PNG with its caption for the page and the PDF."""
    with Image.open(io.BytesIO(png), formats=("PNG",)) as image:
        caption, (width, height) = caption_in(image), image.size  # the picture is read only once
        bare = Image.fromarray(np.asarray(image.convert("RGB")))  # without metadata
    return ReportPicture(
        title=caption.title,
        text=caption.text,
        width=width,
        height=height,
        webp=webp_of(bare, len(png)),
        jpeg=jpeg_of(bare) if on_paper else b"",
    )


def all_encoded(pictures: Mapping[str, Mapping[str, bytes]]) -> dict[str, dict[str, ReportPicture]]:
    """Stage → name → picture, from PNGs. The PDF gets pictures of the measurement and those meant for it.

    If nothing was measured, the first page shows views of the surface.
    """
    first = "measure" if pictures.get("measure") else "surface"
    names = [(stage, name) for stage, drawn in pictures.items() for name in drawn]

    def one(place: tuple[str, str]) -> ReportPicture:
        stage, name = place
        return encoded(pictures[stage][name], on_paper=stage == first or is_on_paper(name))

    made: dict[str, dict[str, ReportPicture]] = {stage: {} for stage in pictures}
    for (stage, name), picture in zip(names, map_in_threads(one, names), strict=True):
        made[stage][name] = picture
    return made


def webp_of(image: Image.Image, png_bytes: int) -> bytes:
    """A picture as WebP: lossless if that is small. A photograph has a third of the size of its JPEG."""
    # Lossless WebP has at best half the size of the PNG, so it is not tried for larger ones.
    data = _webp(image, lossless=True, quality=60) if png_bytes <= 2 * _SMALL_BYTES else None
    if data is None or len(data) > _SMALL_BYTES:
        data = _webp(image, quality=_QUALITY, use_sharp_yuv=True)
    return data


def jpeg_of(image: Image.Image) -> bytes:
    """A picture as JPEG, at printing resolution."""
    small = image.copy()
    small.thumbnail((_PAPER_PX, _PAPER_PX))
    buffer = io.BytesIO()
    small.save(buffer, format="JPEG", quality=_QUALITY, subsampling=0)
    return buffer.getvalue()


def _webp(image: Image.Image, **options: float) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, format="WEBP", method=_WEBP_EFFORT, **options)
    return buffer.getvalue()
