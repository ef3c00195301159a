"""A flat board as a solid: its printed side, met by rays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from mammometry.calibration.targets.board import Board
from mammometry.calibration.targets.body import Body, Hits
from mammometry.calibration.targets.sheet import Pattern
from mammometry.geometry.arrays import Array, Bool, Float64

BORDER_MM = 10.0
"""White border outside a board's pattern. Chosen by eye, detectors need a part of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlatBody(Body):
    """A board on its white paper. Only the printed side is seen."""

    attitude: ClassVar[Literal["facing", "upright", "any"]] = "facing"

    board: Board

    @property
    def normals_target(self) -> Float64[Array, "n 3"]:
        """−z at every point."""
        return np.broadcast_to([0.0, 0.0, -1.0], self.board.points_target.shape)

    @property
    def middle_mm(self) -> Float64[Array, 3]:
        """Middle of what is printed, mm."""
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
        """As the board says."""
        return self.board.looks_alike_turned

    @property
    def pattern(self) -> Pattern | None:
        """As the board says.

        Raises:
            SessionError: there is no marker dictionary of the target's name.
        """
        return self.board.pattern

    def is_whole(
        self, seen: Bool[Array, " n"], in_picture: Callable[[Float64[Array, "m 3"]], Bool[Array, " m"]]
    ) -> bool:
        """Whether everything printed is in the picture, unless croppable."""
        return self.board.may_be_cropped or bool(seen.all() and in_picture(_corners(self.board.extent_mm)).all())

    def meet(self, origins: Float64[Array, "n 3"], directions: Float64[Array, "n 3"]) -> Hits:
        """Meet the plane z = 0 from its printed side."""
        with np.errstate(divide="ignore", invalid="ignore"):
            along = -origins[:, 2] / directions[:, 2]
            points = origins + along[:, None] * directions
        left_top, right_bottom = self.paper_mm
        xy = points[:, :2]
        on_paper = (along > 0) & (directions[:, 2] > 0) & ((xy >= left_top) & (xy <= right_bottom)).all(axis=1)
        white = np.full(len(points), np.nan)
        white[on_paper] = np.where(self.board.sheet().is_dark(xy[on_paper]), 0.0, 1.0)
        return Hits(points=points, normals=np.broadcast_to([0.0, 0.0, -1.0], points.shape), white=white)


def _corners(extent_mm: Float64[Array, "2 2"]) -> Float64[Array, "4 3"]:
    (left, top), (right, bottom) = extent_mm
    return np.array([[left, top, 0.0], [right, top, 0.0], [right, bottom, 0.0], [left, bottom, 0.0]])
