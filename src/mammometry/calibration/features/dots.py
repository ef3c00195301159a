"""Sub-pixel centre and size of dark dots and other printed marks.

The centre is the centroid of its darkness, corrected for perspective and curvature. Darkness is the share of a pixel
that the dot covers, between the background's light and the dot's own, each a plane. A plain difference to the
background would weigh the lit side of a dot more, and move the centroid of a disc of radius r by r²/4 times the
relative slope of the light: 0.25 px for a dot of 20 px in light that falls by 1 % a pixel. The dot's own plane, from
its middle, distinguishes light that falls off from gloss and haze, which add to dot and background alike. The centroid
of a dot's picture is not the picture of its centre. With a smooth map from the surface to the picture the difference is
known: it is computed from the map over the dot's area, and taken off.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import ndimage

from mammometry.base.normal import MAD
from mammometry.calibration.features.pixels import Cause
from mammometry.geometry.arrays import Array, Bool, Float32, Float64

_BLUR_PX = 2.0
"""Width of a dot's blurred rim, px."""
_RING_PX = 3.0
"""Width of the ring of background around a dot, px."""
_RING_LIMIT = 0.85
"""Largest reach of the background ring, as share of the way to the neighbouring dot."""
_MIN_RING_PIXELS = 20
"""Fewest pixels of the ring for a plane of background light. Chosen by eye."""
_MIN_CORE_PIXELS = 12
"""Fewest pixels in the middle of a dot for a plane of its own light. Chosen by eye."""
_MIN_CONTRAST = 0.15
"""Least share of the background's light that a dot absorbs. Chosen by eye."""
_QUADRATURE = 6
"""Gauss nodes along an axis, exact to the eleventh order."""
_MIN_HALF_PX = 1.5
"""Half-width of the smallest dot that is measured, px: below it, the whole dot is blurred rim."""

ROUNDS = 2
"""Measurements of a picture's dots, each with the map or camera of the one before. Chosen by eye."""
MAX_OFF = 0.15
"""Largest distance of a disc from where all others put it, in diameters."""
SIZE_OFF = 0.1
"""Share by which dots may differ from their stated size: rulers and ink err by .5 mm of a small dot."""

