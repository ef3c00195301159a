"""The border of a breast: its crease, and where there is none, what breasts are like.

The crease is where the breast's skin turns most sharply into the trunk's. Every curve s(φ) around the breast's middle
is a path through a table of directions and distances (`weigh_paths`). Where no crease is (the upper pole of many
breasts), the neighbours, the skin's height and the shape of real women's boundaries decide, and not what is deepest.

A path has one distance from the middle for each direction, so it cannot cross itself. What a distance is worth in a
direction and what moving in or out costs add up, so sums over all paths need only neighbouring directions. The mean of
all paths, unlike the best of them, changes little where the evidence changes little.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.ndimage import correlate1d, gaussian_filter1d
from scipy.special import softmax

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.measure.trunk.skin_map import KNOWN_MM, PIXEL_MM, Relief
from mammometry.measure.trunk.thorax import CHEST_SCALE_MM, CUT_OFF

_TURNS = 2  # around the middle: in the first the start is forgotten
_FURTHEST_STEPS = 3  # that a path may move in or out from one direction to the next; 50° from the tangent at 60 mm
_LEAST_SHARE = 1e-100  # arrives anywhere, so that what comes from both sides never has the product 0
_SHIFTS = np.arange(-_FURTHEST_STEPS, _FURTHEST_STEPS + 1)


@value(eq=False)
class WeighedPaths:
    """All closed paths through each of several tables."""

    mean_steps: Float64[Array, "k d"]
    """Mean step of each direction."""
    spread_steps: Float64[Array, "k d"]
    """Standard deviation of each direction's step."""
    evidence: Float64[Array, " k"]
    """Logarithm of the sum of all paths' weights."""


def weigh_paths(log_weights: Float64[Array, "k d s"], stiffness: float) -> WeighedPaths:
    """Weigh the closed paths through each table.

    A path's weight is the exponential of its log weights' sum − stiffness × (change of step)².
    """
    highest = log_weights.max(axis=2)
    weights = np.moveaxis(np.exp(log_weights - highest[:, :, None]), 1, 0)
    moves = np.exp(-stiffness * _SHIFTS**2)
    ahead, growth = _arriving(weights, moves)
    back, _ = _arriving(weights[::-1], moves)
    share = ahead * weights * back[::-1]
    share /= share.sum(axis=2, keepdims=True)
    steps = np.arange(weights.shape[2])
    mean = share @ steps
    variance = np.maximum(share @ steps**2 - mean**2, 0.0)
    return WeighedPaths(mean_steps=mean.T, spread_steps=np.sqrt(variance).T, evidence=growth + highest.sum(axis=1))


def _arriving(
    weights: Float64[Array, "d k s"], moves: Float64[Array, " m"]
) -> tuple[Float64[Array, "d k s"], Float64[Array, " k"]]:
    """Share of the weight that arrives at each step from the directions before, and its log growth in one turn."""
    arriving = np.empty_like(weights)
    before = np.full(weights.shape[1:], 1 / weights.shape[2])
    for _ in range(_TURNS):
        growth = np.zeros(weights.shape[1])
        for direction, own in enumerate(weights):
            arriving[direction] = before
            before = correlate1d(before * own, moves, axis=1, mode="constant")
            total = before.sum(axis=1)
            before = np.maximum(before / total[:, None], _LEAST_SHARE)
            growth += np.log(total)
    return arriving, growth


