"""What is printed on a board, as dark shapes in millimetres: for the printer, and for tests of the detectors."""

from __future__ import annotations

import numpy as np

from mammometry.calibration.detect_charuco import charuco_board
from mammometry.calibration.target import CharucoTarget, ChessboardTarget
from mammometry.geometry.arrays import Array, Bool, Float64


def marker_bits(target: CharucoTarget) -> dict[tuple[int, int], Bool[Array, "k k"]]:
    """Cells of the marker in each square that has one, by the square's column and row; True is white.

    The black rim of one cell is included. ``[row, column]`` as the marker lies on the board.

    Raises:
        SessionError: no dictionary of the target's name.
    """
    board = charuco_board(target)
    dictionary = board.getDictionary()
    cells = int(dictionary.markerSize) + 2
    bits = {}
    for number, corners in zip(np.ravel(board.getIds()), board.getObjPoints(), strict=True):
        column, row = np.floor(np.asarray(corners)[:, :2].mean(axis=0) / target.square_mm).astype(int)
        image = dictionary.generateImageMarker(int(number), cells)
        bits[int(column), int(row)] = np.asarray(image) > 127
    return bits


def dark_rectangles(target: CharucoTarget | ChessboardTarget) -> Float64[Array, "n 4"]:
    """All that is printed: x, y, width and height of dark rectangles on the board, mm; none overlap.

    Raises:
        SessionError: no dictionary of the target's name.
    """
    columns, rows = target.squares
    side = target.square_mm
    markers = marker_bits(target) if isinstance(target, CharucoTarget) else {}
    dark: list[tuple[float, float, float, float]] = []
    for row in range(rows):
        for column in range(columns):
            bits = markers.get((column, row))
            if bits is not None and isinstance(target, CharucoTarget):
                cell = target.marker_mm / len(bits)
                margin = (side - target.marker_mm) / 2
                dark += [
                    (column * side + margin + j * cell, row * side + margin + i * cell, cell, cell)
                    for i, j in np.argwhere(~bits)
                ]
            elif isinstance(target, CharucoTarget) or (column + row) % 2 == 0:
                dark.append((column * side, row * side, side, side))
    return np.array(dark, dtype=np.float64)
