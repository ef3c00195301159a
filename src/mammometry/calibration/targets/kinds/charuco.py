"""ChArUco boards: chess corners, identified by markers in the white squares."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from mammometry.base.errors import SessionError
from mammometry.calibration.targets.board import SquaresBoard
from mammometry.calibration.targets.sheet import DARK, MARKER, SheetPattern
from mammometry.calibration.targets.target import TARGETS
from mammometry.geometry.arrays import Array, UInt8, read_only

if TYPE_CHECKING:
    import cv2


@TARGETS.add("charuco")
@dataclass(frozen=True, slots=True, kw_only=True)
class CharucoTarget(SquaresBoard):
    """A ChArUco board. Ids are OpenCV's.

    Raises:
        ValueError: fewer than 3 × 3 squares, or a marker that is not smaller than its square.
    """

    may_be_cropped: ClassVar[bool] = True

    marker_mm: float
    """Side of a marker, mm, as measured on the print."""
    dictionary: str
    """OpenCV's name of the marker dictionary, e.g. ``DICT_5X5_250``."""
    legacy_pattern: bool = False
    """True for boards made before OpenCV 4.6, which start with a white square if the number of rows is even."""

    def __post_init__(self) -> None:
        SquaresBoard.__post_init__(self)
        if not 0 < self.marker_mm < self.square_mm:
            raise ValueError(f"marker_mm must be between 0 and square_mm ({self.square_mm}), found {self.marker_mm}")

    @property
    def pattern(self) -> SheetPattern:
        """Squares and markers.

        Raises:
            SessionError: unknown marker dictionary.
        """
        return SheetPattern(
            grid="squares",
            count=self.squares,
            pitch_mm=self.square_mm,
            mark_mm=self.marker_mm,
            cells=printed_cells(self),
        )

    def caption(self) -> str:
        """Describe the print in one line."""
        return (
            f"charuco, {self.squares[0]} × {self.squares[1]} squares of {self.square_mm:g} mm, "
            f"markers of {self.marker_mm:g} mm, {self.dictionary}"
        )


def charuco_board(target: CharucoTarget) -> cv2.aruco.CharucoBoard:
    """Return OpenCV's board of a target.

    Raises:
        SessionError: the dictionary is unknown or has too few markers.
    """
    import cv2

    number = getattr(cv2.aruco, target.dictionary, None) if target.dictionary.startswith("DICT_") else None
    markers = target.squares[0] * target.squares[1] // 2
    dictionary = None if number is None else cv2.aruco.getPredefinedDictionary(number)
    if dictionary is None or len(dictionary.bytesList) < markers:
        raise SessionError(
            "[target] dictionary",
            found=repr(target.dictionary),
            expected=f"an OpenCV dictionary of at least {markers} markers, such as 'DICT_5X5_250'",
            remedy="Give the name of the dictionary that the board was made with",
        )
    # Only the board's part of the dictionary: the detector compares each square with every marker in it.
    own = cv2.aruco.Dictionary(
        dictionary.bytesList[:markers].copy(), dictionary.markerSize, dictionary.maxCorrectionBits
    )
    board = cv2.aruco.CharucoBoard(target.squares, target.square_mm, target.marker_mm, own)
    board.setLegacyPattern(target.legacy_pattern)
    return board


@cache
def printed_cells(target: CharucoTarget) -> UInt8[Array, "rows columns c c"]:
    """Cells printed in every square, as in `SheetPattern.cells`. A marker has a black border of one cell.

    Raises:
        SessionError: unknown marker dictionary.
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