FARTHEST_BORDER_MM = 140.0
"""Farthest a boundary lies from the breast's middle, mm."""
CREASE_PER_MM = 0.01
"""Concavity from which the skin has a crease, 1/mm, twice a mean curvature. A chest has below .005, a fold .1 to 1."""
DIRECTIONS = 144  # from the breast's middle in which its end is looked for, 2.5° apart
_SIGMA_MM = 2 * PIXEL_MM
"""Scale at which the skin's curvature is looked at, mm: wider than the matcher's and the skin's unevenness, narrower
than a fold."""
_FINE_MM = PIXEL_MM  # scale at which the same crease is looked at again, to tell how abrupt it is, mm
_HALVED_SIGMAS = (0.0, 1.18, 1.92)
"""Distance outside a bend of skin at which its concavity, smoothed by a Gaussian, has fallen to half, in σ: where
curvature steps, where slope steps (a crease), where height steps (a fold under an overhang). Closed forms."""
_NEAR_STEPS = 6  # steps on either side of the path in which the crease is looked for at the finer scale
_EVEN_DIRECTIONS = 3.0  # over which abruptness is averaged; chosen by eye
_VANISH_MM = 2.0  # height over the thorax fit at which a breast ends; the fit's own scatter is 1–2 mm
_CREASE = 0.6  # worth of a crease of .017 per mm; a fold's, .1 per mm, is 1.4
_HEIGHT_COST, _MOST_HEIGHT_COST, _MOST_FLANK_COST = 0.05, 0.3, 0.5
"""Cost of a border on skin that stands as high again above that level, and its limit. Weak: it only keeps the border
out of the nipple's and other creases on the breast. A trunk that is fitted beside breasts is off by more above them.
The same again, with its own limit, for skin that stands out by more than such a trunk is off: a breast's flank."""
_TRUNK_OFF_MM = 20.0  # by which a trunk may lie too deep above the breasts, 10 to 20 mm: a muscle stands out by that
_STIFFNESS = 0.1
"""Cost of a border that moves in or out by 1 mm from one direction to the next. Grows with the square of the movement.
Chosen by eye."""
_USUAL_SHAPE = np.array([0.43, 0.54, 0.67, 0.55, 0.47, 0.58, 0.62, 0.59])
"""Distance of real women's boundaries from their middle over the root of their area, every 45° from lateral upwards:
the mean of 145 breasts (docs/decisions/0029). One woman's differ from it by .04, 7 %."""
_SHAPE_SCATTER, _UNLIKE_COST = 0.12, 0.03
"""Relative scatter about that shape that is expected of bodies in other poses, and what one scatter costs. A fold holds
the border against four."""
_SIZES_MM = np.geomspace(80.0, 180.0, 11)
"""Roots of a base's area that are tried, mm: 64 to 324 cm²."""
_SIZE_SCATTER, _SIZE_COST = 0.12, 5.0
"""Relative scatter of that root about what the breast's dome tells, and what one scatter costs in all."""
_CENTRINGS = 3  # times that the border is looked for about its own middle; chosen by eye
_NATS, _SIZE_NATS = 2.0, 0.2
"""Log of how much more probable a curve is that gathers 1 more, and a size whose curves gather 1 more: neighbouring
directions err alike, so that a size has less evidence than their sum. Calibrated on virtual women (decision 43)."""
_ERR_ALIKE = 2.4
"""Error of a border over its paths' spread, for the same reason: 1 on virtual scans, 2.6 on the hanging families."""
_GOES_ON = 1 / 3  # of its height: where skin outside its border stands out more, the breast goes on; chosen by eye
_ENDED_MM, _UNSEEN_SCATTER = 18.0, 0.3
"""A border this near to the end of the seen skin may be anywhere beyond: its scatter there, as a share of its distance
from the middle. Chosen by eye: large breasts of held-out captures go on by 30 to 50 mm above what is laid flat."""
_FALLEN = 0.9  # share of the height to which a breast has fallen before it may end; .68 moves 4 % of an interval
_RISE_MM = 6.0  # skin that rises again by this much belongs to something else (arm, belly, other breast)
_SUNK_MM = CUT_OFF * CHEST_SCALE_MM
"""Skin this far behind the thorax fit is no trunk: it has ended there, as skin so far before it is something else to
the fit itself, whose own errors are 2 to 6 mm."""
_STEP_MM = 1.0  # of the table of distances
_LEVEL_MM = 1.0  # over 8 mm: skin that rises or falls less is level; chosen by eye
_SHIFT_MM = 15.0  # farthest that the outer flank is looked for outside the crease; chosen by eye
_FORBIDDEN = -50.0  # worth of a place where a breast cannot end


@value(eq=False)
class Crease:
    """A closed curve around a breast, laid flat."""

    flat: Float64[Array, "n 2"]
    """(half width × θ, y), mm, anticlockwise from the patient's left."""
    concavity_per_mm: Float64[Array, " n"]
    """Concavity of the crease in each direction, 1/mm."""
    seen: Bool[Array, " n"]
    """Whether the skin is visible there."""
    sigma_mm: Float64[Array, " n"]
    """Standard uncertainty of each distance from the middle, mm: small along a fold, large where nothing shows the
    border."""


