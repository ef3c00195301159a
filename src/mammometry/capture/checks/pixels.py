"""What the pixels of a photograph say at once.

Is it sharp, well exposed, and is all of the subject in it?

These are warnings for the one who stands beside the rig. Whether it can be measured, the measurement itself decides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from skimage.measure import blur_effect

from mammometry.base.photograph import LUMA, Photograph
from mammometry.capture.checks.found import Found
from mammometry.geometry.arrays import Array, Bool, Float32
from mammometry.matching.foreground.block_segmentation import segment
from mammometry.matching.foreground.silhouette import block_means
from mammometry.matching.settings import ForegroundSettings

_LOOKED_AT_PX = 676.0  # diagonal at which the subject is sought: half of the reference size, as matching does
QUICK_PX = 250.0
"""Diagonal at which it is sought beside a rig, where eight pictures wait for a verdict."""
_COARSE_STEP = 12  # pixels to a block, from which on there are many
_CROP_PX = 800  # side of the part of the subject whose sharpness is looked at; for speed
_QUICK_CROP_PX = 480  # the same beside a rig: a third of the time
_BLURRED = 0.67
"""Blur (Crete 2007: 0 none, 1 all) from which somebody should look. Photographs of torsos by our renderer have .31 to
.36, and .46 to .53, .67 to .73 and .81 to .85 when blurred by a Gaussian σ of 1, 2 and 3 px."""
_DARK, _PALE = 0.25, 0.95  # median of the subject's encoded value; skin of any colour, well lit, lies between
_CLIPPED, _CLIPPED_SHARE = 0.995, 0.02  # encoded value that counts as lost, and share of the subject that may be
_SMALL, _LARGE = 0.08, 0.92  # share of the picture that the subject covers
_AT_BORDER = 0.02  # of a border's length: a cast must not touch it
_OFF_CENTRE = 0.3  # of the picture's width, from the middle to the subject's


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """Figures of one photograph, shares of 1."""

    cover: float
    """Of the picture, by the subject; 0 where none was found."""
    borders: tuple[float, float, float, float]
    """Of the upper, lower, left and right border, by the subject."""
    centre: float
    """Column of the subject's centre; 0.5 is the middle."""
    median: float
    """Encoded value of the subject."""
    clipped: float
    """Of the subject, without any drawing because it is too bright."""
    blur: float
    """By Crete 2007: 0 none, 1 all."""


def look(photograph: Photograph, *, looked_at_px: float = _LOOKED_AT_PX) -> Seen:
    """Measure a photograph's figures.

    Args:
        photograph: 8 or 16 bit.
        looked_at_px: diagonal of the reduced picture in which the subject is sought.
    """
    pixels = np.atleast_3d(photograph.pixels)
    diagonal = float(np.hypot(*photograph.size_wh))
    step = max(1, round(diagonal / looked_at_px))
    largest = np.iinfo(pixels.dtype).max
    # Of a block whose noise does not count, every fourth pixel of each row and column will do.
    thin = 4 if step >= _COARSE_STEP else 1
    levels = np.linspace(0, 1, largest + 1, dtype=np.float32)
    encoded = block_means(np.ascontiguousarray(pixels[::thin, ::thin]), levels, step // thin)
    step = thin * (step // thin)
    subject = segment(encoded, diagonal / step / (2 * _LOOKED_AT_PX), ForegroundSettings().background_margin)
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
    """Of the middle of the subject, at full resolution. Texture and edges count, flat parts do not."""
    rows, columns = np.nonzero(where)
    part = []
    for places, length in ((rows, pixels.shape[0]), (columns, pixels.shape[1])):
        low, high = step * int(places.min()), step * (int(places.max()) + 1)
        middle = (low + high) // 2
        part.append(slice(max(0, low, middle - side_px // 2), min(length, high, middle + side_px // 2)))
    cut, largest = pixels[part[0], part[1]], np.iinfo(pixels.dtype).max
    channels = cut.shape[2]  # added one by one: NumPy's mean over three values is slow
    crop: Float32[Array, "h w"] = sum(cut[..., k].astype(np.float32) for k in range(channels)) / (channels * largest)
    found = float(blur_effect(crop))  # type: ignore[no-untyped-call]
    return found if np.isfinite(found) else 1.0  # nothing but one value


def judge(seen: Seen, subject_kind: str) -> list[Found]:
    """Say what the figures mean.

    Args:
        seen: figures of the photograph.
        subject_kind: ``torso``, which goes on beyond the picture, or ``model``, which must lie within it.
    """
    return [_sharpness(seen), _exposure(seen), _whole(seen, subject_kind)]


def _sharpness(seen: Seen) -> Found:
    if seen.blur >= _BLURRED:
        return Found(
            check="sharpness",
            level="warn",
            sentence="The photograph looks blurred. Check the focus, ask the patient to hold still, and take it again.",
        )
    return Found(check="sharpness", level="ok", sentence="Sharp.")


def _exposure(seen: Seen) -> Found:
    problem = None
    if seen.clipped > _CLIPPED_SHARE:
        problem = f"{seen.clipped:.0%} of the skin is too bright to show anything. Use less light or a smaller opening."
    elif seen.cover and seen.median < _DARK:
        problem = "The subject is dark. Check the flashes, or use more light."
    elif seen.median > _PALE:
        problem = "The subject is too bright. Use less light or a smaller opening."
    return Found(check="exposure", level="warn" if problem else "ok", sentence=problem or "Well exposed.")


def _whole(seen: Seen, subject_kind: str) -> Found:
    names = ("above", "below", "on the left", "on the right")
    problem = None
    if not seen.cover:
        problem = "No subject stands out from the background. Check that the patient was in the picture."
    elif seen.cover < _SMALL:
        problem = f"The subject covers only {seen.cover:.0%} of the picture. Check where it stands."
    elif subject_kind == "model" and (
        cut := [name for name, share in zip(names, seen.borders, strict=True) if share > _AT_BORDER]
    ):
        problem = f"The cast is cut off {' and '.join(cut)}. Move it to the middle."
    elif seen.cover > _LARGE or min(seen.borders) > 0.5:
        problem = "The subject fills the picture. Step back to the mark on the floor."
    elif abs(seen.centre - 0.5) > _OFF_CENTRE:
        side = "left" if seen.centre < 0.5 else "right"
        problem = f"The subject is far to the {side} of the picture. Move to the mark on the floor."
    return Found(check="whole", level="warn" if problem else "ok", sentence=problem or "The subject is in the picture.")