ToImage = Callable[[Float64[Array, "*n 2"]], Float64[Array, "*n 2"]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dots:
    """Measured dots. Rows with `ok` False carry no meaning."""

    uv: Float64[Array, "n 2"]
    """Picture of the dot's centre, distorted pixels."""
    covariance_px2: Float64[Array, "n 2 2"]
    """From the background's noise, px²."""
    mass_mm2: Float64[Array, " n"]
    """Area on the surface of the darkness, if the dot were as dark as the darkest tenth of its pixels."""
    ok: Bool[Array, " n"]


def measure_dots(
    linear: Float32[Array, "h w"],
    to_image: ToImage,
    centres_mm: Float64[Array, "n 2"],
    *,
    shape: Literal["disc", "square"],
    half_mm: float,
    pitch_mm: tuple[float, float],
) -> Dots:
    """Measure dots with places known to a third of their size.

    Args:
        linear: the photograph in linear light.
        to_image: from the surface, mm, to distorted pixels.
        centres_mm: dots on the surface.
        shape: a disc's radius or half a square's side is `half_mm`.
        half_mm: half the size of a dot.
        pitch_mm: distance to the next dot along the two axes of the surface.
    """
    count = len(centres_mm)
    uv, covariance = np.zeros((count, 2)), np.zeros((count, 2, 2))
    mass, ok = np.zeros(count), np.zeros(count, bool)
    step = 0.05 * half_mm
    columns = [(to_image(centres_mm + d) - to_image(centres_mm - d)) / (2 * step) for d in np.eye(2) * step]
    jacobians = np.stack(columns, axis=-1)
    centres_px = to_image(centres_mm)
    for k in range(count):
        start = centres_px[k]
        for centred in (False, True):
            measured = _darkness_centroid(linear, start, jacobians[k], shape, half_mm, pitch_mm, centred=centred)
            if measured is None:
                break
            start = measured[0]
        if measured is not None:
            uv[k], covariance[k], mass[k] = measured
            ok[k] = True
    offset = area_centroids(to_image, centres_mm, shape, half_mm) - centres_px
    return Dots(uv=uv - offset, covariance_px2=covariance, mass_mm2=mass, ok=ok)


def area_centroids(
    to_image: ToImage, centres_mm: Float64[Array, "n 2"], shape: Literal["disc", "square"], half_mm: float
) -> Float64[Array, "n 2"]:
    """Centroids of the pictures of dots, pixels. Gauss quadrature of the map over the dot's area."""
    node, weight = np.polynomial.legendre.leggauss(_QUADRATURE)
    if shape == "square":
        offsets = np.stack(np.meshgrid(node, node), axis=-1).reshape(-1, 2)
        weights = np.outer(weight, weight).ravel()
    else:
        radius = (node + 1) / 2
        angle = np.arange(2 * _QUADRATURE) * np.pi / _QUADRATURE
        offsets = (radius[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)).reshape(-1, 2)
        weights = np.repeat(weight * radius, len(angle))
    points = centres_mm[:, None] + half_mm * offsets
    step = 0.01 * half_mm
    along_x, along_y = (to_image(points + d) - to_image(points - d) for d in np.eye(2) * step)
    area = np.abs(along_x[..., 0] * along_y[..., 1] - along_x[..., 1] * along_y[..., 0]) * weights
    centroid: Float64[Array, "n 2"] = (to_image(points) * area[..., None]).sum(axis=1) / area.sum(axis=1)[:, None]
    return centroid


def _darkness_centroid(
    linear: Float32[Array, "h w"],
    start: Float64[Array, 2],
    jacobian: Float64[Array, "2 2"],
    shape: Literal["disc", "square"],
    half_mm: float,
    pitch_mm: tuple[float, float],
    *,
    centred: bool,
) -> tuple[Float64[Array, 2], Float64[Array, "2 2"], float] | None:
    """Centroid of the dot's share of each pixel.

    Within its outline and its blur. The background is a plane, from a ring. If `start` is `centred`, the middle of the
    dot is known to be dark, and its light is taken from there.
    """
    inverse = np.linalg.inv(jacobian)
    mm_per_px = np.linalg.norm(inverse, axis=1)
    if (half_mm / mm_per_px).min() < _MIN_HALF_PX:
        return None
    inner_mm = half_mm + _BLUR_PX * mm_per_px
    outer_mm = np.minimum(inner_mm + _RING_PX * mm_per_px, _RING_LIMIT * (np.array(pitch_mm) - half_mm))
    reach = np.ceil(np.abs(jacobian) @ outer_mm).astype(int) + 1
    first = np.rint(start).astype(int) - reach
    last = np.rint(start).astype(int) + reach + 1
    if (first < 0).any() or last[0] > linear.shape[1] or last[1] > linear.shape[0]:
        return None
    y, x = np.mgrid[first[1] : last[1], first[0] : last[0]]
    dx, dy = x - start[0], y - start[1]
    a = (inverse[0, 0] * dx + inverse[0, 1] * dy) / inner_mm[0]
    b = (inverse[1, 0] * dx + inverse[1, 1] * dy) / inner_mm[1]
    wide = outer_mm / inner_mm
    if shape == "square":
        inside = np.maximum(np.abs(a), np.abs(b)) <= 1
        ring = ~inside & (np.abs(a) <= wide[0]) & (np.abs(b) <= wide[1])
    else:
        inside = np.hypot(a, b) <= 1
        ring = ~inside & (np.hypot(a / wide[0], b / wide[1]) <= 1)
    if ring.sum() < _MIN_RING_PIXELS:
        return None
    value = linear[first[1] : last[1], first[0] : last[0]].astype(np.float64)
    design = np.stack([np.ones_like(a), a, b], axis=-1)
    use = ring.copy()
    for _ in range(2):
        plane = np.linalg.lstsq(design[use], value[use], rcond=None)[0]
        residual = value - design @ plane
        noise = MAD * float(np.median(np.abs(residual[use])))
        use = ring & (np.abs(residual) < 3.5 * noise + 1e-4)  # half of them at least: their median is nearer
    background = design @ plane
    if background[inside].min() <= 0:
        return None
    contrast = -residual / background
    depth = np.full_like(contrast, np.percentile(contrast[inside], 90))
    if depth[0, 0] < _MIN_CONTRAST:
        return None
    core_mm = half_mm - _BLUR_PX * mm_per_px
    if centred and core_mm.min() > 0:
        core = np.hypot(a * inner_mm[0] / core_mm[0], b * inner_mm[1] / core_mm[1]) <= 1
        if core.sum() >= _MIN_CORE_PIXELS:
            dark = design @ np.linalg.lstsq(design[core], contrast[core], rcond=None)[0]
            depth = np.maximum(dark, depth / 2)
    share = np.where(inside, contrast / depth, 0.0)
    total = float(share.sum())
    shift = np.array([(share * dx).sum(), (share * dy).sum()]) / total
    if np.abs(inverse @ shift).max() > 0.5 * half_mm:
        return None
    arm = np.stack([(dx - shift[0])[inside], (dy - shift[1])[inside]], axis=1)
    noise_share = noise / (plane[0] * np.median(depth))
    covariance = noise_share**2 * (arm.T @ arm) / total**2
    return start + shift, covariance, total / float(np.abs(np.linalg.det(jacobian)))


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
narrower than two of these, half the height is no longer where the step is."""


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