def follow_crease(
    relief: Relief,
    middle: Float64[Array, 2],
    *,
    side: Literal["left", "right"] = "left",
    base_mm: float = 130.0,
    between_mm: tuple[float, float] = (-np.inf, np.inf),
) -> Crease:
    """Follow the border of a breast: its crease, and where there is none, what breasts are like.

    Each distance from the middle is worth log(1 + κ/κ₀) for the concavity κ of the relief, smoothed over σ, where that
    is positive, and less where skin rises outside it more than it falls to it from the breast: that is the foot of
    something else. Skin that stands higher than the level at which a breast ends costs. So does a curve that is unlike
    real women's boundaries, or larger or smaller than the breast's dome tells. The curve is then drawn on the crease's
    outer flank, where κ has fallen to half, less what smoothing has put outside: nothing where curved skin joins
    straight skin, up to 2 σ at a fold.

    Args:
        relief: the skin laid flat.
        middle: the breast's middle on it, mm.
        side: of the patient.
        base_mm: root of the area of its base, roughly, mm.
        between_mm: the border lies between these places around the trunk, half width × θ.
    """
    angles = np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    steps = np.arange(_STEP_MM, FARTHEST_BORDER_MM, _STEP_MM)
    unlike = _unlike(steps, angles if side == "left" else np.pi - angles)
    size_cost = _SIZE_COST * (np.log(_SIZES_MM / base_mm) / _SIZE_SCATTER) ** 2
    bulge_mm, concavity_per_mm = relief.smooth_mm(_SIGMA_MM), relief.concavity_per_mm(_SIGMA_MM)
    for last in range(_CENTRINGS):
        places = middle + rays[:, None] * steps[:, None]
        bulge, concavity = relief.at(places, bulge_mm), relief.at(places, concavity_per_mm)
        known, arm = (relief.at(places, mask.astype(np.float64)) > 0.5 for mask in (relief.known, relief.arm))
        # An arm and all behind it, unless skin of the trunk is seen there again.
        arm = np.maximum.accumulate(arm, axis=1) & ~np.maximum.accumulate(known[:, ::-1], axis=1)[:, ::-1]
        allowed = _beyond_the_top(bulge, arm) & relief.within(places)
        allowed &= (places[..., 0] > between_mm[0]) & (places[..., 0] < between_mm[1])
        worth = _CREASE * np.log1p(np.clip(concavity, 0.0, None) / CREASE_PER_MM) * _own(bulge)
        worth = worth - np.minimum(np.clip(bulge / _VANISH_MM - 1, 0.0, None) * _HEIGHT_COST, _MOST_HEIGHT_COST)
        worth = worth - np.minimum(
            np.clip(bulge - _TRUNK_OFF_MM, 0.0, None) / _VANISH_MM * _HEIGHT_COST, _MOST_FLANK_COST
        )
        tables = _NATS * np.maximum(np.where(allowed, worth, _FORBIDDEN) - unlike, 4 * _FORBIDDEN)
        paths = weigh_paths(tables, _NATS * _STIFFNESS)
        share = softmax(_SIZE_NATS * (paths.evidence / _NATS - size_cost))
        way = share @ paths.mean_steps
        if last < _CENTRINGS - 1:
            middle = _centroid(middle + rays * (_STEP_MM * (1 + way))[:, None])
    spread = np.sqrt(share @ (paths.spread_steps**2 + (paths.mean_steps - way) ** 2))
    reach = _STEP_MM * (1 + way)
    flank_mm = _outer_flank_mm(concavity, allowed, way)
    fine = relief.at(places, relief.concavity_per_mm(_FINE_MM))
    # Each pixel has its innermost skin, which is that of its outer edge: half a pixel too far in.
    reach = reach + flank_mm - _smeared_mm(concavity, fine, way) + PIXEL_MM / 2
    # Smooth as the directions' own distances are, in mm along the curve.
    apart = float(np.mean(reach)) * 2 * np.pi / DIRECTIONS
    reach = np.asarray(gaussian_filter1d(reach, _SIGMA_MM / apart, mode="wrap"))
    flat = middle + rays * reach[:, None]
    trunk = known & relief.within(places) & (bulge > -_SUNK_MM)
    hidden_mm = _hidden_mm(trunk | arm, _uncreased(concavity, way), reach)
    return Crease(
        flat=flat,
        concavity_per_mm=_at_steps(concavity, way[:, None])[:, 0],
        seen=relief.at(flat, relief.known.astype(np.float64)) > 0.5,
        sigma_mm=np.linalg.norm([_ERR_ALIKE * _STEP_MM * spread, _goes_on_mm(bulge, way), hidden_mm], axis=0),
    )


