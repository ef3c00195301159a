"""Which levels of the pyramid are matched, in how many steps."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mammometry.base.errors import MatchingError
from mammometry.geometry.arrays import Array, Bool
from mammometry.matching.semiglobal import span_px

START_SPAN_PX = 400.0
"""Subject size (root of its area, pixels) below which semi-global matching starts: the finest such level. At half of
it, folds and arms are taken for one surface. Memory grows with its third power."""
FINEST_SPAN_PX = 800.0
"""Subject size (root of its area, pixels) above which a level is not matched from both pictures: on the photograph's
own pixels optics leave little. One level coarser only left matches are made, which coarser right ones check."""

_FIRST_STEPS, _FURTHER_STEPS, _LAST_STEPS = 5, 4, 2
"""Least-squares steps on the coarsest, the middle and the last level solved from both pictures.

An error left on a coarse level is twice as many pixels on the next. Once it exceeds the texture's grain it stays
(docs/decisions/0015).
"""
_SMALLEST_SPAN_PX = 24  # about three windows; chosen by eye
_CALM_SPAN_PX = 230  # a larger subject starts a level coarser: the finest one's noise made plaster_b's start err (0015)
_SOFT_SPAN_PX = 150  # of a soft subject on its finest level: a smaller one's windows span too much of it; by eye
_FINEST_LEVEL = 1  # of a large subject: optics leave little on the photograph's own pixels


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelWork:
    """What is done on one level that both pictures solve."""

    level: int
    """Halvings of the rectified pictures."""
    steps: int
    """Least-squares steps."""
    last: bool
    """Whether it is the last level solved from both pictures: it takes one step more, with wide windows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Levels:
    """Levels of one match, coarse to fine. Level 0 is the rectified picture, each next one half of it."""

    coarsest: int
    """The semi-global start is made here."""
    last_both: int
    """Finest level solved from both pictures. Below it, only the left one is refined."""
    finest: int

    def both(self) -> list[LevelWork]:
        """Work of the levels that both pictures solve."""
        return [
            LevelWork(level=level, steps=self._steps(level), last=level == self.last_both)
            for level in range(self.coarsest, self.last_both - 1, -1)
        ]

    def left_only(self) -> range:
        """Levels on which only the left picture is refined."""
        return range(self.last_both - 1, self.finest - 1, -1)

    def share_done(self, level: int) -> float:
        """Progress, 0…1, once a level finer than the coarsest is done."""
        return 0.9 - 0.6 * (level - self.finest) / (self.coarsest - self.finest)

    def _steps(self, level: int) -> int:
        if level == self.coarsest:
            return _FIRST_STEPS
        return _LAST_STEPS if level == self.last_both else _FURTHER_STEPS


def choose_levels(pair_name: str, masks: Sequence[Bool[Array, "h w"]], *, empty: int = 0) -> Levels:
    """Choose the levels by the size of the smaller subject and the sharpness of the softer picture.

    Args:
        pair_name: for the message.
        masks: the subject's pixels in both pictures.
        empty: finest levels in which one of the pictures holds no details (`sharpness`): only noise is there.

    Raises:
        MatchingError: a subject is too small to be matched.
    """
    span = min(span_px(mask) for mask in masks)
    if span < _SMALLEST_SPAN_PX:
        raise MatchingError(
            f"pair {pair_name}",
            found=f"a subject of {span:.0f} pixels across",
            expected=f"at least {_SMALLEST_SPAN_PX}",
            remedy="Check the foreground masks",
        )
    empty = max(0, min(empty, int(np.log2(span / _SOFT_SPAN_PX))))
    last_both = max(empty, int(np.ceil(np.log2(span / FINEST_SPAN_PX))))
    calm = last_both + int(span / 2**last_both > _CALM_SPAN_PX)
    coarsest = max(calm, int(np.ceil(np.log2(span / START_SPAN_PX))))
    return Levels(coarsest=coarsest, last_both=last_both, finest=max(empty, min(last_both, _FINEST_LEVEL)))
