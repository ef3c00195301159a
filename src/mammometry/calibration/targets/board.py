"""Flat boards: what all printed boards share, and boards of squares."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import ClassVar

import numpy as np

from mammometry.calibration.targets.body import Body
from mammometry.calibration.targets.sheet import Pattern, Sheet
from mammometry.calibration.targets.target import Target, require_grid, require_measured, require_positive
from mammometry.geometry.arrays import Array, Float64, read_only

LEAST_SQUARES = 3
"""Fewest columns and rows: two inner corners each way make the smallest grid."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Board(Target):
    """A flat print that is moved about. Frame: x right, y down, z into the board, mm."""

    may_be_cropped: ClassVar[bool] = False
    """Whether a part of it in the picture suffices to identify its points."""

    edge_std_mm: float | None = None
    """Standard uncertainty of `edge_mm` as measured, mm. None: the print was not measured."""
    flatness_mm: float | None = None
    """Standard deviation of the board's points from a plane, mm, as measured. None: not measured."""

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
        """Whether half a turn in its plane gives the same board.

        Then only its direction in the picture decides.
        """
        return False

    @property
    def pattern(self) -> Pattern | None:
        """What is printed, as a regular pattern. None where it is none.

        Raises:
            SessionError: there is no marker dictionary of the target's name.
        """
        return None

    @property
    def body(self) -> Body:
        """The board on its paper."""
        from mammometry.calibration.targets.flat_body import FlatBody

        return FlatBody(board=self)

    def scaled(self, factor: float) -> Board:
        """Return the board with all sizes of its print times `factor`."""
        measured = {field.name for field in fields(Board)}
        sizes = [field.name for field in fields(self) if field.name.endswith("_mm") and field.name not in measured]
        return replace(self, **{name: getattr(self, name) * factor for name in sizes})


@dataclass(frozen=True, slots=True, kw_only=True)
class SquaresBoard(Board):
    """A board of squares.

    Frame as OpenCV's: origin at the outer corner of the first one, x right, y down, z into it. Ids count the inner
    corners row by row: ``(columns − 1) × (rows − 1)`` of them.
    """

    size_key: ClassVar[str] = "square_mm"

    squares: tuple[int, int]
    """Columns and rows of SQUARES: one more each than inner corners."""
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
    def pattern(self) -> Pattern:
        """What is printed in every square.

        Raises:
            SessionError: there is no marker dictionary of the target's name.
        """

    def sheet(self) -> Sheet:
        """Return the dark squares and marker cells.

        Raises:
            SessionError: there is no marker dictionary of the target's name.
        """
        return Sheet(extent_mm=self.extent_mm, rectangles=self.pattern.rectangles())


@cache
def _inner_corners(squares: tuple[int, int], square_mm: float) -> Float64[Array, "n 3"]:
    column, row = np.meshgrid(np.arange(1, squares[0]), np.arange(1, squares[1]))
    corners = np.stack([column.ravel(), row.ravel(), np.zeros(column.size)], axis=1)
    return read_only(corners * square_mm)
