"""Size of the printed board, from a ruler and from a bank card on the print."""

from __future__ import annotations

import math
from dataclasses import replace

from mammometry.base.errors import BoardSizeError
from mammometry.calibration.targets.board import Board
from mammometry.walk.bank_card import CardScale

PRINT_STD = 0.01
"""Relative standard uncertainty of a board that was not measured: printers may scale a page by a few per cent."""
_MOST_SIGMAS = 3.0  # largest difference of both measurements, standard deviations


def sized(board: Board, card: CardScale) -> Board:
    """The board with the weighted mean of its stated size and that by the card, and its uncertainty.

    Raises:
        BoardSizeError: the card contradicts a size that the user measured.
    """
    typed = board.scale_std
    stated = PRINT_STD if typed is None else typed
    if typed is not None and abs(card.scale - 1.0) > _MOST_SIGMAS * math.hypot(card.std, typed):
        raise BoardSizeError(
            "the printed board",
            found=f"columns of {card.scale * board.edge_mm:.1f} mm by the bank card",
            expected=f"{board.edge_mm:.1f} ± {2 * typed * board.edge_mm:.1f} mm, as measured by hand",
            remedy="Measure the columns on the print again, and use a bank card of 85.6 × 54 mm that lies flat",
        )
    weights = (1.0 / stated**2, 1.0 / card.std**2)
    scale = (weights[0] + card.scale * weights[1]) / sum(weights)
    larger = board.scaled(scale)
    return replace(larger, edge_std_mm=larger.edge_mm / math.sqrt(sum(weights)))
