"""What is printed on a board, as dark shapes in millimetres: for the printer, and for tests of the detectors."""

from __future__ import annotations

import cv2
import numpy as np

from mammometry.base.errors import SettingsError
from mammometry.calibration.targets.charuco import charuco_board
from mammometry.calibration.targets.target import CharucoTarget, ChessboardTarget, DottedCylinderTarget
from mammometry.geometry.arrays import Array, Bool, Float64

_DOT_SHARE, _LABEL_SHARE = 0.45, 0.7
"""Side of a dot, and of a label, in pitches."""
_LABEL_UP = 0.9
"""Middle of a label beyond the last row, in row pitches."""


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


def column_labels(columns: int) -> Bool[Array, "c 6 6"]:
    """Cells of the label beyond each column of a dotted cylinder, True dark, ``[column, row, cell]`` seen upright.

    They are the insides of the markers of OpenCV's 6 × 6 dictionary, which differ from one another in many cells.

    Raises:
        SettingsError: more columns than there are labels.
    """
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_1000)
    if columns > len(dictionary.bytesList):
        raise SettingsError(
            "target",
            found=f"{columns} columns of dots",
            expected=f"at most {len(dictionary.bytesList)}, one label each",
            remedy="Print fewer, or label them by hand",
        )
    return np.stack([np.asarray(dictionary.generateImageMarker(k, 8))[1:-1, 1:-1] < 128 for k in range(columns)])


def wrap_sheet(target: DottedCylinderTarget) -> Float64[Array, "n 4"]:
    """Dark rectangles of the sheet that is wrapped round a cylinder: x, y, width and height, mm, from its upper left.

    The sheet is as wide as all columns; column 0 is the leftmost, row 0 the lowest, the labels stand above the last.
    """
    rows, columns = target.dots
    dx, dy = target.column_pitch_mm, target.row_pitch_mm
    side = target.dot_mm if target.dot_mm else _DOT_SHARE * min(dx, dy)
    cell = _LABEL_SHARE * min(dx, dy) / 6
    dark = []
    for column, label in enumerate(column_labels(columns)):
        x = (column + 0.5) * dx
        dark += [(x - side / 2, (rows + 0.5 - row) * dy - side / 2, side, side) for row in range(rows)]
        # The strip that `detect_cylinder` compares lies 0.4 to 1.4 pitches beyond the last row.
        corner = (x - 3 * cell, (1.5 - _LABEL_UP) * dy - 3 * cell)
        dark += [(corner[0] + j * cell, corner[1] + i * cell, cell, cell) for i, j in np.argwhere(label)]
    return np.array(dark, dtype=np.float64)


def dark_rectangles(target: CharucoTarget | ChessboardTarget | DottedCylinderTarget) -> Float64[Array, "n 4"]:
    """All that is printed: x, y, width and height of dark rectangles on the board or sheet, mm; none overlap.

    Raises:
        SessionError: no dictionary of the target's name.
        SettingsError: more columns of a cylinder than there are labels.
    """
    if isinstance(target, DottedCylinderTarget):
        return wrap_sheet(target)
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
