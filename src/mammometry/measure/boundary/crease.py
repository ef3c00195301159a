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
from mammometry.measure.trunk.skin_map import PIXEL_MM, Relief

CREASE_PER_MM = 0.01
"""Concavity that counts half as a crease, 1/mm, twice a mean curvature. A chest has below .005, a fold .1 to 1."""
DIRECTIONS = 144  # from the breast's middle in which its end is looked for, 2.5° apart
_SIGMA_MM = 4.0
"""Scale at which the skin's curvature is looked at, mm: wider than the matcher's and the skin's unevenness, narrower
than a fold."""
_FINE_MM = 2.0  # scale at which the same crease is looked at again, to tell how abrupt it is, mm; one pixel
_HALVED_SIGMAS = (0.0, 1.18, 1.92)
"""Distance outside a bend of skin at which its concavity, smoothed by a Gaussian, has fallen to half, in σ: where
curvature steps, where slope steps (a crease), where height steps (a fold under an overhang). Closed forms."""
_NEAR_STEPS = 6  # steps on either side of the path in which the crease is looked for at the finer scale
_EVEN_DIRECTIONS = 3.0  # over which abruptness is averaged; chosen by eye
_VANISH_MM = 2.0  # height over the thorax fit at which a breast ends; the fit's own scatter is 1–2 mm
_HEIGHT_COST = 0.05
"""Cost, in creases, of a boundary on skin that stands as high again above that level. Weak: it only keeps the boundary
out of the nipple's and other creases on the breast."""
_STIFFNESS = 0.05
"""Cost, in creases, of a boundary that moves in or out by 1 mm from one direction to the next. Grows with the square
of the movement. Chosen by eye.
"""
_RISE_MM = 6.0  # skin that rises again by this much belongs to something else (arm, belly, other breast)
_SUNK_MM = 12.0
"""Skin this far behind the thorax fit is no trunk: it has ended there. The fit itself takes skin beyond 12 mm (three
scatters of 4 mm) for something else; its own errors are 2 to 6 mm."""
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
    to half, less what smoothing has put outside: nothing where curved skin joins straight skin, up to 2 σ at a fold.

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
    worth = crease_worth(concavity) * _own(bulge)
    worth = worth - np.clip(bulge / _VANISH_MM - 1, 0.0, None) * _HEIGHT_COST
    way = _best_way(np.where(allowed, worth, _FORBIDDEN), _STIFFNESS)
    deepest = concavity[np.arange(count), way]
    flank_mm = _outer_flank_mm(concavity, allowed, way)
    fine = relief.at(places, relief.concavity_per_mm(_FINE_MM))
    # Each pixel has its innermost skin, which is that of its outer edge: half a pixel too far in.
    reach = steps[way] + flank_mm - _smeared_mm(concavity, fine, way) + PIXEL_MM / 2
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


def crease_worth(concavity_per_mm: Float64[Array, "*n"]) -> Float64[Array, "*n"]:
    """How far places are a crease, 0 to 1.

    By their concavity κ, 1/mm: κ/(κ + κ₀) where it is positive.
    """
    concave = np.clip(concavity_per_mm, 0.0, None)
    return np.asarray(concave / (concave + CREASE_PER_MM))


def _beyond_the_top(bulge: Float64[Array, "d s"]) -> Bool[Array, "d s"]:
    """Where a breast may end, as a mask.

    From where it has fallen to half its height until the skin rises again for good, or the trunk ends.
    """
    top = np.maximum.accumulate(bulge, axis=1)
    low = bulge < np.maximum(top / 2, _VANISH_MM)
    begun = np.maximum.accumulate(low, axis=1)
    lowest = np.minimum.accumulate(np.where(begun, bulge, np.inf), axis=1)
    risen = begun & (bulge > np.maximum(lowest, 0.0) + _RISE_MM)
    ended = risen | (begun & (bulge < -_SUNK_MM))
    allowed = begun & ~np.maximum.accumulate(ended, axis=1)
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


def _outer_flank_mm(concavity: Float64[Array, "d s"], allowed: Bool[Array, "d s"], way: Array) -> Float64[Array, " d"]:
    """Distance outside the path at which the concavity has halved, or a breast can no longer end, mm.

    0 where there is no crease.
    """
    count, length = concavity.shape
    ahead = way[:, None] + np.arange(int(_SHIFT_MM / _STEP_MM) + 1)
    along = np.where(allowed, concavity, 0.0)[np.arange(count)[:, None], np.minimum(ahead, length - 1)]
    half = along[:, :1] / 2
    fallen = along < half
    first = np.where(fallen.any(axis=1), np.argmax(fallen, axis=1), 0)
    row = np.arange(count)
    above, below = along[row, np.maximum(first - 1, 0)], along[row, first]
    share = np.divide(above - half[:, 0], above - below, out=np.zeros(count), where=above > below)
    return np.where(first > 0, (first - 1 + share) * _STEP_MM, 0.0)


def _smeared_mm(concavity: Float64[Array, "d s"], fine: Float64[Array, "d s"], way: Array) -> Float64[Array, " d"]:
    """How far outside the crease smoothing has put the place at which the concavity halves, mm.

    With the scale σ the concavity of a step in curvature stays, that of a step in slope falls as 1/σ, that of a step in
    height as 1/σ². So two scales tell which it is.
    """
    count, length = concavity.shape
    near = np.clip(way[:, None] + np.arange(-_NEAR_STEPS, _NEAR_STEPS + 1), 0, length - 1)
    row = np.arange(count)[:, None]
    coarse_peak, fine_peak = (np.clip(each[row, near].max(axis=1), 1e-9, None) for each in (concavity, fine))
    order = np.clip(np.log(fine_peak / coarse_peak) / np.log(_SIGMA_MM / _FINE_MM), 0.0, 2.0)
    order = np.where(coarse_peak > CREASE_PER_MM, order, 0.0)
    smeared_mm = _SIGMA_MM * np.interp(order, np.arange(3), _HALVED_SIGMAS)
    return np.asarray(gaussian_filter1d(smeared_mm, _EVEN_DIRECTIONS, mode="wrap"))
