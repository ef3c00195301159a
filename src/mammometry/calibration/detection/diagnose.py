"""Why the target was not found in a photograph, as far as the photograph tells: looked into only where it was not."""

from __future__ import annotations

import cv2
import numpy as np

from mammometry.base.photograph import Photograph
from mammometry.calibration.features.found_points import Cause
from mammometry.calibration.features.pixels import grey_bytes, reduced
from mammometry.calibration.targets.charuco import DOUBLED_MARKERS, charuco_board
from mammometry.calibration.targets.target import CharucoTarget, ChessboardTarget, Target
from mammometry.geometry.arrays import Array, UInt8

_WHITE, _MAX_WHITE_SHARE = 252, 0.35
_DARK = 40
_MIN_STEP = 0.16
"""A sharp edge climbs this share of the picture's contrast from one reduced pixel to the next; a smeared one less."""
_MIN_CONTRAST = 50
_MIN_MARKERS = 4
_DICTIONARIES = (
    "DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_APRILTAG_36h11", "DICT_APRILTAG_25h9",
    "DICT_ARUCO_MIP_36h12", "DICT_ARUCO_ORIGINAL",
)  # fmt: skip


NOT_IN_VIEW = Cause(found="no target", remedy="")
"""Nothing in the photograph says that the target should have been found."""


def diagnose(photograph: Photograph, target: Target, *, search_width_px: int) -> Cause:
    """Say why a photograph has no detection."""
    small, _ = reduced(grey_bytes(photograph), search_width_px)
    cause = None
    if isinstance(target, CharucoTarget):
        cause = _about_markers(small, target)
    elif isinstance(target, ChessboardTarget):
        cause = _about_squares(small, target)
    return cause or _about_exposure(small) or NOT_IN_VIEW


def _doubled(ids: list[int]) -> Cause | None:
    twice = len(ids) - len(set(ids))
    if twice < DOUBLED_MARKERS:
        return None
    return Cause(
        found=f"{twice} markers twice: two boards in view, or a board and its mirror image",
        remedy="Have one board in the picture only, and cover what mirrors it",
    )


def _about_markers(small: UInt8[Array, "h w"], target: CharucoTarget) -> Cause | None:
    columns, rows = target.squares
    ids, shapes = _markers(small, target.dictionary)
    own = set(np.ravel(charuco_board(target).getIds()).tolist())
    strangers = sorted(set(ids) - own)
    if len(ids) >= _MIN_MARKERS:
        if cause := _doubled(ids):
            return cause
        told = f"{len(ids)} markers of {target.dictionary}"
        if len(strangers) >= _MIN_MARKERS:
            return Cause(
                found=f"{told}, {len(strangers)} of them with numbers (up to {strangers[-1]}) that a board of "
                f"{columns} × {rows} squares does not have",
                remedy="Correct [target] squares, or photograph the board that session.toml describes",
            )
        return Cause(
            found=f"{told} that do not lie as on a board of {columns} × {rows} squares, or too few corners beside them",
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
    """Numbers of the markers in the picture, repetitions included, and how many squares there were to read at all."""
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    _, ids, rejected = cv2.aruco.ArucoDetector(known).detectMarkers(small)
    numbers = [] if ids is None else [int(number) for number in np.ravel(ids)]
    return numbers, len(numbers) + len(rejected)


def _about_squares(small: UInt8[Array, "h w"], target: ChessboardTarget) -> Cause | None:
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER
    found, *_ = cv2.findChessboardCornersSBWithMeta(small, (3, 3), flags)
    if not found:
        return None
    columns, rows = target.squares
    return Cause(
        found=f"squares of a chessboard, but none of {columns} × {rows} squares that is wholly in the picture",
        remedy="Correct [target] squares if all pictures say so; else have the whole board and its white rim in view",
    )


def _about_exposure(small: UInt8[Array, "h w"]) -> Cause | None:
    low, high = (float(level) for level in np.percentile(small, (1, 99.5)))
    white = float((small >= _WHITE).mean())
    if white > _MAX_WHITE_SHARE:
        return Cause(found=f"an over-exposed picture: {100 * white:.0f} % of it is white", remedy="Expose it less")
    if high < _DARK:
        return Cause(found="a picture that is nearly black", remedy="Expose it more, or check its flash")
    steps = np.abs(np.diff(small.astype(np.float32), axis=1))
    if high - low > _MIN_CONTRAST and float(np.percentile(steps, 99.9)) < _MIN_STEP * (high - low):
        return Cause(
            found="a picture without one sharp edge: blurred by motion or focus, or without the target",
            remedy="Focus on the board and hold it still while it is exposed",
        )
    return None
