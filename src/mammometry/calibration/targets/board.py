"""Flat boards: common properties, boards of squares, and their solid for the simulation."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import ClassVar, Literal

import numpy as np

from mammometry.calibration.targets.sheet import ConvexBody, PrintedSheet, SheetPattern, TargetHits
from mammometry.calibration.targets.target import Target, require_grid, require_measured, require_positive
from mammometry.geometry.arrays import Array, Bool, Float64, read_only

BORDER_MM = 10.0
"""Width of the white border around a board's pattern. Detectors need a part of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlatBody(ConvexBody):
    """A board on its white paper, visible from its printed side only."""

    attitude: ClassVar[Literal["facing", "upright", "any"]] = "facing"

    board: Board

    @property
    def normals_target(self) -> Float64[Array, "n 3"]:
        """−z at every point."""
        return np.broadcast_to([0.0, 0.0, -1.0], self.board.points_target.shape)

    @property
    def middle_mm(self) -> Float64[Array, 3]:
        """Middle of the print, mm."""
        return np.append(self.board.extent_mm.mean(axis=0), 0.0)

    @property
    def paper_mm(self) -> Float64[Array, "2 2"]:
        """First and last corner (x, y) of the paper, mm."""
        return self.board.extent_mm + BORDER_MM * np.array([[-1.0], [1.0]])

    @property
    def hull_target(self) -> Float64[Array, "n 3"]:
        """Corners of the paper, mm."""
        return _corners(self.paper_mm)

    @property
    def looks_alike_turned(self) -> bool:
        """Delegates to the board."""
        return self.board.looks_alike_turned

    @property
    def pattern(self) -> SheetPattern | None:
        """Delegates to the board.

        Raises:
            SessionError: unknown marker dictionary.
        """
        return self.board.pattern

    def is_whole(
        self, seen: Bool[Array, " n"], in_picture: Callable[[Float64[Array, "m 3"]], Bool[Array, " m"]]
    ) -> bool:
        """Whether the whole print is in the image, unless the board may be cropped."""
        return self.board.may_be_cropped or bool(seen.all() and in_picture(_corners(self.board.extent_mm)).all())

    def meet(self, origins: Float64[Array, "n 3"], directions: Float64[Array, "n 3"]) -> TargetHits:
        """Intersect rays with the plane z = 0 from its printed side."""
        with np.errstate(divide="ignore", invalid="ignore"):
            along = -origins[:, 2] / directions[:, 2]
            points = origins + along[:, None] * directions
        left_top, right_bottom = self.paper_mm
        xy = points[:, :2]
        on_paper = (along > 0) & (directions[:, 2] > 0) & ((xy >= left_top) & (xy <= right_bottom)).all(axis=1)
        white = np.full(len(points), np.nan)
        white[on_paper] = np.where(self.board.sheet().is_dark(xy[on_paper]), 0.0, 1.0)
        return TargetHits(points=points, normals=np.broadcast_to([0.0, 0.0, -1.0], points.shape), white=white)


def _corners(extent_mm: Float64[Array, "2 2"]) -> Float64[Array, "4 3"]:
    (left, top), (right, bottom) = extent_mm
    return np.array([[left, top, 0.0], [right, top, 0.0], [right, bottom, 0.0], [left, bottom, 0.0]])


LEAST_SQUARES = 3
"""Fewest columns and rows: two inner corners in each direction are the smallest grid."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Board(Target):
    """A flat print in several poses. Frame: x right, y down, z into the board, mm."""

    may_be_cropped: ClassVar[bool] = False
    """Whether a part of it in the image is enough to identify its points."""

    least_points: ClassVar[int] = 4
    """Fewest measured points of a usable view: four determine a homography. The markers or the complete grid, which
    consist of more points, identify them."""

    edge_std_mm: float | None = None
    """Standard uncertainty of the measured `edge_mm`, mm. None: the print was not measured."""
    flatness_mm: float | None = None
    """Measured standard deviation of the board's points from a plane, mm. None: not measured."""

    def __post_init__(self) -> None:
        require_measured(edge_std_mm=self.edge_std_mm, flatness_mm=self.flatness_mm)

    @property
    @abstractmethod
    def edge_mm(self) -> float:
        """Length of the pattern along x, mm, as measured on the print."""

    @property
    @abstractmethod
    def extent_mm(self) -> Float64[Array, "2 2"]:
        """First and last printed corner (x, y), board frame, mm. The white border is outside."""

    @property
    def scale_std(self) -> float | None:
        """Relative standard uncertainty of all lengths. None: the print was not measured."""
        return None if self.edge_std_mm is None else self.edge_std_mm / self.edge_mm

    @property
    def looks_alike_turned(self) -> bool:
        """Whether half a turn in its plane gives the same board, so that its numbering is ambiguous."""
        return False

    @property
    def pattern(self) -> SheetPattern | None:
        """The printed pattern, if it is a regular one. Otherwise None.

        Raises:
            SessionError: unknown marker dictionary.
        """
        return None

    @property
    def body(self) -> ConvexBody:
        """The board on its paper."""
        return FlatBody(board=self)

    def scaled(self, factor: float) -> Board:
        """Return the board with all sizes of its print times `factor`."""
        measured = {field.name for field in fields(Board)}
        sizes = [field.name for field in fields(self) if field.name.endswith("_mm") and field.name not in measured]
        return replace(self, **{name: getattr(self, name) * factor for name in sizes})


@dataclass(frozen=True, slots=True, kw_only=True)
class SquaresBoard(Board):
    """A board of squares.

    Frame as in OpenCV: origin at the outer corner of the first square, x right, y down, z into the board. Ids count the
    ``(columns − 1) × (rows − 1)`` inner corners row by row.
    """

    size_key: ClassVar[str] = "square_mm"

    squares: tuple[int, int]
    """Columns and rows of squares: one more than inner corners in each direction."""
    square_mm: float
    """Side of a square, mm, as measured on the print."""

    def __post_init__(self) -> None:
        Board.__post_init__(self)
        require_grid("squares", self.squares, LEAST_SQUARES)
        require_positive(square_mm=self.square_mm)

    @property
    def points_target(self) -> Float64[Array, "n 3"]:
        """Inner corners by id, board frame, mm."""
        return _inner_corners(self.squares, self.square_mm)

    @property
    def edge_mm(self) -> float:
        """Length of the pattern along x: all columns of squares, mm."""
        return self.squares[0] * self.square_mm

    @property
    def extent_mm(self) -> Float64[Array, "2 2"]:
        """Outer corners of the first and the last square, mm."""
        return np.array([[0.0, 0.0], np.array(self.squares) * self.square_mm])

    @property
    @abstractmethod
    def pattern(self) -> SheetPattern:
        """The pattern printed in the squares.

        Raises:
            SessionError: unknown marker dictionary.
        """

    def sheet(self) -> PrintedSheet:
        """Return the dark squares and marker cells.

        Raises:
            SessionError: unknown marker dictionary.
        """
        return PrintedSheet(extent_mm=self.extent_mm, rectangles=self.pattern.rectangles())


@cache
def _inner_corners(squares: tuple[int, int], square_mm: float) -> Float64[Array, "n 3"]:
    column, row = np.meshgrid(np.arange(1, squares[0]), np.arange(1, squares[1]))
    corners = np.stack([column.ravel(), row.ravel(), np.zeros(column.size)], axis=1)
    return read_only(corners * square_mm)
