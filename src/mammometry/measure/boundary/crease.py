"""The crease around a breast.

It is the closed curve along which the breast's skin turns most sharply into the trunk's. Every curve s(φ) around the
breast's middle is a path through a table of directions and distances. Dynamic programming finds the smooth one that
gathers most concavity, exactly. So a stretch without a fold (the upper pole of many breasts) is bridged by its
neighbours, and not by whatever is deepest there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mammometry.geometry.arrays import Array, Bool, Float64, read_only
from mammometry.measure.settings import BreastSettings
from mammometry.measure.trunk.skin_map import Relief

CREASE_PER_MM = 0.01
"""Concavity that counts half as a crease, 1/mm, twice a mean curvature. A chest has below .005, a fold .1 to 1."""
DIRECTIONS = 144  # from the breast's middle in which its end is looked for, 2.5° apart
_SIGMA_MM = 4.0
"""Scale at which the skin's curvature is looked at, mm: wider than the matcher's and the skin's unevenness, narrower
than a fold."""
_VANISH_MM = 2.0  # height over the thorax fit at which a breast ends; the fit's own scatter is 1–2 mm
_HEIGHT_COST = 0.05
"""Cost, in creases, of a boundary on skin that stands as high again above that level. Weak: it only keeps the boundary
out of the nipple's and other creases on the breast."""
_STIFFNESS = 0.05
"""Cost, in creases, of a boundary that moves in or out by 1 mm from one direction to the next. Grows with the square
of the movement. Chosen by eye.
"""
_RISE_MM = 6.0  # skin that rises again by this much belongs to something else (arm, belly, other breast)
_STEP_MM = 1.0  # of the table of distances
_LEVEL_MM = 1.0  # over 8 mm: skin that rises or falls less is level; chosen by eye
_TURNS = 3  # of the dynamic programming: one to forget the ends on either side of the one that is kept
_FURTHEST_STEPS = 3  # that the curve may move in or out from one direction to the next; 50° from the tangent at 60 mm
_SHIFT_MM = 15.0  # farthest that the outer flank is looked for outside the crease; chosen by eye
_FORBIDDEN = -1e3  # worth of a place where a breast cannot end


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Crease:
    """A closed curve around a breast, laid flat."""

    flat: Float64[Array, "n 2"]
    """(half width × θ, y), mm, anticlockwise from the patient's left."""
    concavity_per_mm: Float64[Array, " n"]
    """Concavity of the crease in each direction, 1/mm."""
    seen: Bool[Array, " n"]
    """Whether the skin is visible there."""
    blur_mm: Float64[Array, " n"]
    """Half the distance over which the concavity halves outside the crease, mm: how sharply it ends."""

    def __post_init__(self) -> None:
        for name in ("flat", "concavity_per_mm", "seen", "blur_mm"):
            object.__setattr__(self, name, read_only(getattr(self, name)))


def follow_crease(relief: Relief, middle: Float64[Array, 2], settings: BreastSettings = BreastSettings()) -> Crease:
    """Follow the crease around a breast.

    The concavity κ of the relief, smoothed over σ, is worth κ/(κ + κ₀) where it is positive, and less where skin rises
    outside it more than it falls to it from the breast: that is the foot of something else. Skin that stands higher
    than the level at which a breast ends costs. The curve is then drawn on the crease's outer flank, where κ has fallen
    to half. Where curved skin joins straight skin, smoothing spreads the joint evenly to both sides: half is its place.

    Args:
        relief: the skin laid flat.
        middle: the breast's middle on it, mm.
        settings: how far out the crease may lie.
    """
    count = DIRECTIONS
    angles = np.arange(count) * 2 * np.pi / count
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    steps = np.arange(_STEP_MM, settings.reach_mm, _STEP_MM)
    places = middle + rays[:, None] * steps[:, None]
    bulge = relief.at(places, relief.smooth_mm(_SIGMA_MM))
    concavity = relief.at(places, relief.concavity_per_mm(_SIGMA_MM))
    allowed = _beyond_the_top(bulge) & relief.within(places)
    worth = np.clip(concavity, 0.0, None) / (np.clip(concavity, 0.0, None) + CREASE_PER_MM) * _own(bulge)
    worth = worth - np.clip(bulge / _VANISH_MM - 1, 0.0, None) * _HEIGHT_COST
    way = _best_way(np.where(allowed, worth, _FORBIDDEN), _STIFFNESS)
    deepest = concavity[np.arange(count), way]
    flank_mm = _outer_flank_mm(concavity, way)
    reach = steps[way] + flank_mm
    # Smooth as the directions' own distances are, in mm along the curve.
    apart = float(np.mean(reach)) * 2 * np.pi / count
    reach = np.asarray(gaussian_filter1d(reach, _SIGMA_MM / apart, mode="wrap"))
    flat = middle + rays * reach[:, None]
    return Crease(
        flat=flat,
        concavity_per_mm=deepest,
        seen=relief.at(flat, relief.known.astype(np.float64)) > 0.5,
        blur_mm=flank_mm / 2,
    )


