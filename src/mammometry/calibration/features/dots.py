"""Sub-pixel centre and size of dark dots and other printed marks.

The centre is the centroid of darkness, corrected for perspective and curvature. Darkness is the share of a pixel that
the dot covers, between the background's light and the dot's own, each a plane. A plain difference to the background
would give the lit side of a dot more weight. In light with a relative gradient g, the centroid of a disc of radius r
would move by g r²/4: 0.25 px for a dot of 20 px in light that falls by 1 % per pixel. The dot's own plane, from its
middle, distinguishes falling light from gloss and haze, which add the same light to dot and background. The centroid of
a dot's image is not the image of its centre. The difference is computed from the map over the dot's area and
subtracted.
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
"""Width of a dot's blurred edge, px."""
_RING_PX = 3.0
"""Width of the ring of background around a dot, px."""
_RING_LIMIT = 0.85
"""Largest radius of the background ring, as a share of the distance to the neighbouring dot."""
_MIN_RING_PIXELS = 20
"""Fewest pixels of the ring for a plane of background light, whose three parameters then have six pixels each."""
_MIN_CORE_PIXELS = 12
"""Fewest pixels in the middle of a dot for a plane of its own light: four for each of its three parameters."""
_MIN_CONTRAST = 0.15
"""Least share of the background's light that a dot absorbs. Assumed; its effect has not been measured."""
_QUADRATURE = 6
"""Gauss nodes along an axis, exact to the eleventh order."""
_MIN_HALF_PX = 1.5
"""Half-width of the smallest dot that is measured, px: a smaller one consists of blurred edge only."""

ROUNDS = 2
"""Repeated measurements of an image's dots, each with the map or camera of the one before."""
MAX_OFF = 0.15
"""Largest distance of a disc from the position predicted by all others, in diameters."""
SIZE_OFF = 0.1
"""Largest relative difference of dots from their stated size: rulers and ink err by 0.5 mm of a small dot."""

ToImage = Callable[[Float64[Array, "*n 2"]], Float64[Array, "*n 2"]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dots:
    """Measured dots. Rows with `ok` False are meaningless."""

    uv: Float64[Array, "n 2"]
    """Image of the dot's centre, distorted pixels."""
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
    """Measure dots whose positions are known to a third of their size.

    Args:
        linear: the photograph in linear light.
        to_image: from the surface, mm, to distorted pixels.
        centres_mm: dots on the surface.
        shape: `half_mm` is a disc's radius or half a square's side.
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
    """Centroids of the images of dots, px, by Gauss quadrature of the map over the dot's area."""
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
    """Centroid of the dot's share of each pixel, within its outline and blur.

    The background is a plane fitted to a ring. With `centred`, `start` is accurate enough for the middle of the dot to
    be dark, and the dot's own light is measured there.
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
        use = ring & (np.abs(residual) < 3.5 * noise + 1e-4)  # keeps at least half of them: 3.5 σ exceed the median
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
"""Marks that are measured: more would not make the median more accurate."""
_STEPS = 80
"""Samples along a line, from a tenth of its length on."""
_DIRECTIONS = 16
"""Lines from a disc's centre."""
_BESIDE = (-0.2, 0.0, 0.2)
"""Positions of the lines across a square, in lengths of a line. They miss its corners, except for the smallest
squares."""
_OUTER = 0.7
"""Share of a line beyond which the bright surroundings begin. The bright cells inside a marker are before it."""
_LEAST_MARKS = 4
"""Fewest marks completely in the image."""
_DARKER = 0.6
"""Largest brightness of the dark, relative to the bright."""
_DOUBT_PX, _DOUBT_BLURS = 0.5, 0.5
"""Uncertainty of a step's position, px and standard deviations of the blur. If a bright gap is narrower than twice
this, the step is no longer at half the height."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MarkSize:
    """Size of the marks in one image."""

    half_mm: float
    """Distance from a mark's centre to its edge, mm."""
    doubt_mm: float
    """Uncertainty from the image's resolution and blur."""

    def contradicts(self, half_mm: float, tolerance: float) -> bool:
        """Whether the mark's half width differs from `half_mm` by more than this share plus the uncertainty."""
        off_mm = abs(self.half_mm - half_mm)
        return off_mm > tolerance * half_mm and off_mm > self.doubt_mm

    def cause(self, mark: tuple[str, float], pitch: tuple[str, float]) -> Cause:
        """Explain that the marks' size differs from ``[target]``.

        Args:
            mark: key of the marks' size in ``[target]``, and its value, mm.
            pitch: key and value of their distance, or of the squares around them.
        """
        (mark_key, mark_mm), (pitch_key, pitch_mm) = mark, pitch
        ratio = 2 * self.half_mm / pitch_mm
        return Cause(
            found=f"{mark_key} {ratio:.3f} times {pitch_key}, but in [target] {mark_mm:g} and {pitch_mm:g} mm, "
            f"{mark_mm / pitch_mm:.3f} times",
            remedy=f"Measure both on the print, and correct [target]: either {pitch_key} = {pitch_mm:g} and {mark_key} "
            f"= {ratio * pitch_mm:.1f}, or {mark_key} = {mark_mm:g} and {pitch_key} = {mark_mm / ratio:.1f}",
        )


def mark_size(
    linear: Float32[Array, "h w"],
    to_image: ToImage,
    centres_mm: Float64[Array, "n 2"],
    *,
    shape: Literal["disc", "square"],
    reach_mm: float,
) -> MarkSize | None:
    """Measure the distance from the centres of dark marks to their edges.

    Args:
        linear: the photograph in linear light.
        to_image: from the target's surface, mm, to distorted pixels.
        centres_mm: centres of the marks on the surface.
        shape: whether they are round, or square along the surface's axes.
        reach_mm: distance from a centre to the next dark area, or to midway between two marks. A mark ends well before
            it.

    Returns:
        The size. None if too few marks are in the image, or they are not darker than their surroundings.
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
    bright = _STEPS - 1 - int(outer[::-1].argmax())  # the outermost one, if several are saturated
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
    """Points along the lines around a mark's centre, mm."""
    if shape == "disc":
        angle = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
        directions = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return directions[:, None] * away_mm[:, None]
    axes = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    across = axes[:, ::-1]
    return np.concatenate([axes[:, None] * away_mm[:, None] + b * reach_mm * across[:, None] for b in _BESIDE])
