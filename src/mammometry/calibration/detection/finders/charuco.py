"""Find ChArUco boards by their markers and measure their corners, or name the board that they fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from mammometry.base.photograph import Photograph
from mammometry.calibration.features.board_map import BoardMap, fit_board_map, search_tolerance_px
from mammometry.calibration.features.corners import CornerGrid, MarkerArea, refine_corners
from mammometry.calibration.features.dots import mark_size
from mammometry.calibration.features.pixels import Cause, FoundPoints, enlarge, grey_bytes, linear_luma, reduced
from mammometry.calibration.targets.kinds.charuco import CharucoTarget, charuco_board
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int64, UInt8

FITTING_SHARE = 0.9
"""Smallest share of markers whose arrangement fits the board. On a board of the other pattern it is a half."""
TOLERANCE_SQUARES = 0.35
"""Largest distance of a marker's corner from its place, squares. Lens distortion is smaller, other boards differ by
one."""
_COLUMNS = range(3, 41)
"""Numbers of columns to test."""
_LEAST_ROWS = 3
"""Rows of markers that distinguish boards: two rows may also fit a shifted, tilted board."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeenMarkers:
    """Markers in one image."""

    ids: Int64[Array, " m"]
    """Their numbers, possibly repeated."""
    corners: Float64[Array, "m 4 2"]
    """Their corners clockwise from the top left one, px."""

    @classmethod
    def of(cls, corners: Sequence[Array], ids: Array | None) -> SeenMarkers:
        """Convert the output of OpenCV's detector."""
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
        """Share of the markers that are arranged as on this board.

        Args:
            seen: at least four markers of the image.
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
    """Find the board whose layout the markers have, and its rows down to the last marker.

    None if no board fits or there are too few markers.

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


DOUBLED_MARKERS = 4
"""Most markers that may be seen twice. With more, two boards are in view, and the right one is unknown."""
_BLUR_MARGIN_PX = 2.5
"""Width of a marker's blurred edge, excluded with it."""
_NEARLY_ALL = 0.95
"""Share of the markers inside the image that one threshold must find."""
_FEWEST_MARKERS = 8
"""Fewest markers for testing whether all were found."""
_RATIO_OFF = 0.05
"""Largest relative difference of markers from their stated size: printers and rulers err by at most 2 %."""


def _one_threshold() -> cv2.aruco.DetectorParameters:
    """Search with the middle one of OpenCV's three windows."""
    parameters = cv2.aruco.DetectorParameters()
    middle = (parameters.adaptiveThreshWinSizeMin + parameters.adaptiveThreshWinSizeMax) // 2
    parameters.adaptiveThreshWinSizeMin = parameters.adaptiveThreshWinSizeMax = middle
    return parameters


_ONE_THRESHOLD = _one_threshold()


def find_charuco(target: CharucoTarget, photograph: Photograph, search_width_px: int) -> FoundPoints | Cause | None:
    """Find the reliable chess corners. None if no board is seen, a cause if it is another board.

    Raises:
        SessionError: unknown dictionary.
    """
    small, scale = reduced(grey_bytes(photograph), search_width_px)
    seen = _search(small, charuco_board(target))
    if seen is None:
        return None
    board_mm, corners, markers = seen
    uv = enlarge(corners, scale)
    tolerance_px = search_tolerance_px(photograph.size_wh, scale)
    found = fit_board_map(board_mm, uv, tolerance_px=tolerance_px)
    if found is None:
        return None
    board_map, used = found
    off_mm = np.linalg.norm(board_map.board(uv) - board_mm, axis=1)
    if (off_mm < TOLERANCE_SQUARES * target.square_mm).mean() < FITTING_SHARE:
        return None  # every second row of a board of the other pattern fits, too
    linear = linear_luma(photograph)
    markers_mm = board_mm[:markers].reshape(-1, 4, 2).mean(axis=1)
    if cause := _about_marker_size(linear, board_map, markers_mm, target):
        return cause
    return refine_corners(
        linear,
        board_map,
        board_mm[used],
        CornerGrid(
            corners_mm=target.points_target[:, :2],
            square_mm=target.square_mm,
            bright_first=_bright_before_corners(target),
        ),
        blank=MarkerArea(square_mm=target.square_mm, marker_mm=target.marker_mm, rim_px=_BLUR_MARGIN_PX),
    )