def _goes_on_mm(bulge: Float64[Array, "d s"], way: Float64[Array, " d"]) -> Float64[Array, " d"]:
    """Distance from a path to where skin no longer stands out as the breast does, or rises again, mm.

    0 where that lies within two σ, by which a fold is smoothed. Elsewhere the path runs over the breast.
    """
    ahead_mm = _STEP_MM * (np.arange(bulge.shape[1]) - way[:, None])
    high_mm = max(_GOES_ON * float(bulge[ahead_mm < 0].max(initial=0.0)), _TRUNK_OFF_MM)
    lowest = np.minimum.accumulate(np.where(ahead_mm >= 0, bulge, np.inf), axis=1)
    ended = (bulge <= high_mm) & (ahead_mm >= 2 * _SIGMA_MM)
    ended |= (ahead_mm >= 0) & (bulge > lowest + _LEVEL_MM)
    ended[:, -1] = True
    first = np.argmax(ended, axis=1)[:, None]
    return np.maximum(np.take_along_axis(ahead_mm, first, axis=1)[:, 0] - 2 * _SIGMA_MM - _STEP_MM, 0.0)


def _uncreased(concavity: Float64[Array, "d s"], way: Float64[Array, " d"]) -> Float64[Array, " d"]:
    """Degree to which a path has no crease within two σ, 0 to 1."""
    away_mm = _STEP_MM * np.abs(np.arange(concavity.shape[1]) - way[:, None])
    most = np.max(concavity, axis=1, initial=0.0, where=away_mm <= 2 * _SIGMA_MM)
    return np.clip(1 - most / CREASE_PER_MM, 0.0, 1.0)


def _hidden_mm(
    trunk: Bool[Array, "d s"], uncreased: Float64[Array, " d"], reach: Float64[Array, " d"]
) -> Float64[Array, " d"]:
    """Scatter of a border beyond which the trunk is not seen, mm.

    A border with a crease is in doubt where the trunk ends beside it: half of the crease may be hidden. One without may
    lie anywhere within its scatter, and beyond the end. Where the trunk is seen again, it lies before that.
    """
    ahead_mm = _STEP_MM * (1 + np.arange(trunk.shape[1])) - reach[:, None]
    hidden = (ahead_mm >= 0) & ~trunk
    hidden[:, -1] = True
    first = np.argmax(hidden, axis=1)[:, None]
    again = np.where((ahead_mm >= np.take_along_axis(ahead_mm, first, axis=1)) & trunk, ahead_mm, np.inf).min(axis=1)
    ends_mm = np.take_along_axis(ahead_mm, first, axis=1)[:, 0]
    scatter_mm = _UNSEEN_SCATTER * reach
    near_mm = _ENDED_MM + uncreased * np.maximum(2 * scatter_mm - _ENDED_MM, 0.0)
    share = np.clip((near_mm - ends_mm) / (near_mm - KNOWN_MM), 0.0, 1.0)
    return np.asarray(share * np.minimum(scatter_mm + uncreased * ends_mm, again / 2))


def _unlike(steps: Float64[Array, " s"], angles: Float64[Array, " d"]) -> Float64[Array, "k d s"]:
    """Cost of a distance that real women's boundaries do not have in that direction, for each size.

    Args:
        steps: distances from the middle, mm.
        angles: directions from lateral, upwards.
    """
    waves = np.fft.rfft(_USUAL_SHAPE) / len(_USUAL_SHAPE)
    weights = np.array([1.0, *[2.0] * (len(waves) - 2), 1.0])
    around = np.exp(1j * np.outer(angles, np.arange(len(waves))))
    shape = (around * waves * weights).real.sum(axis=1)
    shape /= np.sqrt(np.pi * np.mean(shape**2))
    usual = _SIZES_MM[:, None, None] * shape[:, None]
    return np.asarray(_UNLIKE_COST * ((steps / usual - 1) / _SHAPE_SCATTER) ** 2)


def _centroid(flat: Float64[Array, "n 2"]) -> Float64[Array, 2]:
    """Centroid of the area within a closed curve."""
    following = np.roll(flat, -1, axis=0)
    twice = flat[:, 0] * following[:, 1] - following[:, 0] * flat[:, 1]
    return np.asarray(((flat + following) * twice[:, None]).sum(axis=0) / (3 * twice.sum()))


