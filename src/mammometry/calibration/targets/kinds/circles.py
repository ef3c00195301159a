"""Boards of dark circles, in a square or a staggered grid."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import ClassVar

import cv2
import numpy as np

from mammometry.base.photograph import Photograph
from mammometry.calibration.features.board_map import LENS_TOLERANCE, BoardMap, fit_board_map
from mammometry.calibration.features.dots import measure_dots
from mammometry.calibration.features.found_points import Cause, FoundPoints
from mammometry.calibration.features.mark_size import mark_size
from mammometry.calibration.features.pixels import enlarge, grey_bytes, linear_luma, reduced
from mammometry.calibration.targets.board import Board
from mammometry.calibration.targets.registry import TARGETS
from mammometry.calibration.targets.sheet import Pattern, Sheet
from mammometry.calibration.targets.target import require_grid, require_positive
from mammometry.geometry.arrays import Array, Float64, UInt8, read_only

_MIN_AREA_PX = 12.0
"""Smallest blob in the reduced picture, px²: a circle 4 px wide, chosen by eye."""
_MAX_MISFIT = 0.15
"""RMS distance from the map, in pitches, above which the grid was read in the wrong order."""
_MAX_ERROR = 0.15
"""Largest distance of one circle from where its neighbours put it, in diameters."""
_SIZE_OFF = 0.1
"""Share by which circles may differ from their stated size: rulers and ink err by .5 mm of a small circle."""
_ROUNDS = 2
"""Measurements, each with the map of the one before. Chosen by eye."""


def find_circles(photograph: Photograph, target: CirclesTarget, *, search_width_px: int) -> FoundPoints | Cause | None:
    """Find the circle centres of a board wholly in the picture.

    None if it is not, the cause if the circles have another size.
    If half a turn leaves the grid unchanged, the board's x axis points to the picture's right.
    """
    small, scale = reduced(grey_bytes(photograph), search_width_px)
    grid = _search(small, target)
    if grid is None:
        return None
    centres_mm = target.points_target[:, :2].copy()
    tolerance_px = LENS_TOLERANCE * max(photograph.size_wh) + 2.0 * float(scale.max())
    board_map = _orient(enlarge(grid, scale), centres_mm, target, tolerance_px)
    if board_map is None:
        return None
    linear = linear_luma(photograph)
    size = mark_size(linear, board_map.image, centres_mm, shape="disc", reach_mm=target.nearest_mm / 2)
    if size is not None and size.contradicts(target.diameter_mm / 2, _SIZE_OFF):
        return size.cause(("diameter_mm", target.diameter_mm), ("pitch_mm", target.pitch_mm))
    for _ in range(_ROUNDS):
        dots = measure_dots(
            linear,
            board_map.image,
            centres_mm,
            shape="disc",
            half_mm=target.diameter_mm / 2,
            pitch_mm=(target.nearest_mm, target.nearest_mm),
        )
        found = fit_board_map(centres_mm[dots.ok], dots.uv[dots.ok], tolerance_px=tolerance_px)
        if found is None:
            return None
        board_map = found[0]
    size_px = np.sqrt(np.abs(np.linalg.det(board_map.jacobian(centres_mm)))) * target.diameter_mm
    good = dots.ok & (np.linalg.norm(board_map.image(centres_mm) - dots.uv, axis=1) < _MAX_ERROR * size_px)
    return FoundPoints(ids=np.flatnonzero(good), uv=dots.uv[good], covariance_px2=dots.covariance_px2[good])


def _search(small: UInt8[Array, "h w"], target: CirclesTarget) -> Float64[Array, "r c 2"] | None:
    parameters = cv2.SimpleBlobDetector.Params()
    parameters.minArea = _MIN_AREA_PX
    parameters.maxArea = small.size / (target.grid[0] * target.grid[1])
    parameters.minDistBetweenBlobs = 3.0
    detector = cv2.SimpleBlobDetector.create(parameters)
    kind = cv2.CALIB_CB_ASYMMETRIC_GRID if target.asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
    for flags in (kind, kind | cv2.CALIB_CB_CLUSTERING):
        found, centres = cv2.findCirclesGrid(small, target.grid, flags=flags, blobDetector=detector)
        if found and centres is not None:
            return np.asarray(centres, np.float64).reshape(target.grid[1], target.grid[0], 2)
    return None


def _orient(
    grid: Float64[Array, "r c 2"], centres_mm: Float64[Array, "n 2"], target: CirclesTarget, tolerance_px: float
) -> BoardMap | None:
    """Map of the reading order that fits. Of several, the one whose x axis points most to the right."""
    orders = [grid, grid[::-1], grid[:, ::-1], grid[::-1, ::-1]]
    if target.grid[0] == target.grid[1] and not target.asymmetric:
        orders += [order.transpose(1, 0, 2) for order in orders]
    fits: list[tuple[float, BoardMap]] = []
    for order in orders:
        uv = np.ascontiguousarray(order.reshape(-1, 2))
        found = fit_board_map(centres_mm, uv, tolerance_px=tolerance_px)
        if found is None:
            continue
        jacobian = found[0].jacobian(centres_mm)
        pitch_px = float(np.median(np.sqrt(np.abs(np.linalg.det(jacobian))))) * target.pitch_mm
        misfit = float(np.sqrt(np.square(found[0].image(centres_mm) - uv).sum(axis=1).mean()))
        if misfit < _MAX_MISFIT * pitch_px:
            fits.append((float(np.median(jacobian[:, 0, 0])), found[0]))
    return max(fits, key=lambda fit: fit[0])[1] if fits else None


_LEAST_CIRCLES = 2
"""In a row, and rows: fewer make no grid."""


@TARGETS.add("circles")
@dataclass(frozen=True, slots=True, kw_only=True)
class CirclesTarget(Board):
    """A board of dark circles on white.

    Origin at the first circle's centre, x right, y down, z into the board; ids row by row.

    Raises:
        ValueError: fewer than 2 × 2 circles, or circles that would touch.
    """

    size_key: ClassVar[str] = "pitch_mm"

    grid: tuple[int, int]
    """Circles in a row, and rows."""
    pitch_mm: float
    """Symmetric: distance of neighbours, mm. Asymmetric (as OpenCV's): distance of the rows, half of that in a row."""
    diameter_mm: float
    """Diameter of a circle, mm."""
    asymmetric: bool = False
    """True where every second row is shifted by half a step."""

    def __post_init__(self) -> None:
        Board.__post_init__(self)
        require_grid("grid", self.grid, _LEAST_CIRCLES)
        require_positive(pitch_mm=self.pitch_mm, diameter_mm=self.diameter_mm)
        if self.diameter_mm >= self.nearest_mm:
            raise ValueError(
                f"circles of diameter_mm {self.diameter_mm} touch at a distance of {self.nearest_mm:.3f} mm"
            )

    @property
    def nearest_mm(self) -> float:
        """Distance from a circle's centre to the nearest other one, mm."""
        return self.pitch_mm * (math.sqrt(2.0) if self.asymmetric else 1.0)

    @property
    def points_target(self) -> Float64[Array, "n 3"]:
        """Circle centres by id, board frame, mm."""
        column, row = (grid.ravel().astype(np.float64) for grid in np.meshgrid(*map(np.arange, self.grid)))
        x = 2.0 * column + row % 2 if self.asymmetric else column
        return read_only(np.stack([x, row, np.zeros_like(x)], axis=1) * self.pitch_mm)

    @property
    def edge_mm(self) -> float:
        """Length of the pattern along x, mm. From the first column's centres to the last one's."""
        return float(np.ptp(self.points_target[:, 0]))

    @property
    def extent_mm(self) -> Float64[Array, "2 2"]:
        """Corners of the rectangle around all circles, mm."""
        points = self.points_target[:, :2]
        return np.array([points.min(axis=0), points.max(axis=0)]) + self.diameter_mm * np.array([[-0.5], [0.5]])

    @property
    def looks_alike_turned(self) -> bool:
        """Whether half a turn gives the same grid.

        True for square grids, and for staggered ones with an even number of rows.
        """
        return not self.asymmetric or self.grid[1] % 2 == 0

    def find(
        self, photograph: Photograph, *, search_width_px: int, window_squares: float
    ) -> FoundPoints | Cause | None:
        """Find the circles' centres. See `find_circles`."""
        return find_circles(photograph, self, search_width_px=search_width_px)

    def mistaken(self) -> Iterator[tuple[str, CirclesTarget]]:
        """Yield boards with rows and columns exchanged, or one more or less."""
        columns, rows = self.grid
        counts = [(rows, columns), *((columns + a, rows + b) for a, b in product((1, 0, -1), repeat=2) if a or b)]
        for grid in counts:
            if min(grid) >= _LEAST_CIRCLES:
                yield f"grid = [{grid[0]}, {grid[1]}]", replace(self, grid=grid)

    @property
    def pattern(self) -> Pattern:
        """The grid of circles."""
        return Pattern(
            grid="staggered" if self.asymmetric else "circles",
            count=self.grid,
            pitch_mm=self.pitch_mm,
            mark_mm=0.5 * self.diameter_mm,
            cells=np.zeros((0, 0, 1, 1), dtype=np.uint8),
        )

    def sheet(self) -> Sheet:
        """Return the discs."""
        centres = self.points_target[:, :2]
        discs = np.column_stack([centres, np.full(len(centres), self.diameter_mm / 2)])
        return Sheet(extent_mm=self.extent_mm, discs=discs)

    def caption(self) -> str:
        """Describe the print in one line."""
        grid = f"{'staggered ' if self.asymmetric else ''}{self.grid[0]} × {self.grid[1]}"
        return f"circles, {grid}, pitch {self.pitch_mm:g} mm, diameter {self.diameter_mm:g} mm"
