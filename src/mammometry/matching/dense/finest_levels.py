"""The last levels of a large subject, from the left picture alone.

The right picture's matches check them. For that the coarser level's are exact enough: this saves half of the time and
of the memory where most is needed. The work goes in bands of rows, each from its first step to its final smoothing.
"""

from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from mammometry.geometry.arrays import Array, Float32
from mammometry.matching.dense.least_squares import (
    AGREEMENT_PX,
    LAST_SMOOTHING_PX,
    LevelStart,
    both,
    finally_smoothed,
    judged,
    upsampled_start,
)
from mammometry.matching.dense.least_squares_step import (
    Both,
    Estimate,
    Side,
    agreeing,
    prepare,
    smoothing_weights,
    step,
)
from mammometry.matching.dense.plane_smoothing import smooth
from mammometry.matching.dense.vertical_disparity import Vertical, aligned
from mammometry.matching.pyramid import Level, finer_shift
from mammometry.matching.settings import MatchSettings

DIRECTIONS_APART_PX = 0.5
"""Largest disagreement between both matching directions, pixels of the finest level matched from both."""
_BAND_ROWS = 384  # bounds memory: a full-size torso under a gigabyte (docs/decisions/0020)
_HALO_ROWS = 64  # even; 4.4 σ of two passes of the widest smoothing


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Refined:
    """What is known of the left picture on one level. And of the right one, to check it."""

    matches: Estimate
    """The last step's."""
    shift: Float32[Array, "h w"]
    """Finally smoothed, pixels of the level."""
    variance: Float32[Array, "h w"]
    """Expected of it, px² of the level."""
    other: Float32[Array, "h w"]
    """The right picture's shift after the last level matched from both and final smoothing, pixels of this level."""
    halvings: int
    """How many levels coarser that one was."""


def refined(
    images: Both[Level], coarse: Refined, vertical: Vertical, level: int, settings: MatchSettings, pool: Executor
) -> Refined:
    """The left picture's matches on the next finer level, by two steps."""
    shape = images[0].mask.shape
    sigma = settings.window_sigma_px
    limit = DIRECTIONS_APART_PX * 2**coarse.halvings
    known = upsampled_start(coarse.matches, coarse.shift, agreeing(coarse.shift, coarse.other, limit), shape)
    here, there = both(pool, prepare, (images[0], aligned(vertical, images[1], level)), (sigma, sigma))
    fine = Refined(
        matches=Estimate(
            **{name: np.empty(shape, dtype=np.float32) for name in ("shift", "step", "correlation", "variance")},
            plausible=np.empty(shape, dtype=bool),
        ),
        shift=np.empty(shape, dtype=np.float32),
        variance=np.empty(shape, dtype=np.float32),
        other=finer_shift(coarse.other, shape),
        halvings=coarse.halvings + 1,
    )
    apart = AGREEMENT_PX * 2**fine.halvings

    def band(top: int) -> None:
        bottom = min(top + _BAND_ROWS, shape[0])
        read = slice(max(0, top - _HALO_ROWS), min(shape[0], bottom + _HALO_ROWS))
        part = _rows(known, read)
        ours, theirs, other = _side(here, read), _side(there, read), fine.other[read]

        def stepped(shift: Float32[Array, "h w"], *, widely: bool) -> Estimate:
            found = step(ours, theirs, shift, sigma, widely=widely)
            return judged(found, agreeing(found.shift, other, apart), part)

        found = stepped(part.shift, widely=False)
        weights = smoothing_weights(found.variance, found.plausible, ours.mask)
        before = smooth(found.shift, weights, LAST_SMOOTHING_PX, part.shift)
        found = stepped(before, widely=True)
        shift, variance = finally_smoothed(found, ours.mask, before, settings)
        inner = slice(top - read.start, bottom - read.start)
        for name in Estimate.__dataclass_fields__:
            getattr(fine.matches, name)[top:bottom] = getattr(found, name)[inner]
        fine.shift[top:bottom], fine.variance[top:bottom] = shift[inner], variance[inner]

    list(pool.map(band, range(0, shape[0], _BAND_ROWS)))
    return fine


def _side(side: Side, rows: slice) -> Side:
    return Side(image=side.image[rows], coefficients=side.coefficients[rows], mask=side.mask[rows])


def _rows(known: LevelStart, rows: slice) -> LevelStart:
    """Some rows of what a level of half as many knows. The first row is even."""
    half = slice(rows.start // 2, (rows.stop + 1) // 2)
    return LevelStart(
        shift=known.shift[rows],
        correlation=known.correlation[half],
        variance=known.variance[half],
        plausible=known.plausible[half],
        halved=known.halved,
    )