def _beyond_the_top(bulge: Float64[Array, "d s"], arm: Bool[Array, "d s"]) -> Bool[Array, "d s"]:
    """Mask of the places at which a breast may end.

    From where it has fallen to nine tenths of its height until the skin rises again for good, the trunk ends, or an
    arm begins.
    """
    top = np.maximum.accumulate(bulge, axis=1)
    low = bulge < np.maximum(_FALLEN * top, _VANISH_MM)
    begun = np.maximum.accumulate(low, axis=1)
    lowest = np.minimum.accumulate(np.where(begun, bulge, np.inf), axis=1)
    risen = begun & (bulge > np.maximum(lowest, 0.0) + _RISE_MM)
    ended = risen | (begun & (bulge < -_SUNK_MM))
    allowed = begun & ~np.maximum.accumulate(ended, axis=1) & ~arm
    unknown = ~allowed.any(axis=1)  # nothing is known here; the neighbours decide
    allowed[unknown] = ~arm[unknown]
    return allowed


def _own(bulge: Float64[Array, "d s"]) -> Float64[Array, "d s"]:
    """Degree to which a crease is the breast's own, 0 to 1.

    Skin falls to its own crease from inside at least as much as it rises outside.
    At the foot of something else (arm, belly, the other breast hanging lower than the trunk goes) it only rises.
    """
    reach = round(2 * _SIGMA_MM / _STEP_MM)
    padded = np.pad(bulge, ((0, 0), (reach, reach)), mode="edge")
    fall, rise = padded[:, : -2 * reach] - bulge, padded[:, 2 * reach :] - bulge
    return np.clip((np.maximum(fall, 0) + _LEVEL_MM) / (np.maximum(rise, 0) + _LEVEL_MM), 0.0, 1.0)


def _at_steps(table: Float64[Array, "d s"], steps: Float64[Array, "d k"]) -> Float64[Array, "d k"]:
    """Values of each direction between its steps, so that they move as little as the path does."""
    steps = np.clip(steps, 0, table.shape[1] - 1)
    before = np.minimum(steps.astype(np.int64), table.shape[1] - 2)
    lower, upper = (np.take_along_axis(table, before + step, axis=1) for step in (0, 1))
    return np.asarray(lower + (steps - before) * (upper - lower))


def _outer_flank_mm(concavity: Float64[Array, "d s"], allowed: Bool[Array, "d s"], way: Array) -> Float64[Array, " d"]:
    """Distance outside the path at which the concavity has halved, or a breast can no longer end, mm.

    0 where there is no crease.
    """
    count = len(concavity)
    ahead = way[:, None] + np.arange(int(_SHIFT_MM / _STEP_MM) + 1)
    along = _at_steps(np.where(allowed, concavity, 0.0), ahead)
    along = gaussian_filter1d(along, _EVEN_DIRECTIONS, axis=0, mode="wrap")
    half = along[:, :1] / 2
    fallen = along < half
    first = np.where(fallen.any(axis=1), np.argmax(fallen, axis=1), 0)
    row = np.arange(count)
    above, below = along[row, np.maximum(first - 1, 0)], along[row, first]
    share = np.divide(above - half[:, 0], above - below, out=np.zeros(count), where=above > below)
    flank_mm = np.where(first > 0, (first - 1 + share) * _STEP_MM, 0.0)
    return flank_mm * np.clip(along[:, 0] / CREASE_PER_MM, 0.0, 1.0)


def _smeared_mm(concavity: Float64[Array, "d s"], fine: Float64[Array, "d s"], way: Array) -> Float64[Array, " d"]:
    """Distance outside the crease to which smoothing moved the place of half concavity, mm.

    With the scale σ the concavity of a step in curvature stays, that of a step in slope falls as 1/σ, that of a step in
    height as 1/σ². So two scales tell which it is.
    """
    near = way[:, None] + np.arange(-_NEAR_STEPS, _NEAR_STEPS + 1)
    coarse_peak, fine_peak = (np.clip(_at_steps(table, near).max(axis=1), 1e-9, None) for table in (concavity, fine))
    order = np.clip(np.log(fine_peak / coarse_peak) / np.log(_SIGMA_MM / _FINE_MM), 0.0, 2.0)
    order *= np.clip(coarse_peak / CREASE_PER_MM - 0.5, 0.0, 1.0)  # no leap where there is just no crease
    smeared_mm = _SIGMA_MM * np.interp(order, np.arange(3), _HALVED_SIGMAS)
    return np.asarray(gaussian_filter1d(smeared_mm, _EVEN_DIRECTIONS, mode="wrap"))