def _search(
    small: UInt8[Array, "h w"], board: cv2.aruco.CharucoBoard
) -> tuple[Float64[Array, "n 2"], Float64[Array, "n 2"], int] | None:
    """Points of the board, mm, in the reduced image, px, and the number of marker corners, which come first.

    One threshold finds nearly all markers of an evenly lit image in half the time. If markers are missing, the other
    thresholds are used too.
    """
    corners, ids, markers, marker_ids = _detected(small, board, _ONE_THRESHOLD)
    if not _is_complete(markers, marker_ids, board, small.shape):
        corners, ids, markers, marker_ids = _detected(small, board, cv2.aruco.DetectorParameters())
    if marker_ids is None or len(marker_ids) == 0:
        return None
    first_id = {int(number): place for place, number in enumerate(np.ravel(board.getIds()))}
    numbers = np.ravel(marker_ids)
    if len(numbers) - len(np.unique(numbers)) >= DOUBLED_MARKERS:
        return None
    known = [k for k, number in enumerate(numbers) if int(number) in first_id]
    if not known:
        return None
    object_points = np.asarray(board.getObjPoints(), np.float64)
    board_mm = [object_points[first_id[int(numbers[k])], :, :2] for k in known]
    uv = [np.asarray(markers[k], np.float64).reshape(4, 2) for k in known]
    if ids is not None and len(ids):
        board_mm.append(np.asarray(board.getChessboardCorners(), np.float64)[np.ravel(ids), :2])
        uv.append(np.asarray(corners, np.float64).reshape(-1, 2))
    return np.concatenate(board_mm), np.concatenate(uv), 4 * len(known)


def _detected(
    small: UInt8[Array, "h w"], board: cv2.aruco.CharucoBoard, parameters: cv2.aruco.DetectorParameters
) -> Any:
    """Chess corners and their ids, markers and theirs."""
    return cv2.aruco.CharucoDetector(board, detectorParams=parameters).detectBoard(small)


def _is_complete(
    markers: Sequence[Array], marker_ids: Array | None, board: cv2.aruco.CharucoBoard, shape_hw: tuple[int, ...]
) -> bool:
    """Whether nearly all of the board's markers inside the image were found."""
    places = {int(number): place for place, number in enumerate(np.ravel(board.getIds()))}
    numbers = [] if marker_ids is None else [int(number) for number in np.ravel(marker_ids)]
    known = [k for k, number in enumerate(numbers) if number in places]
    if len(known) < _FEWEST_MARKERS:
        return False
    centres_mm = np.asarray(board.getObjPoints(), np.float64).mean(axis=1)[:, :2]
    seen_px = np.array([np.asarray(markers[k], np.float64).reshape(4, 2).mean(axis=0) for k in known])
    picture_from_board, _ = cv2.findHomography(centres_mm[[places[numbers[k]] for k in known]], seen_px, cv2.LMEDS)
    if picture_from_board is None:  # None for points on a line, contrary to OpenCV's type hints
        return False  # type: ignore[unreachable]
    expected = cv2.perspectiveTransform(centres_mm.reshape(-1, 1, 2), picture_from_board).reshape(-1, 2)
    inside = ((expected > 0) & (expected < np.array(shape_hw[::-1]))).all(axis=1)
    return len(known) >= _NEARLY_ALL * int(inside.sum())


def _about_marker_size(
    linear: Float32[Array, "h w"], board_map: BoardMap, markers_mm: Float64[Array, "m 2"], target: CharucoTarget
) -> Cause | None:
    """Report markers whose size does not fit the squares."""
    size = mark_size(linear, board_map.image, markers_mm, shape="square", reach_mm=target.square_mm / 2)
    if size is None or not size.contradicts(target.marker_mm / 2, _RATIO_OFF):
        return None
    return size.cause(("marker_mm", target.marker_mm), ("square_mm", target.square_mm))


def _bright_before_corners(target: CharucoTarget) -> Bool[Array, " n"]:
    column, row = np.meshgrid(np.arange(target.squares[0] - 1), np.arange(target.squares[1] - 1))
    starts_bright = target.legacy_pattern and target.squares[1] % 2 == 0
    bright: Bool[Array, " n"] = (column + row).ravel() % 2 == (0 if starts_bright else 1)
    return bright


