"""Where markers lie on a ChArUco board: numbered row by row, on every second square.

Boards may differ in columns and in which squares are bright. A picture's markers tell both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from mammometry.geometry.arrays import Array, Float64, Int64

FITTING_SHARE = 0.9
"""Share of the markers that lie as their board has them. On a board of the other pattern it is a half."""
TOLERANCE_SQUARES = 0.35
"""Distance of a marker's corner from its place, squares. Lenses bend boards by less, other boards by one square."""
_COLUMNS = range(3, 41)
"""Numbers of columns that are tried."""
_LEAST_ROWS = 3
"""Rows of markers that tell boards apart: two may slide along one another as a board that is seen aslant."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeenMarkers:
    """Markers of one picture."""

    ids: Int64[Array, " m"]
    """Their numbers. Repetitions are included."""
    corners: Float64[Array, "m 4 2"]
    """Their corners clockwise from the top left one, px."""

    @classmethod
    def of(cls, corners: Sequence[Array], ids: Array | None) -> SeenMarkers:
        """Return what OpenCV's detector found."""
        numbers = np.zeros(0, np.int64) if ids is None else np.ravel(ids).astype(np.int64)
        return cls(ids=numbers, corners=np.array([np.ravel(four) for four in corners], np.float64).reshape(-1, 4, 2))


@dataclass(frozen=True, slots=True, kw_only=True)
class MarkerLayout:
    """Numbering of a board's markers."""

    columns: int
    """Squares in a row."""
    starts_bright: bool
    """Whether the first square is bright, so that a marker is on it."""

    def squares_of(self, ids: Int64[Array, " m"]) -> Int64[Array, "m 2"]:
        """Column and row of each marker."""
        rows, place = np.divmod(ids, self.columns)  # two rows have as many markers as the board has columns
        in_upper = (self.columns + self.starts_bright) // 2
        lower = place >= in_upper
        column = 2 * (place - in_upper * lower) + (lower == self.starts_bright)
        return np.stack([column, 2 * rows + lower], axis=1)

    def fitting_share(self, seen: SeenMarkers, marker_squares: float) -> float:
        """Share of the markers that lie as this board has them.

        Args:
            seen: markers of the picture, four at least.
            marker_squares: side of a marker, squares.
        """
        corners = 0.5 + marker_squares * np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
        board = (self.squares_of(seen.ids)[:, None] + corners).reshape(-1, 1, 2)
        _, inside = cv2.findHomography(
            seen.corners.reshape(-1, 1, 2), board, cv2.RANSAC, TOLERANCE_SQUARES, maxIters=200
        )
        return 0.0 if inside is None else float(inside.reshape(-1, 4).all(axis=1).mean())


def layout_of(
    seen: SeenMarkers, marker_squares: float, likely_columns: Sequence[int]
) -> tuple[MarkerLayout, int] | None:
    """Find the board that the markers lie as on, and its rows down to the last marker.

    None where they lie as on no board, or are too few to tell.

    Args:
        seen: markers of the picture.
        marker_squares: side of a marker, squares.
        likely_columns: numbers of columns to try first.
    """
    for columns in dict.fromkeys((*likely_columns, *_COLUMNS)):
        for starts_bright in (False, True):
            layout = MarkerLayout(columns=columns, starts_bright=starts_bright)
            rows = layout.squares_of(seen.ids)[:, 1]
            if len(np.unique(rows)) >= _LEAST_ROWS and layout.fitting_share(seen, marker_squares) >= FITTING_SHARE:
                return layout, 1 + int(rows.max())
    return None
