"""A strip of counting lamps on the calibration board, whose light shows when an image was exposed.

Twelve lamps show a counter in Gray code (F. Gray 1953, US 2632058), so that only one lamp changes at a time. Two more,
at the ends, are always on and show the brightness of a full exposure. The share of an exposure for which a lamp was lit
is a number between 0 and 1, so the time is known much more precisely than the counter's step.
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
    """Number of lamps that count."""
    tick_ms: float = 0.5
    """Time between two counts, ms. An exposure should last one to four of them."""
    pitch_mm: float = 12.0
    """Distance between neighbouring lamps."""
    below_mm: float = 25.0
    """Distance from the pattern's lower edge to the lamps' centres."""
    lamp_mm: float = 5.0
    """Diameter of a lamp."""

    @property
    def period_ms(self) -> float:
        """Time after which the counter repeats, ms. Times are known up to whole periods."""
        return self.tick_ms * 2**self.bits

    def places_mm(self, board: Board) -> Float64[Array, "l 3"]:
        """Centres of the lamps, board frame, mm: reference, counter (highest bit first), reference."""
        (left, _), (right, bottom) = board.extent_mm
        count = self.bits + 2
        x = 0.5 * (left + right) + self.pitch_mm * (np.arange(count) - 0.5 * (count - 1))
        return np.stack([x, np.full(count, bottom + self.below_mm), np.zeros(count)], axis=1)

    def lit_share(self, begin_ms: Float64[Array, " n"], exposure_ms: float) -> Float64[Array, "n bits"]:
        """Share of an exposure for which each lamp is lit, highest bit first.

        Args:
            begin_ms: start of the exposure after the counter's 0.
            exposure_ms: its duration.
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
