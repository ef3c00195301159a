"""Field for a bank card on the telephone's board: a second measurement of the print's size.

Cards have the size ID-1 of ISO/IEC 7810. The card covers a part of the lower two rows of squares, where its edges cross
black squares and white paper, so that light and dark cards are visible. Lengths in the frame of the board as drawn, mm.
"""

from __future__ import annotations

import numpy as np

from mammometry.calibration.targets.sheet import PrintedSheet

CARD_MM = (85.60, 53.98)
"""Nominal width and height of a bank card (ISO/IEC 7810, ID-1)."""
CARD_TOLERANCE_MM = (0.125, 0.055)
"""Half of the range that the standard allows: 85.47 to 85.72, and 53.92 to 54.03."""
CARD_THICKNESS_MM = 0.76
"""Nominal thickness of a bank card (ISO/IEC 7810)."""
FIELD_MIDDLE = (58.8, 160.0)
"""Position of the card's middle."""
FIELD_EDGE_MM = 264.0
"""Length of the board along x, as drawn."""
_BARS = ((30.0, 181.0, 20.0, 10.0), (68.0, 181.0, 20.0, 10.0))
"""Black bars under the lower edge of the card: x, y, width and height."""


def field_sheet(scale: float = 1.0) -> PrintedSheet:
    """Outline of the card's field, and the bars below the squares for its lower edge.

    Args:
        scale: size of the print relative to the drawing.
    """
    half = 0.5 * np.array(CARD_MM)
    return PrintedSheet(
        extent_mm=scale * np.stack([np.array(FIELD_MIDDLE) - half, np.array(FIELD_MIDDLE) + half]),
        rectangles=scale * np.array(_BARS),
    )
