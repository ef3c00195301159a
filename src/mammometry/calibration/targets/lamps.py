"""A strip of counting lamps on the calibration board.

By their light a picture tells when it was exposed.

Twelve lamps show a counter in Gray code (F. Gray 1953, US 2632058), so that only one changes at a tick. Two more, at
the ends, are always on: they tell how bright a whole exposure is. The share of an exposure for which a lamp was lit is
then a number between 0 and 1, and tells the moment far more finely than a tick.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mammometry.calibration.targets.board import Board
from mammometry.geometry.arrays import Array, Float64


@dataclass(frozen=True, slots=True, kw_only=True)
class LampStrip:
    """The strip, clamped below the lower edge of a board (docs/how-to/counting-lamps.ino)."""

    bits: int = 12
    """Lamps that count."""
    tick_ms: float = 0.5
    """Time between two counts. An exposure should last one to four of them."""
    pitch_mm: float = 12.0
    """Between neighbouring lamps."""
    below_mm: float = 25.0
    """From the pattern's lower edge to the lamps' middles."""
    lamp_mm: float = 5.0
    """Diameter of a lamp."""

    @property
    def period_ms(self) -> float:
        """After which the counter begins again. Moments are known but for whole periods."""
        return self.tick_ms * 2**self.bits

    def places_mm(self, board: Board) -> Float64[Array, "l 3"]:
        """Middles of the lamps, board frame, mm.

        A reference, the counter with its highest bit first, a reference.
        """
        (left, _), (right, bottom) = board.extent_mm
        count = self.bits + 2
        x = 0.5 * (left + right) + self.pitch_mm * (np.arange(count) - 0.5 * (count - 1))
        return np.stack([x, np.full(count, bottom + self.below_mm), np.zeros(count)], axis=1)

    def lit_share(self, begin_ms: Float64[Array, " n"], exposure_ms: float) -> Float64[Array, "n bits"]:
        """Share of an exposure for which each lamp is lit. The highest bit comes first.

        Args:
            begin_ms: when the exposure begins, after the counter's 0.
            exposure_ms: how long it lasts.
        """
        ticks = np.arange(2**self.bits)
        gray = ticks ^ (ticks >> 1)
        on = (gray[:, None] >> np.arange(self.bits - 1, -1, -1)) & 1
        lit_ms = self.tick_ms * np.concatenate([np.zeros((1, self.bits)), np.cumsum(on, axis=0)])

        def until(moment_ms: Float64[Array, " n"]) -> Float64[Array, "n bits"]:
            periods, rest = np.divmod(moment_ms / self.tick_ms, len(ticks))
            whole = rest.astype(int)
            part = (rest - whole)[:, None]
            within: Float64[Array, "n bits"] = (1 - part) * lit_ms[whole] + part * lit_ms[whole + 1]
            return within + periods[:, None] * lit_ms[-1]

        return (until(begin_ms + exposure_ms) - until(begin_ms)) / exposure_ms


LAMPS = LampStrip()
"""The strip of the documentation."""
