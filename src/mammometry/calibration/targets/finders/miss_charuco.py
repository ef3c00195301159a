"""Why a ChArUco board was missed: another description, mirrored, or two boards."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from mammometry.calibration.features.found_points import Cause
from mammometry.calibration.targets.finders.find_charuco import DOUBLED_MARKERS
from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.calibration.targets.marker_layout import FITTING_SHARE, MarkerLayout, SeenMarkers, layout_of
from mammometry.geometry.arrays import Array, UInt8

_MIN_MARKERS = 4
"""Fewest markers taken for a board: fewer are found in any texture."""
_DICTIONARIES = (
    "DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_APRILTAG_36h11", "DICT_APRILTAG_25h9",
    "DICT_ARUCO_MIP_36h12", "DICT_ARUCO_ORIGINAL",
)  # fmt: skip
"""OpenCV's largest dictionary of each marker size, which contains the smaller ones' markers."""
_SIZES = (50, 100, 250, 1000)
"""Markers in OpenCV's dictionaries of one marker size."""
_MOST_MARKERS = 300
"""Markers of a dictionary that are compared, for speed. Larger boards have squares of a few pixels."""


def explain_missed_charuco(small: UInt8[Array, "h w"], target: CharucoTarget) -> Cause | None:
    """Report what a reduced grey picture's markers say, and which description would fit."""
    seen, shapes = _markers(small, target.dictionary)
    if len(seen.ids) >= _MIN_MARKERS:
        return _doubled(seen) or _about_layout(seen, target, target.dictionary)
    if shapes < _MIN_MARKERS:
        return None
    if len(_markers(np.ascontiguousarray(small[:, ::-1]), target.dictionary)[0].ids) >= _MIN_MARKERS:
        return Cause(
            found="a mirrored board, whose markers are seen only in the picture's mirror image",
            remedy="Export the photographs without flipping them, and photograph the board itself, not its reflection. "
            "If nothing was flipped, the board was printed mirrored: print it again",
        )
    if len(seen.ids):
        return Cause(
            found=f"{len(seen.ids)} markers of {target.dictionary}, too few to place the board",
            remedy="Have more of the board in the picture, larger, or less aslant",
        )
    for name in _DICTIONARIES:
        others, _ = _markers(small, name)
        if name[:8] != target.dictionary[:8] and len(others.ids) >= _MIN_MARKERS:
            return _about_layout(others, target, name)
    return None


def _markers(small: UInt8[Array, "h w"], dictionary: str) -> tuple[SeenMarkers, int]:
    """Markers in the picture, and number of readable squares."""
    every = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    known = cv2.aruco.Dictionary(every.bytesList[:_MOST_MARKERS].copy(), every.markerSize, every.maxCorrectionBits)
    corners, ids, rejected = cv2.aruco.ArucoDetector(known).detectMarkers(small)
    return SeenMarkers.of(corners, ids), len(corners) + len(rejected)


def _doubled(seen: SeenMarkers) -> Cause | None:
    twice = len(seen.ids) - len(np.unique(seen.ids))
    if twice < DOUBLED_MARKERS:
        return None
    return Cause(
        found=f"{twice} markers twice: two boards in view, or a board and its mirror image",
        remedy="Have one board in the picture only, and cover what mirrors it",
    )


def _about_layout(seen: SeenMarkers, target: CharucoTarget, dictionary: str) -> Cause:
    """Say which description the markers fit, if any."""
    columns, rows = target.squares
    starts_bright = target.legacy_pattern and rows % 2 == 0
    marker_squares = target.marker_mm / target.square_mm
    if dictionary == target.dictionary:
        own = MarkerLayout(columns=columns, starts_bright=starts_bright)
        if own.fitting_share(seen, marker_squares) >= FITTING_SHARE:
            return Cause(
                found=f"{len(seen.ids)} markers of the board, but too few corners beside them",
                remedy="Have more of the board in the picture, flat and sharp",
            )
    fitting = layout_of(seen, marker_squares, (columns, rows, columns + 1, columns - 1))
    if fitting is None:
        other = "" if dictionary == target.dictionary else f" of another dictionary ({dictionary.rpartition('_')[0]}…)"
        return Cause(
            found=f"markers{other} that do not lie as on a board of {columns} × {rows} squares",
            remedy="Compare [target] (squares, dictionary, legacy_pattern) with the board; have the whole board in the "
            "picture, flat and sharp",
        )
    changes = " and ".join(_changes(*fitting, seen, target, dictionary))
    return Cause(
        found=f"a board with {changes}",
        remedy=f"Write {changes} in [target] of session.toml, or photograph the board that it describes",
    )


def _changes(
    layout: MarkerLayout, rows_seen: int, seen: SeenMarkers, target: CharucoTarget, dictionary: str
) -> Iterator[str]:
    """Yield the keys of session.toml that would fit the markers."""
    columns, rows = target.squares
    # The picture may not show the last rows. They are as stated, or what was stated as columns, or were counted
    # between squares. A bright first square means an even number.
    likely = {columns: (rows,), rows: (columns,), columns + 1: (rows, rows + 1)}.get(layout.columns, ())
    even = 2 if layout.starts_bright else 1
    fitting = [count for count in likely if count >= rows_seen and count % even == 0]
    squares = layout.columns, min(fitting, default=rows_seen + rows_seen % even)
    if dictionary != target.dictionary:
        needed = max(int(seen.ids.max()) + 1, squares[0] * squares[1] // 2)
        family, _, size = dictionary.rpartition("_")
        sufficient = next((count for count in _SIZES if count >= needed), _SIZES[-1])
        yield f'dictionary = "{family}_{sufficient}"' if size == str(_SIZES[-1]) else f'dictionary = "{dictionary}"'
    if squares != target.squares:
        yield f"squares = [{squares[0]}, {squares[1]}]"
    if layout.starts_bright != (target.legacy_pattern and squares[1] % 2 == 0):
        yield f"legacy_pattern = {'true' if layout.starts_bright else 'false'}"
