"""The closed path around a middle that gathers most evidence, and how far each of its places is known.

A path has one distance from the middle for each direction, so it cannot cross itself. What a distance is worth in a
direction and what moving in or out costs add up, so dynamic programming finds the best of all paths.
"""

from __future__ import annotations

import numpy as np
from scipy.special import logsumexp

from mammometry.geometry.arrays import Array, Float64, Int64

_TURNS = 3  # of the dynamic programming: the ends on either side of the one that is kept are forgotten
_FURTHEST_STEPS = 3  # that a path may move in or out from one direction to the next; 50° from the tangent at 60 mm
_SHIFTS = np.arange(-_FURTHEST_STEPS, _FURTHEST_STEPS + 1)
_NEVER = -1e9  # worth of what lies beside the table


def best_paths(worth: Float64[Array, "k d s"], stiffness: float) -> Int64[Array, "k d"]:
    """The closed path of greatest worth − stiffness × (change of step)² in each table.

    Over several turns, of which the middle one is kept: there the ends no longer matter, and the path closes by itself.
    """
    tables, count, length = worth.shape
    best = worth[:, 0].copy()
    moved = np.zeros((_TURNS * count, tables, length), dtype=np.int8)
    for turn in range(1, _TURNS * count):
        options = _neighbours(best) - stiffness * _SHIFTS[:, None, None] ** 2
        chosen = np.argmax(options, axis=0)
        moved[turn] = _SHIFTS[chosen]
        best = np.take_along_axis(options, chosen[None], axis=0)[0] + worth[:, turn % count]
    ways = np.empty((_TURNS * count, tables), dtype=np.int64)
    ways[-1] = np.argmax(best, axis=1)
    for turn in range(_TURNS * count - 1, 0, -1):
        ways[turn - 1] = ways[turn] + moved[turn, np.arange(tables), ways[turn]]
    return ways[count : 2 * count].T


def gathered(worth: Float64[Array, "k d s"], ways: Int64[Array, "k d"], stiffness: float) -> Float64[Array, " k"]:
    """What paths are worth, less what their movements cost."""
    along = np.take_along_axis(worth, ways[:, :, None], axis=2)[..., 0].sum(axis=1)
    return np.asarray(along - stiffness * ((np.roll(ways, -1, axis=1) - ways) ** 2).sum(axis=1))


def spread_steps(worth: Float64[Array, "d s"], stiffness: float, nats: float) -> Float64[Array, " d"]:
    """Standard deviation of each direction's step over all closed paths, in steps.

    Paths are as probable as the exponential of `nats` times what they gather (forward and backward sums).
    """
    count, length = worth.shape
    table, move = nats * worth, nats * stiffness * _SHIFTS[:, None, None] ** 2
    turned = [np.zeros((_TURNS * count, length)) for _ in range(2)]
    for sums, order in zip(turned, (table, table[::-1]), strict=True):
        before = order[0]
        for turn in range(_TURNS * count):
            sums[turn] = logsumexp(_neighbours(before[None])[:, 0] - move[:, 0], axis=0) if turn else 0.0
            before = sums[turn] + order[turn % count]
            before = before - before.max()
    middle = np.arange(count, 2 * count)
    log = turned[0][middle] + table + turned[1][_TURNS * count - 1 - middle]
    share = np.exp(log - log.max(axis=1, keepdims=True))
    share /= share.sum(axis=1, keepdims=True)
    steps = np.arange(length)
    mean = share @ steps
    return np.asarray(np.sqrt(np.maximum(share @ steps**2 - mean**2, 0.0)))


def _neighbours(best: Float64[Array, "k s"]) -> Float64[Array, "m k s"]:
    tables, length = best.shape
    padded = np.full((tables, length + 2 * _FURTHEST_STEPS), _NEVER)
    padded[:, _FURTHEST_STEPS:-_FURTHEST_STEPS] = best
    return np.stack([padded[:, start : start + length] for start in range(len(_SHIFTS))])
