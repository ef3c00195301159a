"""Sheet that is wrapped round a dotted cylinder: dots and labels."""

from __future__ import annotations

import cv2
import numpy as np

from mammometry.base.errors import SettingsError
from mammometry.calibration.targets.kinds.cylinder import DottedCylinderTarget
from mammometry.calibration.targets.sheet import Sheet
from mammometry.geometry.arrays import Array, Bool

_DOT_SHARE, _LABEL_SHARE = 0.45, 0.7
"""Default side of a dot, and side of a label, in pitches. Chosen by eye."""
_LABEL_CELLS = 6
"""Cells along each side of a label."""
_LABEL_UP = 0.9
"""Middle of a label beyond the last row, in row pitches: the middle of the strip that `find_cylinder` unrolls."""
_ABOVE_ROWS = 1.5
"""Height of the sheet above the last row, in row pitches: the labels' strip and a little more."""


def column_labels(columns: int) -> Bool[Array, "c 6 6"]:
    """Cells of the label beyond each column, ``[column, row, cell]``.

    True is dark. They are seen upright, and are the insides of the markers of OpenCV's 6 × 6 dictionary, which differ
    from one another in many cells.

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


def wrap_sheet(target: DottedCylinderTarget) -> Sheet:
    """Return the sheet wrapped round a cylinder, mm.

    Its origin is its upper left corner. The sheet is as wide as all columns. Column 0 is the leftmost, row 0 the
    lowest, and the labels are above the last.

    Raises:
        SettingsError: there are more columns than labels.
    """
    rows, columns = target.dots
    dx, dy = target.column_pitch_mm, target.row_pitch_mm
    side = target.dot_mm if target.dot_mm else _DOT_SHARE * min(dx, dy)
    cell = _LABEL_SHARE * min(dx, dy) / _LABEL_CELLS
    dark = []
    for column, label in enumerate(column_labels(columns)):
        x = (column + 0.5) * dx
        dark += [(x - side / 2, (rows + 0.5 - row) * dy - side / 2, side, side) for row in range(rows)]
        left, top = x - _LABEL_CELLS / 2 * cell, (_ABOVE_ROWS - _LABEL_UP) * dy - _LABEL_CELLS / 2 * cell
        dark += [(left + j * cell, top + i * cell, cell, cell) for i, j in np.argwhere(label)]
    return Sheet(
        extent_mm=np.array([[0.0, 0.0], [columns * dx, (rows + _ABOVE_ROWS) * dy]]),
        rectangles=np.array(dark, dtype=np.float64),
        cut_at_sides=True,
    )
