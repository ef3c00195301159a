"""OpenCV's ChArUco board: its markers' numbers, places and cells."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np

from mammometry.base.errors import SessionError
from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.calibration.targets.sheet import DARK, MARKER
from mammometry.geometry.arrays import Array, UInt8, read_only


def charuco_board(target: CharucoTarget) -> cv2.aruco.CharucoBoard:
    """Return OpenCV's board of a target.

    Raises:
        SessionError: there is no dictionary of that name, or it has too few markers.
    """
    number = getattr(cv2.aruco, target.dictionary, None) if target.dictionary.startswith("DICT_") else None
    markers = target.squares[0] * target.squares[1] // 2
    dictionary = None if number is None else cv2.aruco.getPredefinedDictionary(number)
    if dictionary is None or len(dictionary.bytesList) < markers:
        raise SessionError(
            "[target] dictionary",
            found=repr(target.dictionary),
            expected=f"an OpenCV dictionary of at least {markers} markers, such as 'DICT_5X5_250'",
            remedy="Write the name of the dictionary that the board was made with",
        )
    # Of the dictionary only what is on the board: the detector compares each square with all that it is given.
    own = cv2.aruco.Dictionary(
        dictionary.bytesList[:markers].copy(), dictionary.markerSize, dictionary.maxCorrectionBits
    )
    board = cv2.aruco.CharucoBoard(target.squares, target.square_mm, target.marker_mm, own)
    board.setLegacyPattern(target.legacy_pattern)
    return board


@cache
def printed_cells(target: CharucoTarget) -> UInt8[Array, "rows columns c c"]:
    """What is printed in every square, as `Pattern.cells` has it.

    A marker's black rim of one cell is included.

    Raises:
        SessionError: there is no dictionary of the target's name.
    """
    board = charuco_board(target)
    dictionary = board.getDictionary()
    cells = int(dictionary.markerSize) + 2
    columns, rows = target.squares
    printed = np.full((rows, columns, cells + 1, cells + 1), DARK, dtype=np.uint8)
    for identity, corners in zip(np.ravel(board.getIds()), board.getObjPoints(), strict=True):
        x, y = np.asarray(corners).reshape(4, 3)[:, :2].mean(axis=0) / target.square_mm
        printed[int(y), int(x), 0, 0] = MARKER
        printed[int(y), int(x), 1:, 1:] = dictionary.generateImageMarker(int(identity), cells) > 0
    return read_only(printed)
