"""Closed paths around a middle, weighed by what speaks for each.

A path has one distance from the middle for each direction, so it cannot cross itself. What a distance is worth in a
direction and what moving in or out costs add up, so sums over all paths need only neighbouring directions. The mean of
all paths, unlike the best of them, changes little where the evidence changes little.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import correlate1d

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Float64

_TURNS = 2  # around the middle: in the first the start is forgotten
_FURTHEST_STEPS = 3  # that a path may move in or out from one direction to the next; 50° from the tangent at 60 mm
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
            before /= total[:, None]
            growth += np.log(total)
    return arriving, growth
