"""Plain chessboards."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from mammometry.calibration.targets.board import LEAST_SQUARES, SquaresBoard
from mammometry.calibration.targets.sheet import DARK, WHITE, SheetPattern
from mammometry.calibration.targets.target import TARGETS


@TARGETS.add("chessboard")
@dataclass(frozen=True, slots=True, kw_only=True)
class ChessboardTarget(SquaresBoard):
    """A plain chessboard whose first square is dark.

    A board with an even sum of columns and rows looks the same after half a turn. Its first corner is then the one
    farther left in the image.

    Raises:
        ValueError: fewer than 3 × 3 squares, or a size that is not positive.
    """

    has_inverse: ClassVar[bool] = False

    def mistaken(self) -> Iterator[tuple[str, ChessboardTarget]]:
        """Yield boards whose squares were counted wrongly, first those counted by inner corners."""
        for more in ((1, 1), (1, 0), (0, 1), (-1, -1), (-1, 0), (0, -1)):
            columns, rows = self.squares[0] + more[0], self.squares[1] + more[1]
            if min(columns, rows) >= LEAST_SQUARES:
                yield f"squares = [{columns}, {rows}]", replace(self, squares=(columns, rows))

    @property
    def looks_alike_turned(self) -> bool:
        """Whether columns and rows have an even sum."""
        return sum(self.squares) % 2 == 0

    @property
    def pattern(self) -> SheetPattern:
        """Dark and white squares."""
        columns, rows = self.squares
        dark = (np.arange(rows)[:, None] + np.arange(columns)) % 2 == 0
        cells = np.where(dark, DARK, WHITE).astype(np.uint8)[:, :, None, None]
        return SheetPattern(
            grid="squares", count=self.squares, pitch_mm=self.square_mm, mark_mm=self.square_mm, cells=cells
        )

    def caption(self) -> str:
        """Describe the print in one line."""
        return f"chessboard, {self.squares[0]} × {self.squares[1]} squares of {self.square_mm:g} mm"
