"""Checks of a photograph: its file and its pixels."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from skimage.measure import blur_effect

from mammometry.base.photograph import LUMA, Photograph
from mammometry.geometry.arrays import Array, Bool, Float32
from mammometry.io.photographs.images import HEIC_MARKS
from mammometry.matching.foreground.block_segmentation import segment
from mammometry.matching.foreground.silhouette import block_means

Level: TypeAlias = Literal["ok", "unknown", "warn", "refuse"]


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of one check of one photograph, or of all photographs together."""

    check: str
    """Name of the check: format, camera, size, sharpness, exposure, whole, times, twice, digest."""
    level: Level
    """``unknown``: no information; ``warn``: it should be looked at; ``refuse``: it cannot be used."""
    sentence: str
    """For the photographer: what was found, and what to do."""

    def as_table(self) -> dict[str, object]:
        """The result for JSON, with its level, and ``ok``, which is None if unknown."""
        ok = None if self.level == "unknown" else self.level == "ok"
        return {"check": self.check, "ok": ok, "level": self.level, "sentence": self.sentence}


def refuses(findings: Iterable[Finding]) -> bool:
    """Whether any finding is a refusal."""
    return any(finding.level == "refuse" for finding in findings)


# bytes searched at both ends: an archive's directory is within 65,557 of the end (ZIP, APPNOTE 4.3.16)
_LOOKED_AT = 1 << 16
_BEGIN = (b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n", b"II*\x00", b"MM\x00*")  # JPEG, PNG, TIFF in either byte order
_JPEG, _JPEG_END, _PNG_END = _BEGIN[0], b"\xff\xd9", b"IEND\xaeB`\x82"
_OTHERS = {
    b"PK\x03\x04": "an archive",
    b"PK\x05\x06": "an archive",
    b"Rar!\x1a\x07": "an archive",
    b"7z\xbc\xaf\x27\x1c": "an archive",
    b"%pdf-": "a PDF",
    b"%!ps-": "a PostScript program",
    b"<html": "a web page",
    b"<!doctype": "a web page",
    b"<script": "a web page",
    b"<svg": "a web page",
    b"<?php": "a program",
    b"\x7felf": "a program",
    b"this program cannot be run in dos mode": "a program",
}
"""First bytes of other formats that are recognised at any offset, in lower case."""
_ANYWHERE = (b"%pdf-", b"<?php", b"<script", b"<html", b"<!doctype", b"<svg")  # readers find these at any offset
_HEAD_BYTES = 1024  # number of bytes in which PDF readers and browsers search for them


NO_PHOTOGRAPH = "no photograph"
"""Result of `not_only_a_photograph` for a file that does not start like a photograph."""


def not_only_a_photograph(path: Path, *, heic: bool = False) -> str | None:
    """Second format of a file that is a photograph and something else, in two words.

    `NO_PHOTOGRAPH` if it is not a photograph. None for an ordinary photograph.

    Args:
        path: the file.
        heic: whether HEIC is accepted as a photograph, as from telephones.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(_LOOKED_AT)
        size = file.seek(0, 2)
        file.seek(max(0, size - _LOOKED_AT))
        tail = file.read(_LOOKED_AT)
    if not (head.startswith(_BEGIN) or (heic and head[4:12] in HEIC_MARKS)):
        return NO_PHOTOGRAPH
    begin = head[:_HEAD_BYTES].lower()
    for mark in _ANYWHERE:
        if mark in begin:
            return _OTHERS[mark]
    behind = _behind(head, tail).lower()
    return next((what for mark, what in _OTHERS.items() if mark.lower() in behind), None)


def _behind(head: bytes, tail: bytes) -> bytes:
    """Bytes after the end of the picture.

    Cameras may store a second, smaller picture or notes there.
    """
    end = _JPEG_END if head.startswith(_JPEG) else _PNG_END if head.startswith(_BEGIN[1]) else b""
    if not end:  # the parts of a TIFF or HEIC may be in any order, so only the end of an archive counts
        return tail[tail.rfind(b"PK\x05\x06") :] if b"PK\x05\x06" in tail else b""
    place = tail.rfind(end)
    closing = tail.rfind(b"PK\x05\x06")
    return tail[min(position for position in (place, closing) if position >= 0) :] if max(place, closing) >= 0 else tail


_LOOKED_AT_PX = 676.0  # diagonal at which the subject is searched: half of the reference size, as in matching
QUICK_PX = 250.0
"""The same diagonal during a capture, when eight pictures must be checked quickly."""
_COARSE_STEP = 12  # pixels per block above which a block has more than enough
_CROP_PX = 800  # side of the part of the subject on which sharpness is measured; for speed
_QUICK_CROP_PX = 480  # the same during a capture: a third of the time
_BLURRED = 0.67
"""Blur (Crete 2007, 0 to 1) above which there is a warning. Rendered photographs of torsos have 0.31 to 0.36. Blurred
with a Gaussian σ of 1, 2 and 3 px, they have 0.46 to 0.53, 0.67 to 0.73 and 0.81 to 0.85.
"""
_DARK, _PALE = 0.25, 0.95  # limits of the subject's median encoded value; well-lit skin of any colour is between them
_CLIPPED, _CLIPPED_SHARE = 0.995, 0.02  # encoded value that counts as saturated, and its largest share of the subject
_SMALL, _LARGE = 0.08, 0.92  # limits of the share of the picture that the subject covers
_AT_BORDER = 0.02  # largest share of a border that a cast may cover
_OFF_CENTRE = 0.3  # largest distance between the centres of subject and picture, as a share of the picture's width


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """Figures of one photograph, as shares of 1."""

    cover: float
    """Share of the picture covered by the subject; 0 if no subject was found."""
    borders: tuple[float, float, float, float]
    """Covered share of the upper, lower, left and right border."""
    centre: float
    """Column of the subject's centre; 0.5 is the picture's centre."""
    median: float
    """Median encoded value of the subject."""
    clipped: float
    """Overexposed share of the subject, without detail."""
    blur: float
    """Crete 2007: 0 sharp, 1 blurred."""


def look(photograph: Photograph, *, looked_at_px: float = _LOOKED_AT_PX) -> Seen:
    """Measure the figures of a photograph.

    Args:
        photograph: 8 or 16 bit.
        looked_at_px: diagonal of the reduced picture in which the subject is searched.
    """
    pixels = np.atleast_3d(photograph.pixels)
    diagonal = float(np.hypot(*photograph.size_wh))
    step = max(1, round(diagonal / looked_at_px))
    largest = np.iinfo(pixels.dtype).max
    # If noise does not matter, every fourth pixel of each row and column is enough.
    thin = 4 if step >= _COARSE_STEP else 1
    levels = np.linspace(0, 1, largest + 1, dtype=np.float32)
    encoded = block_means(np.ascontiguousarray(pixels[::thin, ::thin]), levels, step // thin)
    step = thin * (step // thin)
    subject = segment(encoded, diagonal / step / (2 * _LOOKED_AT_PX))
    where = np.ones(encoded.shape[:2], dtype=bool) if subject is None else subject
    value = encoded @ LUMA if encoded.shape[2] == 3 else encoded[..., 0]
    return Seen(
        cover=0.0 if subject is None else float(where.mean()),
        borders=tuple(float(edge.mean()) for edge in (where[0], where[-1], where[:, 0], where[:, -1])),  # type: ignore[arg-type]
        centre=float(np.nonzero(where)[1].mean() + 0.5) / where.shape[1],
        median=float(np.median(value[where])),
        clipped=float((encoded.max(axis=2)[where] >= _CLIPPED).mean()),
        blur=_blur(pixels, where, step, _CROP_PX if looked_at_px > QUICK_PX else _QUICK_CROP_PX),
    )


def _blur(pixels: Array, where: Bool[Array, "h w"], step: int, side_px: int) -> float:
    """Blur of the centre of the subject at full resolution, from its texture and edges."""
    rows, columns = np.nonzero(where)
    part = []
    for places, length in ((rows, pixels.shape[0]), (columns, pixels.shape[1])):
        low, high = step * int(places.min()), step * (int(places.max()) + 1)
        middle = (low + high) // 2
        part.append(slice(max(0, low, middle - side_px // 2), min(length, high, middle + side_px // 2)))
    cut, largest = pixels[part[0], part[1]], np.iinfo(pixels.dtype).max
    channels = cut.shape[2]  # added one by one, because NumPy's mean over three values is slow
    crop: Float32[Array, "h w"] = sum(cut[..., k].astype(np.float32) for k in range(channels)) / (channels * largest)
    blur = float(blur_effect(crop))  # type: ignore[no-untyped-call]
    return blur if np.isfinite(blur) else 1.0  # all pixels have one value


def judge(seen: Seen, subject_kind: str) -> list[Finding]:
    """Turn the figures into findings.

    Args:
        seen: figures of the photograph.
        subject_kind: ``torso``, which extends beyond the picture, or ``model``, which must be inside.
    """
    return [_sharpness(seen), _exposure(seen), _whole(seen, subject_kind)]


def _sharpness(seen: Seen) -> Finding:
    if seen.blur >= _BLURRED:
        return Finding(
            "sharpness",
            "warn",
            "The photograph looks blurred. Check the focus, ask the patient to hold still, and take it again.",
        )
    return Finding("sharpness", "ok", "Sharp.")


def _exposure(seen: Seen) -> Finding:
    problem = None
    if seen.clipped > _CLIPPED_SHARE:
        problem = f"{seen.clipped:.0%} of the skin is overexposed. Use less light or a smaller aperture."
    elif seen.cover and seen.median < _DARK:
        problem = "The subject is dark. Check the flashes, or use more light."
    elif seen.median > _PALE:
        problem = "The subject is too bright. Use less light or a smaller aperture."
    return Finding("exposure", "warn" if problem else "ok", problem or "Well exposed.")


def _whole(seen: Seen, subject_kind: str) -> Finding:
    names = ("above", "below", "on the left", "on the right")
    problem = None
    if not seen.cover:
        problem = "No subject was found against the background. Check that the patient was in the picture."
    elif seen.cover < _SMALL:
        problem = f"The subject covers only {seen.cover:.0%} of the picture. Check its position."
    elif subject_kind == "model" and (
        cut := [name for name, share in zip(names, seen.borders, strict=True) if share > _AT_BORDER]
    ):
        problem = f"The cast is cut off {' and '.join(cut)}. Move it to the middle."
    elif seen.cover > _LARGE or min(seen.borders) > 0.5:
        problem = "The subject fills the picture. Step back to the mark on the floor."
    elif abs(seen.centre - 0.5) > _OFF_CENTRE:
        side = "left" if seen.centre < 0.5 else "right"
        problem = f"The subject is far to the {side} of the picture. Move to the mark on the floor."
    return Finding("whole", "warn" if problem else "ok", problem or "The subject is in the picture.")
