"""The border of a breast: its crease, and without a crease the mean shape of breasts.

The crease is where the breast's skin turns most sharply into the trunk's. A curve s(φ) around the breast's middle is a
path through a table of directions and distances (`weigh_paths`). Without a crease (at the upper pole of many breasts),
the border follows from its neighbours, the skin's height and the shape of real women's boundaries.

A path has one distance per direction, so it cannot cross itself. The score is a sum over directions and over steps
between neighbouring directions, so sums over all paths can be computed by a recursion. The mean of all paths changes
little if the evidence changes little; the best path may jump.
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

_TURNS = 2  # turns of the recursion around the middle; after the first it no longer depends on the start
_FURTHEST_STEPS = 3  # largest step of a path between neighbouring directions: 50° from the tangent at 60 mm
_LEAST_SHARE = 1e-100  # least weight, so that the product of both directions of the recursion is never 0
_SHIFTS = np.arange(-_FURTHEST_STEPS, _FURTHEST_STEPS + 1)


@value(eq=False)
class WeighedPaths:
    """Statistics of all closed paths through each of several tables."""

    mean_steps: Float64[Array, "k d"]
    """Mean step in each direction."""
    spread_steps: Float64[Array, "k d"]
    """Standard deviation of the step in each direction."""
    evidence: Float64[Array, " k"]
    """Logarithm of the sum of all paths' weights."""


def weigh_paths(log_weights: Float64[Array, "k d s"], stiffness: float) -> WeighedPaths:
    """Mean, spread and total weight of the closed paths through each table.

    The weight of a path is exp(Σ log weight − stiffness × Σ (change of step)²).
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
    """Share of the weight of partial paths at each step of each direction, and its log growth in one turn."""
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
"""Largest distance of a boundary from the breast's middle, mm."""
CREASE_PER_MM = 0.01
"""Concavity from which the skin has a crease, 1/mm (twice a mean curvature). A chest has less than 0.005, a fold 0.1 to
1."""
DIRECTIONS = 144  # directions from the breast's middle, 2.5° apart
_SIGMA_MM = 2 * PIXEL_MM
"""Scale of the skin's curvature, mm: wider than noise and the skin's unevenness, narrower than a fold."""
_FINE_MM = PIXEL_MM  # finer scale, which shows how abrupt a crease is
_HALVED_SIGMAS = (0.0, 1.18, 1.92)
"""Distance outside a bend of skin at which its Gaussian-smoothed concavity is half the maximum, in σ: for a step of
curvature, of slope (a crease), and of height (a fold under an overhang). Closed forms."""
_NEAR_STEPS = 6  # steps on either side of the path in which the crease is searched at the finer scale
_EVEN_DIRECTIONS = 3.0  # directions over which abruptness is averaged; not critical
_VANISH_MM = 2.0  # height over the thorax fit at which a breast ends; the fit's own scatter is 1–2 mm
_CREASE = 0.6  # score of a crease of 0.017 per mm; that of a fold of 0.1 per mm is 1.4
_HEIGHT_COST, _MOST_HEIGHT_COST, _MOST_FLANK_COST = 0.05, 0.3, 0.5
"""Cost of a border per `_VANISH_MM` of its skin's height above that level, and two limits of the cost. The first limit
is low, only to keep the border off creases on the breast: the fitted trunk is less accurate above the breasts than
beside them. Skin higher than its errors (`_TRUNK_OFF_MM`) is a breast's flank, and costs the same again up to the
second."""
_TRUNK_OFF_MM = 20.0  # error of the fitted trunk above the breasts, 10 to 20 mm: the height of a muscle
_STIFFNESS = 0.1  # cost of a step of 1 mm between neighbouring directions, quadratic in the step; not critical
_USUAL_SHAPE = np.array([0.43, 0.54, 0.67, 0.55, 0.47, 0.58, 0.62, 0.59])
"""Distance of real women's boundaries from their middle over the square root of their area, every 45° from lateral
upwards: mean of 145 breasts (docs/decisions/0029). The standard deviation between women is 0.04 (7 %)."""
_SHAPE_SCATTER, _UNLIKE_COST = 0.12, 0.03
"""Expected relative standard deviation from that shape, for bodies in any pose, and the cost of a deviation by one. A
fold outweighs a deviation by four."""
_SIZES_MM = np.geomspace(80.0, 180.0, 11)
"""Square roots of the base areas that are tried, mm: 64 to 324 cm²."""
_SIZE_SCATTER, _SIZE_COST = 0.12, 5.0
"""Relative standard deviation of such a root from its estimate by the breast's dome, and the cost of one."""
_CENTRINGS = 3  # iterations of the border about its own centroid; not critical
_NATS, _SIZE_NATS = 2.0, 0.2
"""Log likelihood per unit of score, for a curve and for a size. Errors of neighbouring directions are correlated, so
the score of a size counts less. Calibrated on virtual women (decision 43)."""
_ERR_ALIKE = 2.4
"""Ratio of a border's error to the spread of its paths: 1 on virtual scans, 2.6 on hanging breasts, because errors of
neighbouring directions are correlated."""
_GOES_ON = 1 / 3  # skin outside the border above this height, relative to the top, is still breast; not critical
_ENDED_MM, _UNSEEN_SCATTER = 18.0, 0.3
"""Distance from the end of the visible skin within which a border may be anywhere beyond it, mm; and the border's
standard deviation there, relative to its distance from the middle. Large breasts of held-out captures extend 30 to 50
mm above the map. Not critical."""
_FALLEN = 0.9
"""Height, relative to the top, below which a breast may end. 0.68 changes volumes by 4 % of an interval; 1 would allow
an end at the top."""
_RISE_MM = 6.0  # skin that rises again by this much is something else (arm, belly, other breast)
_BEHIND_MM = CUT_OFF * CHEST_SCALE_MM
"""Distance behind the thorax fit, whose errors are 2 to 6 mm, beyond which skin is not trunk."""
_STEP_MM = 1.0  # step of the table of distances
_LEVEL_MM = 1.0  # skin that rises or falls by less over 8 mm is level; not critical
_SHIFT_MM = 15.0  # largest distance of the outer flank outside the crease; not critical
_FORBIDDEN = -50.0  # score where a breast cannot end


