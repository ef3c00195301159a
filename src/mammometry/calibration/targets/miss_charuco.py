"""Why a ChArUco board was missed: other markers, mirrored, or two boards."""

from __future__ import annotations

import cv2
import numpy as np

from mammometry.calibration.features.found_points import Cause
from mammometry.calibration.targets.charuco import CharucoTarget
from mammometry.calibration.targets.charuco_board import charuco_board
from mammometry.calibration.targets.find_charuco import DOUBLED_MARKERS
from mammometry.geometry.arrays import Array, UInt8

_MIN_MARKERS = 4
"""Fewest markers taken for a board: fewer are found in any texture."""
_DICTIONARIES = (
    "DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_APRILTAG_36h11", "DICT_APRILTAG_25h9",
    "DICT_ARUCO_MIP_36h12", "DICT_ARUCO_ORIGINAL",
)  # fmt: skip
"""OpenCV's largest dictionary of each marker size, which contains the smaller ones' markers."""


def explain_missed_charuco(small: UInt8[Array, "h w"], target: CharucoTarget) -> Cause | None:
    """Report a reduced grey picture's markers, and why they do not match."""
    columns, rows = target.squares
    ids, shapes = _markers(small, target.dictionary)
    own = set(np.ravel(charuco_board(target).getIds()).tolist())
    strangers = sorted(set(ids) - own)
    if len(ids) >= _MIN_MARKERS:
        if cause := _doubled(ids):
            return cause
        seen_markers = f"{len(ids)} markers of {target.dictionary}"
        if len(strangers) >= _MIN_MARKERS:
            return Cause(
                found=f"{seen_markers}, {len(strangers)} of them with numbers (up to {strangers[-1]}) that a board of "
                f"{columns} × {rows} squares does not have",
                remedy="Correct [target] squares, or photograph the board that session.toml describes",
            )
        return Cause(
            found=f"{seen_markers} that do not lie as on a board of {columns} × {rows} squares, or too few corners "
            "beside them",
            remedy="Correct [target] (squares, legacy_pattern) if all pictures say so; else have more of the board in "
            "the picture, flat and sharp",
        )
    if shapes < _MIN_MARKERS:
        return None
    mirrored, _ = _markers(np.ascontiguousarray(small[:, ::-1]), target.dictionary)
    if len(mirrored) >= _MIN_MARKERS:
        return Cause(
            found=f"a mirrored board: {len(mirrored)} of its markers are seen only in the picture's mirror image",
            remedy="Export the photographs without flipping them, and photograph the board itself, not its reflection",
        )
    if ids:
        return Cause(
            found=f"{len(ids)} markers of {target.dictionary}, too few to place the board",
            remedy="Have more of the board in the picture, larger, or less aslant",
        )
    for name in _DICTIONARIES:
        others, _ = _markers(small, name)
        if name[:8] != target.dictionary[:8] and len(others) >= _MIN_MARKERS:
            return Cause(
                found=f"a board with {len(others)} markers of another dictionary ({name.rpartition('_')[0]}…)",
                remedy=f"Correct [target] dictionary ({target.dictionary}), or photograph the right board",
            )
    return None


def _markers(small: UInt8[Array, "h w"], dictionary: str) -> tuple[list[int], int]:
    """Numbers of the markers in the picture, and of readable squares.

    Repetitions are included.
    """
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    _, ids, rejected = cv2.aruco.ArucoDetector(known).detectMarkers(small)
    numbers = [] if ids is None else [int(number) for number in np.ravel(ids)]
    return numbers, len(numbers) + len(rejected)


def _doubled(ids: list[int]) -> Cause | None:
    twice = len(ids) - len(set(ids))
    if twice < DOUBLED_MARKERS:
        return None
    return Cause(
        found=f"{twice} markers twice: two boards in view, or a board and its mirror image",
        remedy="Have one board in the picture only, and cover what mirrors it",
    )