_MIN_MARKERS = 4
"""Fewest markers that count as a board: textures contain a few."""
_DICTIONARIES = (
    "DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_APRILTAG_36h11", "DICT_APRILTAG_25h9",
    "DICT_ARUCO_MIP_36h12", "DICT_ARUCO_ORIGINAL",
)  # fmt: skip
"""OpenCV's largest dictionary of each marker size, which contains the smaller ones' markers."""
_SIZES = (50, 100, 250, 1000)
"""Markers in OpenCV's dictionaries of one marker size."""
_MOST_MARKERS = 300
"""Markers of a dictionary that are compared, for speed. Larger boards have squares of a few pixels."""


def explain_missed_charuco(target: CharucoTarget, small: UInt8[Array, "h w"]) -> Cause | None:
    """Describe the board of a reduced grey image's markers, and the settings that would fit."""
    seen, shapes = _markers(small, target.dictionary)
    if len(seen.ids) >= _MIN_MARKERS:
        return _doubled(seen) or _about_layout(seen, target, target.dictionary)
    if shapes < _MIN_MARKERS:
        return None
    if len(_markers(np.ascontiguousarray(small[:, ::-1]), target.dictionary)[0].ids) >= _MIN_MARKERS:
        return Cause(
            found="a mirrored board: its markers are found only in the mirrored image",
            remedy="Export the photographs without flipping them, and photograph the board itself, not its reflection. "
            "If nothing was flipped, the board was printed mirrored: print it again",
            code="mirrored",
        )
    if len(seen.ids):
        return Cause(
            found=f"{len(seen.ids)} markers of {target.dictionary}, too few to locate the board",
            remedy="Show more of the board, larger or less tilted",
        )
    for name in _DICTIONARIES:
        others, _ = _markers(small, name)
        if name[:8] != target.dictionary[:8] and len(others.ids) >= _MIN_MARKERS:
            return _about_layout(others, target, name)
    return None


def _markers(small: UInt8[Array, "h w"], dictionary: str) -> tuple[SeenMarkers, int]:
    """Markers in the image, and number of readable squares."""
    every = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    known = cv2.aruco.Dictionary(every.bytesList[:_MOST_MARKERS].copy(), every.markerSize, every.maxCorrectionBits)
    corners, ids, rejected = cv2.aruco.ArucoDetector(known).detectMarkers(small)
    return SeenMarkers.of(corners, ids), len(corners) + len(rejected)


def _doubled(seen: SeenMarkers) -> Cause | None:
    twice = len(seen.ids) - len(np.unique(seen.ids))
    if twice < DOUBLED_MARKERS:
        return None
    return Cause(
        found=f"{twice} duplicate markers: two boards in view, or a board and its reflection",
        remedy="Show only one board, and cover reflecting surfaces",
    )


def _about_layout(seen: SeenMarkers, target: CharucoTarget, dictionary: str) -> Cause:
    """Name the description that the markers fit, if any."""
    columns, rows = target.squares
    starts_bright = target.legacy_pattern and rows % 2 == 0
    marker_squares = target.marker_mm / target.square_mm
    if dictionary == target.dictionary:
        own = MarkerLayout(columns=columns, starts_bright=starts_bright)
        if own.fitting_share(seen, marker_squares) >= FITTING_SHARE:
            return Cause(
                found=f"{len(seen.ids)} markers of the board, but too few corners",
                remedy="Show more of the board, flat and in focus",
            )
    fitting = layout_of(seen, marker_squares, (columns, rows, columns + 1, columns - 1))
    if fitting is None:
        other = "" if dictionary == target.dictionary else f" of another dictionary ({dictionary.rpartition('_')[0]}…)"
        return Cause(
            found=f"markers{other} that are not placed as on a board of {columns} × {rows} squares",
            remedy="Compare [target] (squares, dictionary, legacy_pattern) with the board, and show the whole board "
            "flat and in focus",
        )
    changes = " and ".join(_changes(*fitting, seen, target, dictionary))
    return Cause(
        found=f"a board with {changes}",
        remedy=f"Write {changes} in [target] of session.toml, or photograph the described board",
    )


def _changes(
    layout: MarkerLayout, rows_seen: int, seen: SeenMarkers, target: CharucoTarget, dictionary: str
) -> Iterator[str]:
    """Yield the keys of session.toml that would fit the markers."""
    columns, rows = target.squares
    # The image may not show the last rows. Their number is as stated, or was swapped with the columns, or was counted
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
