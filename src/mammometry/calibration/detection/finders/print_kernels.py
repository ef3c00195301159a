"""Compiled kernel that draws a ChArUco board as a photograph should show it.

It releases the GIL, so that photographs are measured in parallel.
"""

import numpy as np

from mammometry.base.machine.compiled import kernel
from mammometry.calibration.targets.sheet import DARK, MARKER
from mammometry.geometry.arrays import Array, Float64, Int64, UInt8

_SUBPIXELS = 4  # samples along each side of a pixel


@kernel
def draw_print(
    low: Int64[Array, " 2"],
    size_wh: Int64[Array, " 2"],
    board_from_ideal: Float64[Array, "3 3"],
    to_ideal: Float64[Array, "10 2"],
    centre_px: Float64[Array, " 2"],
    scale_px: float,
    cells: UInt8[Array, "rows columns c c"],
    square_mm: float,
    marker_mm: float,
) -> tuple[Float64[Array, "h w"], Float64[Array, "h w 2"]]:
    """Share of white in each pixel of a box, and the pixel's position on the board, mm.

    Args:
        low: first pixel of the box.
        size_wh: width and height of the box.
        board_from_ideal: homography of `BoardMap`, inverted.
        to_ideal: polynomial of `BoardMap`.
        centre_px: its centre.
        scale_px: its scale.
        cells: `SheetPattern.cells`.
        square_mm: side of a square.
        marker_mm: side of a marker.
    """
    rows, columns = cells.shape[0], cells.shape[1]
    count = cells.shape[2] - 1
    width, height = size_wh
    white = np.zeros((height, width))
    board_mm = np.zeros((height, width, 2))
    terms = np.ones(10)
    for i in range(height * _SUBPIXELS):
        for j in range(width * _SUBPIXELS):
            u = low[0] - 0.5 + (j + 0.5) / _SUBPIXELS
            v = low[1] - 0.5 + (i + 0.5) / _SUBPIXELS
            x, y = (u - centre_px[0]) / scale_px, (v - centre_px[1]) / scale_px
            terms[1], terms[2], terms[3], terms[4], terms[5] = x, y, x * x, x * y, y * y
            terms[6], terms[7], terms[8], terms[9] = x * x * x, x * x * y, x * y * y, y * y * y
            for k in range(10):
                u += terms[k] * to_ideal[k, 0]
                v += terms[k] * to_ideal[k, 1]
            depth = board_from_ideal[2, 0] * u + board_from_ideal[2, 1] * v + board_from_ideal[2, 2]
            mm_x = (board_from_ideal[0, 0] * u + board_from_ideal[0, 1] * v + board_from_ideal[0, 2]) / depth
            mm_y = (board_from_ideal[1, 0] * u + board_from_ideal[1, 1] * v + board_from_ideal[1, 2]) / depth
            p, q = i // _SUBPIXELS, j // _SUBPIXELS
            board_mm[p, q, 0] += mm_x
            board_mm[p, q, 1] += mm_y
            column, row = int(np.floor(mm_x / square_mm)), int(np.floor(mm_y / square_mm))
            if column < 0 or column >= columns or row < 0 or row >= rows:
                white[p, q] += 1.0
                continue
            kind = cells[row, column, 0, 0]
            if kind == DARK:
                continue
            cell_x = (mm_x - (column + 0.5) * square_mm + marker_mm / 2) / marker_mm * count
            cell_y = (mm_y - (row + 0.5) * square_mm + marker_mm / 2) / marker_mm * count
            on_marker = kind == MARKER and 0 <= cell_x < count and 0 <= cell_y < count
            if not on_marker or cells[row, column, 1 + int(cell_y), 1 + int(cell_x)]:
                white[p, q] += 1.0
    return white / _SUBPIXELS**2, board_mm / _SUBPIXELS**2
