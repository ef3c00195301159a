"""Size of printed marks by where their dark ends, to find targets that are described wrongly.

The light along lines from the marks' middles outward is taken together to one profile. Its step from dark to bright is
measured at half its height, which blur does not move.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import ndimage

from mammometry.calibration.features.dots import ToImage
from mammometry.calibration.features.found_points import Cause
from mammometry.geometry.arrays import Array, Float32, Float64

_MOST_MARKS = 40
"""Marks that are looked at: as many again would make the median no surer."""
_STEPS = 80
"""Samples along a line, from a tenth of its length on. Chosen by eye."""
_DIRECTIONS = 16
"""Lines from a disc's middle. Chosen by eye."""
_BESIDE = (-0.2, 0.0, 0.2)
"""Places of the lines across a square, in lengths of a line: between its corners for all but the smallest squares."""
_OUTER = 0.7
"""Share of a line beyond which the bright around a mark is sought: a marker's own bright cells end before it."""
_LEAST_MARKS = 4
"""Fewest marks wholly in the picture. Chosen by eye."""
_DARKER = 0.6
"""Largest share of the bright light that the dark has. Chosen by eye."""
_DOUBT_PX, _DOUBT_BLURS = 0.5, 0.5
"""What a step may be off without meaning anything, px and standard deviations of the blur: where a bright gap is
narrower than two of these, half the height is no longer where the step is.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class MarkSize:
    """Size of the marks in one picture."""

    half_mm: float
    """Distance from a mark's middle to its edge, in the target's millimetres."""
    doubt_mm: float
    """What that may be off by the picture's resolution and blur."""

    def contradicts(self, half_mm: float, tolerance: float) -> bool:
        """Whether it is another size than `half_mm`, by more than this share of it and the doubt."""
        off_mm = abs(self.half_mm - half_mm)
        return off_mm > tolerance * half_mm and off_mm > self.doubt_mm

    def cause(self, mark: tuple[str, float], pitch: tuple[str, float]) -> Cause:
        """Say that the marks have another size than ``[target]`` says.

        Args:
            mark: key of the marks' whole size in it, and its value, mm.
            pitch: likewise of their distance, or of the squares around them.
        """
        (mark_key, mark_mm), (pitch_key, pitch_mm) = mark, pitch
        ratio = 2 * self.half_mm / pitch_mm
        return Cause(
            found=f"{mark_key} {ratio:.3f} times {pitch_key}, where [target] says {mark_mm:g} and {pitch_mm:g} mm, "
            f"{mark_mm / pitch_mm:.3f} times",
            remedy=f"Measure both on the print, and correct [target]: to {pitch_key} = {pitch_mm:g} belongs {mark_key} "
            f"= {ratio * pitch_mm:.1f}, to {mark_key} = {mark_mm:g} belongs {pitch_key} = {mark_mm / ratio:.1f}",
        )


def mark_size(
    linear: Float32[Array, "h w"],
    to_image: ToImage,
    centres_mm: Float64[Array, "n 2"],
    *,
    shape: Literal["disc", "square"],
    reach_mm: float,
) -> MarkSize | None:
    """Measure how far dark marks reach from their middles.

    Args:
        linear: the photograph in linear light.
        to_image: from the target's surface, mm, to distorted pixels.
        centres_mm: the marks' middles on the surface.
        shape: whether they are round, or square along the surface's axes.
        reach_mm: distance from a middle to the next dark, or to midway between two marks. A mark ends well before it.

    Returns:
        The size. None where too few marks are in the picture, or they are not darker than what is around them.
    """
    chosen = centres_mm[np.linspace(0, len(centres_mm) - 1, min(len(centres_mm), _MOST_MARKS)).astype(int)]
    away_mm = reach_mm * np.linspace(0.1, 1.0, _STEPS)
    places = chosen[:, None, None] + _lines(shape, reach_mm, away_mm)
    uv = to_image(places.reshape(-1, 2)).reshape(places.shape)
    height, width = linear.shape
    whole = ((uv >= 0) & (uv <= np.array([width - 1, height - 1]))).all(axis=(1, 2, 3))
    if whole.sum() < _LEAST_MARKS:
        return None
    uv = uv[whole]
    light = ndimage.map_coordinates(linear, [uv[..., 1], uv[..., 0]], order=1)
    profile = np.median(light.reshape(-1, _STEPS), axis=0).astype(np.float64)
    outer = profile[int(_OUTER * _STEPS) :]
    bright = _STEPS - 1 - int(outer[::-1].argmax())  # the outermost, where several are saturated
    dark = int(profile[: bright + 1].argmin())
    if profile[dark] > _DARKER * profile[bright]:
        return None
    level = 0.5 * (profile[dark] + profile[bright])
    step = int(np.flatnonzero(profile[dark : bright + 1] <= level)[-1]) + dark  # the last one below, towards bright
    rise = float(profile[step + 1] - profile[step])
    edge = step + (level - float(profile[step])) / rise
    spacing_mm = float(away_mm[1] - away_mm[0])
    px_per_mm = float(np.median(np.linalg.norm(np.diff(uv, axis=2), axis=-1))) / spacing_mm
    steepest = float(np.diff(profile[dark : bright + 1]).max()) / spacing_mm
    blur_mm = float(profile[bright] - profile[dark]) / (steepest * np.sqrt(2 * np.pi))
    return MarkSize(
        half_mm=float(away_mm[0] + edge * spacing_mm), doubt_mm=float(_DOUBT_PX / px_per_mm + _DOUBT_BLURS * blur_mm)
    )


def _lines(shape: Literal["disc", "square"], reach_mm: float, away_mm: Float64[Array, " s"]) -> Float64[Array, "l s 2"]:
    """Places along the lines around a mark's middle, mm."""
    if shape == "disc":
        angle = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
        directions = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return directions[:, None] * away_mm[:, None]
    axes = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    across = axes[:, ::-1]
    return np.concatenate([axes[:, None] * away_mm[:, None] + b * reach_mm * across[:, None] for b in _BESIDE])
