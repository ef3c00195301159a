"""Copies in a walk: a photograph under a second name, compressed again, or with other colours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mammometry.calibration.detection.detect import Detection, median_distance_px
from mammometry.walk.inputs import LeftOut

_SAME_PX = 0.25
"""Largest median distance of the board's corners in two copies, px. Compression moves a corner by some hundredths of a
pixel; a hand moves a telephone by many pixels between two photographs."""
_WHOLE = 100.0  # quality of a picture that is not a JPEG


def judge_copies(
    boards: Sequence[Detection], qualities: Mapping[str, float | None], names: Mapping[str, str]
) -> dict[str, LeftOut]:
    """Copies of other photographs, with reasons. Of each photograph the least compressed file is kept.

    A photograph that counts twice would make its own errors look like agreement.

    Args:
        boards: the board in each photograph.
        qualities: number of a photograph → quality of its JPEG, 1…100. None: not a JPEG.
        names: number → file, for messages.
    """

    def rank(board: Detection) -> tuple[float, str]:
        quality = qualities.get(board.pose)
        return -(_WHOLE if quality is None else quality), board.pose

    out: dict[str, LeftOut] = {}
    kept: list[Detection] = []
    for board in sorted(boards, key=rank):
        first = next((other for other in kept if median_distance_px(board, other) < _SAME_PX), None)
        if first is None:
            kept.append(board)
            continue
        out[board.pose] = LeftOut(
            code="duplicate",
            found=f"the same photograph as {names[first.pose]}",
            remedy="Keep one file of each photograph",
        )
    return out
