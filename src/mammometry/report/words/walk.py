"""Notices on photographs by one telephone."""

from __future__ import annotations

from collections.abc import Iterator

from mammometry.base.normal import COVERAGE_95
from mammometry.base.notices import Notice
from mammometry.job.inputs import Walk
from mammometry.walk.motion import WalkMotion

_SIZE_KNOWN = 0.004  # relative uncertainty of the board's size above which it dominates most intervals
_MOVED_MM = 0.1  # size of the body's motions between photographs from which they are reported


def walk_concerns(walk: Walk, motion: WalkMotion) -> Iterator[Notice]:
    """Notices on the board's size and on motion between the photographs.

    Args:
        walk: facts about the photographs.
        motion: of the body between them.
    """
    if walk.scale_std > _SIZE_KNOWN:
        share = 100 * COVERAGE_95 * 3 * walk.scale_std
        yield Notice(code="board-not-measured", values={"percent": float(share)})
    if motion.size_mm >= _MOVED_MM:
        yield Notice(
            code="body-moved-against-board",
            values={"moved_mm": motion.size_mm, "after_mm": motion.rest_mm, "before_mm": motion.before_mm},
        )
