"""What to know of photographs by one telephone before their numbers are used."""

from __future__ import annotations

from collections.abc import Iterator

from mammometry.base.normal import COVERAGE_95
from mammometry.job.inputs import Walk
from mammometry.walk.motion import WalkMotion

_SIZE_KNOWN = 0.004  # relative uncertainty of the board's size, above which it is the larger part of most intervals
_MOVED_MM = 0.1  # size of the body's motions between photographs from which they are worth a sentence


def walk_concerns(walk: Walk, motion: WalkMotion) -> Iterator[str]:
    """Sentences on the board's size and on motion between the photographs.

    Args:
        walk: what is known of the photographs.
        motion: of the body between them.
    """
    if walk.scale_std > _SIZE_KNOWN:
        share = 100 * COVERAGE_95 * 3 * walk.scale_std
        yield (
            f"The printed board was not measured: its size alone makes each volume uncertain by {share:.0f} %. Measure "
            "the ruler on the print, and write it into board.toml (edge_mm)."
        )
    if motion.size_mm >= _MOVED_MM:
        yield (
            f"The body moved against the board between photographs, by about {motion.size_mm:.1f} mm. This was "
            f"corrected: pairs disagree by {motion.rest_mm:.2f} mm not {motion.before_mm:.2f} mm. Hold the breath."
        )
