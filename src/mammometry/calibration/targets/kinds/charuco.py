"""ChArUco boards: chess corners, identified by markers in the white squares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from mammometry.base.photograph import Photograph
from mammometry.calibration.features.found_points import Cause, FoundPoints
from mammometry.calibration.targets.board import SquaresBoard
from mammometry.calibration.targets.registry import TARGETS
from mammometry.calibration.targets.sheet import Pattern
from mammometry.geometry.arrays import Array, UInt8


@TARGETS.add("charuco")
@dataclass(frozen=True, slots=True, kw_only=True)
class CharucoTarget(SquaresBoard):
    """A ChArUco board. Ids are OpenCV's.

    Raises:
        ValueError: fewer than 3 × 3 squares, or a marker that does not fit into its square.
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
            raise ValueError(f"marker_mm must lie between 0 and square_mm ({self.square_mm}), found {self.marker_mm}")

    def find(
        self, photograph: Photograph, *, search_width_px: int, window_squares: float
    ) -> FoundPoints | Cause | None:
        """Find the corners. See `find_charuco`.

        Raises:
            SessionError: there is no dictionary of the target's name.
        """
        from mammometry.calibration.targets.finders.find_charuco import find_charuco

        return find_charuco(photograph, self, search_width_px=search_width_px, window_squares=window_squares)

    def explain_miss(self, small: UInt8[Array, "h w"]) -> Cause | None:
        """Explain a missed board: other markers, mirrored or doubled."""
        from mammometry.calibration.targets.finders.miss_charuco import explain_missed_charuco

        return explain_missed_charuco(small, self)

    @property
    def pattern(self) -> Pattern:
        """Squares and markers.

        Raises:
            SessionError: there is no dictionary of the target's name.
        """
        from mammometry.calibration.targets.charuco_board import printed_cells

        return Pattern(
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