@value(eq=False)
class Crease:
    """A closed curve around a breast, on the flattened trunk."""

    flat: Float64[Array, "n 2"]
    """(half width × θ, y), mm, counter-clockwise from the patient's left."""
    concavity_per_mm: Float64[Array, " n"]
    """Concavity of the crease in each direction, 1/mm."""
    seen: Bool[Array, " n"]
    """Whether the skin is visible there."""
    sigma_mm: Float64[Array, " n"]
    """Standard uncertainty of each distance from the middle, mm: small along a fold, large without a crease."""


def follow_crease(
    relief: Relief,
    middle: Float64[Array, 2],
    *,
    side: Literal["left", "right"] = "left",
    base_mm: float = 130.0,
    between_mm: tuple[float, float] = (-np.inf, np.inf),
) -> Crease:
    """Border of a breast: along its crease, and without a crease along the mean shape of breasts.

    The score of a distance from the middle is log(1 + κ/κ₀) for the concavity κ of the smoothed relief, if positive,
    and less where the skin rises outside by more than it falls inside, because an arm, a belly or the like begins
    there. There are costs for skin above the height at which a breast ends, and for a curve that differs in shape from
    real women's boundaries, or in size from the estimate by the breast's dome. The curve is then moved to the crease's
    outer flank, where κ is half its maximum, minus the effect of smoothing: nothing at a step of curvature, up to 2 σ
    at a fold.

    Args:
        relief: the flattened skin.
        middle: the breast's middle on it, mm.
        side: side of the patient.
        base_mm: estimated square root of the area of its base, mm.
        between_mm: limits of the border around the trunk, half width × θ.
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
        # An arm and everything beyond it, unless skin of the trunk is visible there again.
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
    # A pixel's value is its innermost skin, which is at its outer edge: the curve is half a pixel too far in.
    reach = reach + flank_mm - _smeared_mm(concavity, fine, way) + PIXEL_MM / 2
    apart = float(np.mean(reach)) * 2 * np.pi / DIRECTIONS
    reach = np.asarray(gaussian_filter1d(reach, _SIGMA_MM / apart, mode="wrap"))
    flat = middle + rays * reach[:, None]
    trunk = known & relief.within(places) & (bulge > -_BEHIND_MM)
    hidden_mm = _hidden_mm(trunk | arm, _uncreased(concavity, way), reach)
    return Crease(
        flat=flat,
        concavity_per_mm=_at_steps(concavity, way[:, None])[:, 0],
        seen=relief.at(flat, relief.known.astype(np.float64)) > 0.5,
        sigma_mm=np.linalg.norm([_ERR_ALIKE * _STEP_MM * spread, _goes_on_mm(bulge, way), hidden_mm], axis=0),
    )


def _goes_on_mm(bulge: Float64[Array, "d s"], way: Float64[Array, " d"]) -> Float64[Array, " d"]:
    """Distance from a path to the end of the breast's height, or to skin that rises again, mm.

    0 if that is within two σ, the width of a smoothed fold. Else the path runs over the breast.
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
    """Additional scatter of a border beyond which the trunk is not visible, mm.

    If the trunk ends next to a crease, half of the crease may be hidden. A border without a crease may be anywhere
    beyond the end of the visible skin, but not beyond trunk that is visible again.
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
    """Cost of a distance that differs from real women's boundaries, for each size and direction.

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

    These places begin where the height has fallen to `_FALLEN` of the top, and end where the skin rises again, the
    trunk ends or an arm begins.
    """
    top = np.maximum.accumulate(bulge, axis=1)
    low = bulge < np.maximum(_FALLEN * top, _VANISH_MM)
    begun = np.maximum.accumulate(low, axis=1)
    lowest = np.minimum.accumulate(np.where(begun, bulge, np.inf), axis=1)
    risen = begun & (bulge > np.maximum(lowest, 0.0) + _RISE_MM)
    ended = risen | (begun & (bulge < -_BEHIND_MM))
    allowed = begun & ~np.maximum.accumulate(ended, axis=1) & ~arm
    unknown = ~allowed.any(axis=1)  # directions without such places: determined by the neighbours
    allowed[unknown] = ~arm[unknown]
    return allowed


def _own(bulge: Float64[Array, "d s"]) -> Float64[Array, "d s"]:
    """Degree to which a crease belongs to the breast, 0 to 1.

    At the breast's own crease the skin falls inside at least as much as it rises outside. At the foot of something else
    (arm, belly, a lower breast) it only rises.
    """
    reach = round(2 * _SIGMA_MM / _STEP_MM)
    padded = np.pad(bulge, ((0, 0), (reach, reach)), mode="edge")
    fall, rise = padded[:, : -2 * reach] - bulge, padded[:, 2 * reach :] - bulge
    return np.clip((np.maximum(fall, 0) + _LEVEL_MM) / (np.maximum(rise, 0) + _LEVEL_MM), 0.0, 1.0)


def _at_steps(table: Float64[Array, "d s"], steps: Float64[Array, "d k"]) -> Float64[Array, "d k"]:
    """Values of a table at fractional steps, linear between them."""
    steps = np.clip(steps, 0, table.shape[1] - 1)
    before = np.minimum(steps.astype(np.int64), table.shape[1] - 2)
    lower, upper = (np.take_along_axis(table, before + step, axis=1) for step in (0, 1))
    return np.asarray(lower + (steps - before) * (upper - lower))


def _outer_flank_mm(concavity: Float64[Array, "d s"], allowed: Bool[Array, "d s"], way: Array) -> Float64[Array, " d"]:
    """Distance outside the path to half the concavity, or to where no breast ends, mm. 0: no crease."""
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
    """Distance by which smoothing moved the point of half concavity outwards, mm.

    With the scale σ the concavity of a step of curvature is constant, that of a step of slope falls as 1/σ, that of a
    step of height as 1/σ². So two scales show which it is.
    """
    near = way[:, None] + np.arange(-_NEAR_STEPS, _NEAR_STEPS + 1)
    coarse_peak, fine_peak = (np.clip(_at_steps(table, near).max(axis=1), 1e-9, None) for table in (concavity, fine))
    order = np.clip(np.log(fine_peak / coarse_peak) / np.log(_SIGMA_MM / _FINE_MM), 0.0, 2.0)
    order *= np.clip(coarse_peak / CREASE_PER_MM - 0.5, 0.0, 1.0)  # continuous at the threshold of a crease
    smeared_mm = _SIGMA_MM * np.interp(order, np.arange(3), _HALVED_SIGMAS)
    return np.asarray(gaussian_filter1d(smeared_mm, _EVEN_DIRECTIONS, mode="wrap"))