def _beyond_the_top(bulge: Float64[Array, "d s"]) -> Bool[Array, "d s"]:
    """Where a breast may end, as a mask.

    From where it has fallen to half its height until the skin rises again for good.
    """
    top = np.maximum.accumulate(bulge, axis=1)
    low = bulge < np.maximum(top / 2, _VANISH_MM)
    begun = np.maximum.accumulate(low, axis=1)
    lowest = np.minimum.accumulate(np.where(begun, bulge, np.inf), axis=1)
    risen = begun & (bulge > np.maximum(lowest, 0.0) + _RISE_MM)
    allowed = begun & ~np.maximum.accumulate(risen, axis=1)
    allowed[~allowed.any(axis=1)] = True  # nothing is known here; the neighbours decide
    return allowed


def _own(bulge: Float64[Array, "d s"]) -> Float64[Array, "d s"]:
    """How far a crease is the breast's own, 0 to 1: skin falls to it from inside at least as much as it rises outside.

    At the foot of something else (arm, belly, the other breast hanging lower than the trunk goes) it only rises.
    """
    reach = round(2 * _SIGMA_MM / _STEP_MM)
    padded = np.pad(bulge, ((0, 0), (reach, reach)), mode="edge")
    fall, rise = padded[:, : -2 * reach] - bulge, padded[:, 2 * reach :] - bulge
    return np.clip((np.maximum(fall, 0) + _LEVEL_MM) / (np.maximum(rise, 0) + _LEVEL_MM), 0.0, 1.0)


def _best_way(worth: Float64[Array, "d s"], stiffness: float) -> Array:
    """Closed path of greatest worth − stiffness × (change of step)².

    One step for each direction. Dynamic programming over several turns: in the middle one the ends no longer matter,
    and the path closes by itself.
    """
    count, length = worth.shape
    shifts = np.arange(-_FURTHEST_STEPS, _FURTHEST_STEPS + 1)
    best = worth[0].copy()
    came = np.zeros((_TURNS * count, length), dtype=np.int64)
    for turn in range(1, _TURNS * count):
        padded = np.pad(best, _FURTHEST_STEPS, constant_values=-1e9)
        options = np.stack([padded[_FURTHEST_STEPS + shift :][:length] - stiffness * shift**2 for shift in shifts])
        chosen = np.argmax(options, axis=0)
        came[turn] = np.arange(length) + shifts[chosen]
        best = options[chosen, np.arange(length)] + worth[turn % count]
    way = np.empty(_TURNS * count, dtype=np.int64)
    way[-1] = int(np.argmax(best))
    for turn in range(_TURNS * count - 1, 0, -1):
        way[turn - 1] = came[turn, way[turn]]
    return way[count : 2 * count]


def _outer_flank_mm(concavity: Float64[Array, "d s"], way: Array) -> Float64[Array, " d"]:
    """Distance outside the path at which the concavity has halved, mm.

    0 where there is no crease.
    """
    count, length = concavity.shape
    ahead = way[:, None] + np.arange(int(_SHIFT_MM / _STEP_MM) + 1)
    along = concavity[np.arange(count)[:, None], np.minimum(ahead, length - 1)]
    half = along[:, :1] / 2
    fallen = along < half
    first = np.where(fallen.any(axis=1), np.argmax(fallen, axis=1), 0)
    row = np.arange(count)
    above, below = along[row, np.maximum(first - 1, 0)], along[row, first]
    share = np.divide(above - half[:, 0], above - below, out=np.zeros(count), where=above > below)
    return np.where(first > 0, (first - 1 + share) * _STEP_MM, 0.0)
